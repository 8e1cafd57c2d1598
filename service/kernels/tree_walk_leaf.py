"""Tests of a leaf's faces and edges, sixteen to sixty-four at once, as LLVM vectors behind functions for numba kernels.

Two of them have one instruction on CPUs with AVX-512 VBMI and VBMI2 (`WIDE`): looking up 64 bits by 64 bytes, and moving the
chosen ones of 64 bytes together. Elsewhere the look-up is made of eight shifts, and the chosen edges are taken one by one.
"""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

SIXTEEN, ALL = 16, 64
_FEATURES = cpu_target.target_context.codegen().magic_tuple()[2].split(",")
WIDE = "+avx512vbmi" in _FEATURES and "+avx512vbmi2" in _FEATURES
"""Decided from what numba compiles for, which is also what it names its cached code by."""

_FLOAT, _SHORT, _BYTE, _WORD, _LONG = ir.FloatType(), ir.IntType(16), ir.IntType(8), ir.IntType(32), ir.IntType(64)
_BIT = ir.IntType(1)
_FLOATS = ir.VectorType(_FLOAT, SIXTEEN)
_BYTES = ir.VectorType(_BYTE, ALL)
_BITS = ir.VectorType(_BIT, ALL)
_ARENA = types.Array(types.int32, 1, "C")


def _pointer(context, builder, signature, args, k=0):
    """Address of word args[k + 1] of array args[k]."""
    array = context.make_array(signature.args[k])(context, builder, args[k])
    return builder.gep(array.data, [args[k + 1]])


def _load(builder, address, kind):
    loaded = builder.load(builder.bitcast(address, kind.as_pointer()))
    loaded.align = 4
    return loaded


def _splat(builder, value, kind):
    nothing = ir.Constant(kind, ir.Undefined)
    one = builder.insert_element(nothing, value, ir.Constant(_WORD, 0))
    return builder.shuffle_vector(one, nothing, ir.Constant(ir.VectorType(_WORD, kind.count), [0] * kind.count))


def _multiply_add(builder, a, b, c):
    kind = ir.FunctionType(a.type, [a.type] * 3)
    return builder.call(builder.module.declare_intrinsic(f"llvm.fmuladd.v{a.type.count}f32", (), kind), [a, b, c])


@intrinsic
def leaf_eye(typingctx, arena, at, eyes, turn, away):
    """(height over the leaf's plane, the three steps times the eye, bound of the error) for the leaf's head at word `at`.

    The head: a plane (1, b, c, d) for the eye with its coordinates turned by `turn`, steps of b, c and d, errors of the normal
    and of d. eyes (12,) f4: x y z w, y z x w, z x y w; away: |x| + |y| + |z|.
    """
    signature = types.UniTuple(types.float32, 5)(_ARENA, types.intp, types.Array(types.float32, 1, "C"), types.intp, types.float32)
    four = ir.VectorType(_FLOAT, 4)

    def codegen(context, builder, sig, args):
        address = _pointer(context, builder, sig, args)
        row = context.make_array(sig.args[2])(context, builder, args[2]).data
        eye = _load(builder, builder.gep(row, [builder.mul(args[3], ir.Constant(_LONG, 4))]), four)
        plane, steps = (_load(builder, builder.gep(address, [ir.Constant(_LONG, k)]), four) for k in (0, 4))
        # one by one: the words behind them are integers, which are denormal numbers to arithmetic, and slow
        of_normal, of_distance = (_load(builder, builder.gep(address, [ir.Constant(_LONG, k)]), _FLOAT) for k in (8, 9))
        terms, scaled = builder.fmul(plane, eye), builder.fmul(steps, eye)
        t = [builder.extract_element(terms, ir.Constant(_WORD, k)) for k in range(4)]
        base = builder.fadd(builder.fadd(t[0], t[1]), builder.fadd(t[2], t[3]))
        s = [builder.extract_element(scaled, ir.Constant(_WORD, k)) for k in range(1, 4)]
        w = builder.extract_element(eye, ir.Constant(_WORD, 3))
        bound = builder.fadd(builder.fmul(of_normal, args[4]), builder.fmul(of_distance, w))
        return context.make_tuple(builder, sig.return_type, [base, *s, builder.fadd(bound, ir.Constant(_FLOAT, 1e-30))])

    return signature, codegen


