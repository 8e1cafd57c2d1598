"""Tests of a leaf's faces and edges, sixteen to sixty-four at once, as LLVM vectors behind functions for numba kernels.

Some have one instruction on CPUs with AVX-512 DQ, VBMI and VBMI2 (`WIDE`): looking up 64 bits by 64 bytes, and moving the
chosen ones of 64 bytes together. Elsewhere the look-up is made of eight shifts, and the chosen edges are taken one by one.
"""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core.registry import cpu_target
from numba.extending import intrinsic

SIXTEEN, ALL = 16, 64
_FEATURES = cpu_target.target_context.codegen().magic_tuple()[2].split(",")
WIDE = {"+avx512dq", "+avx512vbmi", "+avx512vbmi2"} <= set(_FEATURES)
"""Decided from what numba compiles for, which is also what it names its cached code by."""

SURE = 2.0
"""Heights from here on are sure. Of a float32 that is finite one bit says whether its absolute value is that large."""
_SURE_BIT = 1 << 30

_FLOAT, _SHORT, _BYTE, _WORD, _LONG = ir.FloatType(), ir.IntType(16), ir.IntType(8), ir.IntType(32), ir.IntType(64)
_BIT = ir.IntType(1)
_FLOATS = ir.VectorType(_FLOAT, SIXTEEN)
_BYTES = ir.VectorType(_BYTE, ALL)
_BITS = ir.VectorType(_BIT, ALL)
_WORDS = ir.VectorType(_WORD, SIXTEEN)
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
def leaf_eye(typingctx, arena, at, eyes, turn):
    """(height over the leaf's plane, the three steps times the eye) for the leaf's head at word `at`.

    The head: a plane (a, b, c, d) for the eye with its coordinates turned by `turn`, then steps of b, c and d. eyes (12,) f4:
    x y z w, y z x w, z x y w.
    """
    signature = types.UniTuple(types.float32, 4)(_ARENA, types.intp, types.Array(types.float32, 1, "C"), types.intp)
    four = ir.VectorType(_FLOAT, 4)

    def codegen(context, builder, sig, args):
        address = _pointer(context, builder, sig, args)
        row = context.make_array(sig.args[2])(context, builder, args[2]).data
        eye = _load(builder, builder.gep(row, [builder.mul(args[3], ir.Constant(_LONG, 4))]), four)
        plane, steps = (_load(builder, builder.gep(address, [ir.Constant(_LONG, k)]), four) for k in (0, 4))
        terms, scaled = builder.fmul(plane, eye), builder.fmul(steps, eye)
        t = [builder.extract_element(terms, ir.Constant(_WORD, k)) for k in range(4)]
        base = builder.fadd(builder.fadd(t[0], t[1]), builder.fadd(t[2], t[3]))
        s = [builder.extract_element(scaled, ir.Constant(_WORD, k)) for k in range(1, 4)]
        return context.make_tuple(builder, sig.return_type, [base, *s])

    return signature, codegen


def _heights(context, builder, sig, args):
    """Four <16 x float> heights over planes, of the first arguments of `face_sides`."""
    address = _pointer(context, builder, sig, args)
    base, *scaled = (_splat(builder, value, _FLOATS) for value in args[3:7])
    heights = []
    for k in range(0, ALL, SIXTEEN):
        height, row = base, builder.gep(builder.bitcast(address, _SHORT.as_pointer()), [ir.Constant(_LONG, k)])
        for coefficient in scaled:
            short = _load(builder, row, ir.VectorType(_SHORT, SIXTEEN))
            height = _multiply_add(builder, builder.sitofp(short, _FLOATS), coefficient, height)
            row = builder.gep(row, [builder.mul(args[2], ir.Constant(_LONG, 2))])
        heights.append(height)
    return heights


def _joined(builder, parts):
    """One vector of the same vectors' lanes, one after the other."""
    while len(parts) > 1:
        size = parts[0].type.count
        order = ir.Constant(ir.VectorType(_WORD, 2 * size), list(range(2 * size)))
        parts = [builder.shuffle_vector(a, b, order) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    return parts[0]


def _over(builder, heights):
    """The word whose bits say which heights are positive."""
    nothing = ir.Constant(_FLOATS, [0.0] * SIXTEEN)
    return builder.bitcast(_joined(builder, [builder.fcmp_ordered(">", height, nothing) for height in heights]), _LONG)


def _some_close(builder, heights):
    """<16 x i1>: in this lane of one of the vectors is an absolute value below `SURE`, or not so of those of one vector."""
    bits = [builder.bitcast(height, _WORDS) for height in heights]
    while len(bits) > 1:
        bits = [builder.and_(bits[0], bits[1]), *bits[2:]]
    return builder.icmp_unsigned(
        "==", builder.and_(bits[0], ir.Constant(_WORDS, [_SURE_BIT] * SIXTEEN)), ir.Constant(_WORDS, [0] * SIXTEEN)
    )


@intrinsic
def face_sides(typingctx, arena, at, row, base, b, c, d):
    """(word whose bit j says that the eye is over plane j, whether that is not sure of every plane) for the 64 faces at word `at`.

    Three rows of 64 16-bit numbers, `row` words apart, times (b, c, d) and plus base: the height over the plane, which is
    sure from `SURE` on. What lies behind the last face counts as a plane, so "not sure" may be a false alarm.
    """
    signature = types.Tuple((types.uint64, types.boolean))(_ARENA, types.intp, types.intp, *([types.float32] * 4))

    def codegen(context, builder, sig, args):
        heights = _heights(context, builder, sig, args)
        close = builder.bitcast(_some_close(builder, heights), _SHORT)
        doubtful = builder.icmp_unsigned("!=", close, ir.Constant(_SHORT, 0))
        return context.make_tuple(builder, sig.return_type, [_over(builder, heights), doubtful])

    return signature, codegen


@intrinsic
def close_faces(typingctx, arena, at, row, base, b, c, d):
    """(word as in `face_sides`, word whose bit j says that the height over plane j is not sure); its arguments."""
    signature = types.UniTuple(types.uint64, 2)(_ARENA, types.intp, types.intp, *([types.float32] * 4))

    def codegen(context, builder, sig, args):
        heights = _heights(context, builder, sig, args)
        close = _joined(builder, [_some_close(builder, [height]) for height in heights])
        return context.make_tuple(builder, sig.return_type, [_over(builder, heights), builder.bitcast(close, _LONG)])

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
    return _joined(builder, found)


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
    lane = _WORDS
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
    lane = _WORDS
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
