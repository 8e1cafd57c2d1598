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