@intrinsic
def face_sides(typingctx, arena, at, row, base, b, c, d, bound):
    """Word for the sixteen faces at word `at`: bit j says that the eye is surely over plane j, bit 16 + j that it is doubtful.

    Three rows of sixteen 16-bit numbers, `row` words apart, times (b, c, d) and plus base: the height over the plane, which is
    sure beyond `bound`.
    """
    signature = types.uint64(_ARENA, types.intp, types.intp, *([types.float32] * 5))

    def codegen(context, builder, sig, args):
        address = _pointer(context, builder, sig, args)
        height = _splat(builder, args[3], _FLOATS)
        for k in range(3):
            short = _load(builder, address, ir.VectorType(_SHORT, SIXTEEN))
            height = _multiply_add(builder, builder.sitofp(short, _FLOATS), _splat(builder, args[4 + k], _FLOATS), height)
            address = builder.gep(address, [args[2]])
        bound_ = _splat(builder, args[7], _FLOATS)
        over = builder.fcmp_ordered(">", height, bound_)
        under = builder.fcmp_ordered("<", height, builder.fneg(bound_))
        doubtful = builder.not_(builder.or_(over, under))
        low = builder.zext(builder.bitcast(over, _SHORT), _LONG)
        high = builder.zext(builder.bitcast(doubtful, _SHORT), _LONG)
        return builder.or_(low, builder.shl(high, ir.Constant(_LONG, SIXTEEN)))

    return signature, codegen


def _looked_up(builder, numbers, word):
    """<64 x i1>: the bits of a 64-bit word at 64 byte numbers."""
    if WIDE:
        table = builder.sext(builder.bitcast(word, _BITS), _BYTES)
        kind = ir.FunctionType(_BYTES, [_BYTES, _BYTES])
        permute = builder.module.declare_intrinsic("llvm.x86.avx512.permvar.qi.512", (), kind)
        return builder.icmp_signed("<", builder.call(permute, [table, numbers]), ir.Constant(_BYTES, [0] * ALL))
    lanes = ir.VectorType(_LONG, 8)
    found = []
    for k in range(0, ALL, 8):
        part = builder.shuffle_vector(numbers, numbers, ir.Constant(ir.VectorType(_WORD, 8), list(range(k, k + 8))))
        shift = builder.and_(builder.zext(part, lanes), ir.Constant(lanes, [63] * 8))
        found.append(builder.trunc(builder.lshr(_splat(builder, word, lanes), shift), ir.VectorType(_BIT, 8)))
    while len(found) > 1:
        size = found[0].type.count
        order = ir.Constant(ir.VectorType(_WORD, 2 * size), list(range(2 * size)))
        found = [builder.shuffle_vector(a, b, order) for a, b in zip(found[::2], found[1::2], strict=True)]
    return found[0]


@intrinsic
def bits_at(typingctx, arena, at, word):
    """Bit j: bit number b of word, b the j-th of the 64 bytes at word `at`."""
    signature = types.uint64(_ARENA, types.intp, types.uint64)

    def codegen(context, builder, sig, args):
        numbers = _load(builder, _pointer(context, builder, sig, args), _BYTES)
        return builder.bitcast(_looked_up(builder, numbers, args[2]), _LONG)

    return signature, codegen


@intrinsic
def byte_at(typingctx, arena, at, k):
    """Byte k behind word `at`."""
    signature = types.int64(_ARENA, types.intp, types.int64)

    def codegen(context, builder, sig, args):
        address = builder.bitcast(_pointer(context, builder, sig, args), _BYTE.as_pointer())
        return builder.zext(builder.load(builder.gep(address, [args[2]])), _LONG)

    return signature, codegen


@intrinsic
def ones(typingctx, word):
    """How many bits of a word are set."""
    signature = types.int64(types.uint64)

    def codegen(context, builder, sig, args):
        return builder.ctpop(args[0])

    return signature, codegen


def _compress(builder, numbers, chosen):
    kind = ir.FunctionType(_BYTES, [_BYTES, _BYTES, _BITS])
    compress = builder.module.declare_intrinsic(f"llvm.x86.avx512.mask.compress.v{ALL}i8", (), kind)
    return builder.call(compress, [numbers, ir.Constant(_BYTES, [0] * ALL), chosen])


