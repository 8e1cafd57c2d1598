"""What compiled code can ask of the processor and Python's numba has no name for."""

from __future__ import annotations

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


@intrinsic
def cycles(typingctx):
    """() -> i8: the processor's clock; only differences within a thread mean anything."""
    del typingctx

    def generate(context, builder, signature, arguments):
        del context, signature, arguments
        clock = cgutils.get_or_insert_function(builder.module, ir.FunctionType(ir.IntType(64), []), "llvm.readcyclecounter")
        return builder.call(clock, [])

    return types.int64(), generate


@intrinsic
def take(typingctx, counter):
    """(counter (1,) i8 C-contiguous) -> i8: the number in it, which then is one more. No two threads get the same."""
    del typingctx

    def generate(context, builder, signature, arguments):
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        return builder.atomic_rmw("add", array.data, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), generate


@intrinsic
def fetch_ahead(typingctx, array, at):
    """Ask for the cache line where array[at] of a C-contiguous array begins; it may lie outside the array: nothing is read. at: i8."""

    def generate(context, builder, signature, arguments):
        kind, byte, word = signature.args[0], ir.IntType(8).as_pointer(), ir.IntType(32)
        found = context.make_array(kind)(context, builder, arguments[0])
        stride = cgutils.unpack_tuple(builder, found.strides, kind.ndim)[0]
        place = builder.gep(builder.bitcast(found.data, byte), [builder.mul(arguments[1], stride)])
        ask = builder.module.declare_intrinsic("llvm.prefetch", [byte], ir.FunctionType(ir.VoidType(), [byte, word, word, word]))
        builder.call(ask, [place, ir.Constant(word, 0), ir.Constant(word, 3), ir.Constant(word, 1)])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


@intrinsic
def unlikely(typingctx, condition):
    """(boolean) -> the same; what happens only if it is true is laid out out of the way."""
    del typingctx

    def generate(context, builder, signature, arguments):
        del context, signature
        bit = ir.IntType(1)
        expect = builder.module.declare_intrinsic("llvm.expect", [bit], ir.FunctionType(bit, [bit, bit]))
        value = arguments[0] if arguments[0].type == bit else builder.trunc(arguments[0], bit)
        return builder.call(expect, [value, ir.Constant(bit, 0)])

    return types.boolean(types.boolean), generate
