"""Eight cones, faces or edges at once: LLVM vectors behind functions for numba kernels.

Numba vectorises loops only where it can prove that arrays do not overlap, which short loops over packed blocks never
allow; so the tests are written as vector instructions here. LLVM lowers eight float lanes to whatever the CPU has.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

LANES = 8
NODE_ROWS = 12
"""Rows of a node block, LANES float32 each: scaled normal (3), front anchor (3), back anchor (3), scaled normal . front
anchor, separation, length of the scaled normal."""

SET_BITS = np.array([([j for j in range(LANES) if m >> j & 1] + [0] * LANES)[:LANES] for m in range(256)], np.int32)
"""Row m: the numbers of the set bits of m, in order, then zeros."""
BIT_COUNT = np.array([bin(m).count("1") for m in range(256)], np.uint8)

_FLOAT = ir.FloatType()
_LANE = ir.VectorType(_FLOAT, LANES)
_MASK = ir.IntType(LANES)
_WORD = ir.IntType(32)
_LONG = ir.IntType(64)
_INT_LANE = ir.VectorType(_WORD, LANES)
_INTS = types.Array(types.int32, 1, "C")


def _rows(context, builder, signature, args, count):
    """Load `count` consecutive rows of LANES floats of array args[0] from word args[1] on."""
    array = context.make_array(signature.args[0])(context, builder, args[0])
    first = builder.gep(array.data, [args[1]])
    rows = builder.bitcast(first, _LANE.as_pointer())
    loaded = []
    for i in range(count):
        row = builder.load(builder.gep(rows, [ir.Constant(ir.IntType(64), i)]))
        row.align = 4
        loaded.append(row)
    return loaded


def _splat(builder, value, lane=_LANE):
    nothing = ir.Constant(lane, ir.Undefined)
    one = builder.insert_element(nothing, value, ir.Constant(_WORD, 0))
    return builder.shuffle_vector(one, nothing, ir.Constant(_INT_LANE, [0] * LANES))


def _dot(builder, a, b):
    x, y, z = (builder.fmul(p, q) for p, q in zip(a, b, strict=True))
    return builder.fadd(builder.fadd(x, y), z)


def _bits(builder, lanes, shift):
    """Eight booleans as bits shift.. of a 64-bit word."""
    return builder.shl(builder.zext(builder.bitcast(lanes, _MASK), _LONG), ir.Constant(_LONG, shift))


def _reached(builder, along, offset):
    """Per lane: along >= 0 and along^2 >= |offset|^2."""
    zero = ir.Constant(_LANE, [0.0] * LANES)
    ahead = builder.fcmp_ordered(">=", along, zero)
    inside = builder.fcmp_ordered(">=", builder.fmul(along, along), _dot(builder, offset, offset))
    return builder.and_(ahead, inside)


@intrinsic
def missed_cones(typingctx, arena, at, x, y, z, w, w_back, margin):
    """Word whose bit j says that lane j of the node block at word `at` must be walked: the eye is in neither of its cones.

    (x, y, z, w) f4 the eye, w_back: w, or a tiny number for an eye at infinity (a separation of 3e38 still fails then).
    margin: what both tests must hold by, for a scaled normal of length one.
    """
    signature = types.uint64(_INTS, types.intp, *([types.float32] * 6))

    def codegen(context, builder, sig, args):
        r = _rows(context, builder, sig, args, NODE_ROWS)
        eye = [_splat(builder, a) for a in args[2:5]]
        w_, w_back_, margin_ = (_splat(builder, a) for a in args[5:8])
        along = builder.fsub(_dot(builder, r[0:3], eye), builder.fmul(r[9], w_))
        slack = builder.fmul(r[11], margin_)
        from_front = [builder.fsub(e, builder.fmul(o, w_)) for e, o in zip(eye, r[3:6], strict=True)]
        from_back = [builder.fsub(e, builder.fmul(o, w_)) for e, o in zip(eye, r[6:9], strict=True)]
        front = _reached(builder, builder.fsub(along, slack), from_front)
        backwards = builder.fsub(builder.fsub(builder.fneg(along), builder.fmul(r[10], w_back_)), slack)
        back = _reached(builder, backwards, from_back)
        return _bits(builder, builder.not_(builder.or_(front, back)), 0)

    return signature, codegen


@intrinsic
def append_lanes(typingctx, out, at, set_bits, mask, base):
    """out[at:at + LANES] = base + set_bits[LANES * mask:]: the numbers of the set bits, whatever their count.

    Writes all lanes; the caller advances by the count, so out keeps LANES spare entries. out, set_bits (1-d) i4.
    """
    signature = types.void(_INTS, types.intp, _INTS, types.intp, types.int32)

    def codegen(context, builder, sig, args):
        table = context.make_array(sig.args[2])(context, builder, args[2])
        row = builder.mul(args[3], ir.Constant(args[3].type, LANES))
        bits = builder.load(builder.bitcast(builder.gep(table.data, [row]), _INT_LANE.as_pointer()))
        bits.align = 4
        value = builder.add(_splat(builder, args[4], _INT_LANE), bits)
        array = context.make_array(sig.args[0])(context, builder, args[0])
        store = builder.store(value, builder.bitcast(builder.gep(array.data, [args[1]]), _INT_LANE.as_pointer()))
        store.align = 4
        return context.get_dummy_value()

    return signature, codegen