def _table_look_up(builder, table, numbers):
    """<16 x i32> entries of a table of 64 in four vectors at <16 x i32> numbers."""
    lane = ir.VectorType(_WORD, SIXTEEN)
    kind = ir.FunctionType(lane, [lane, lane, lane])
    permute = builder.module.declare_intrinsic("llvm.x86.avx512.vpermi2var.d.512", (), kind)
    low, high = (builder.call(permute, [table[k], numbers, table[k + 1]]) for k in (0, 2))
    upper = builder.icmp_unsigned(">=", numbers, ir.Constant(lane, [32] * SIXTEEN))
    return builder.select(upper, high, low)


def _store(builder, value, address):
    builder.store(value, builder.bitcast(address, value.type.as_pointer())).align = 4


@intrinsic
def first_pairs(typingctx, arena, at, row, left, chosen, out, to, pairs):
    """Store the pairs of vertices of the first sixteen chosen edges at word `to` of out, 32 words whatever their number.

    The bytes at word `at` are the numbers of the first ends of 64 edges, those `row` words on of the second ones, those two
    rows on are the table of vertices; an edge whose left bit is 0 is turned round. pairs (32,) i4 receives the numbers of all.
    Needs WIDE.
    """
    words = types.Array(types.int32, 1, "C")
    signature = types.void(_ARENA, types.intp, types.intp, types.uint64, types.uint64, words, types.intp, words)

    def codegen(context, builder, sig, args):
        address = _pointer(context, builder, sig, args)
        second_row = builder.gep(address, [args[2]])
        first, second = _load(builder, address, _BYTES), _load(builder, second_row, _BYTES)
        onward, chosen_ = builder.bitcast(args[3], _BITS), builder.bitcast(args[4], _BITS)
        start = _compress(builder, builder.select(onward, first, second), chosen_)
        end = _compress(builder, builder.select(onward, second, first), chosen_)
        table = _table(builder, builder.gep(second_row, [args[2]]))
        target = _pointer(context, builder, sig, args, 5)
        rest = context.make_array(sig.args[7])(context, builder, args[7]).data
        for half in range(2):
            order = [32 * half + j // 2 + ALL * (j % 2) for j in range(ALL)]
            mixed = builder.shuffle_vector(start, end, ir.Constant(ir.VectorType(_WORD, ALL), order))
            _store(builder, mixed, builder.gep(rest, [ir.Constant(_LONG, 16 * half)]))
            for quarter in range(2 if half == 0 else 0):
                part = list(range(SIXTEEN * quarter, SIXTEEN * (quarter + 1)))
                numbers = builder.shuffle_vector(mixed, mixed, ir.Constant(ir.VectorType(_WORD, SIXTEEN), part))
                found = _table_look_up(builder, table, builder.zext(numbers, ir.VectorType(_WORD, SIXTEEN)))
                _store(builder, found, builder.gep(target, [ir.Constant(_LONG, SIXTEEN * quarter)]))
        return context.get_dummy_value()

    return signature, codegen


def _table(builder, address):
    lane = ir.VectorType(_WORD, SIXTEEN)
    return [_load(builder, builder.gep(address, [ir.Constant(_LONG, SIXTEEN * k)]), lane) for k in range(4)]


@intrinsic
def look_up(typingctx, arena, table, pairs, at, out, to):
    """out[to:to + 16] = arena[table + b] for the sixteen bytes b < 64 at word `at` of pairs. Needs WIDE."""
    words = types.Array(types.int32, 1, "C")
    signature = types.void(_ARENA, types.intp, words, types.intp, words, types.intp)

    def codegen(context, builder, sig, args):
        entries = _table(builder, _pointer(context, builder, sig, args))
        part = _load(builder, _pointer(context, builder, sig, args, 2), ir.VectorType(_BYTE, SIXTEEN))
        found = _table_look_up(builder, entries, builder.zext(part, ir.VectorType(_WORD, SIXTEEN)))
        _store(builder, found, _pointer(context, builder, sig, args, 4))
        return context.get_dummy_value()

    return signature, codegen
