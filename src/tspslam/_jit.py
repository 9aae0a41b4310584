"""How kernels are compiled: cached on disk where that is possible, without the GIL, NumPy's rules for errors."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

from ._kernel_cache import KernelCache
from ._kernel_cache import find_folder as find_folder

_log = logging.getLogger("tspslam")
_said: set[str] = set()


def kernel(function: Callable[..., Any]) -> Any:
    """Compile `function` with numba, for one core; on one machine, same input, same bytes."""
    return _compile(function, fastmath=False)


def reassociated_kernel(function: Callable[..., Any]) -> Any:
    """Compile like `kernel`, but let sums be reordered so that they fit vector registers (no other liberty)."""
    return _compile(function, fastmath={"reassoc", "contract"})


def inlined(function: Callable[..., Any]) -> Any:
    """Make `function` part of each kernel that calls it: calls with many array arguments cost more than their work."""
    return numba.njit(inline="always", nogil=True, error_model="numpy")(function)


def instructions(function: Callable[..., Any]) -> Any:
    """Let kernels call what `function` writes: instructions that a compiler does not find by itself."""
    return intrinsic(function)


@instructions
def prefetch(_context: Any, array: Any, _row: Any) -> Any:
    """Ask the processor to bring row `_row` of `array` near; no other effect, and no check of the index."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        layout = context.make_array(array)(context, builder, arguments[0])
        stride = builder.extract_value(layout.strides, 0)
        row = context.cast(builder, arguments[1], signature.args[1], types.intp)
        address = builder.add(builder.ptrtoint(layout.data, stride.type), builder.mul(row, stride))
        pointer, flag = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer, flag, flag, flag])
        call = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(call, [builder.inttoptr(address, pointer), flag(0), flag(3), flag(1)])
        return context.get_dummy_value()

    return types.void(array, _row), generate


def _compile(function: Callable[..., Any], fastmath: bool | set[str]) -> Any:
    options: dict[str, Any] = {"nogil": True, "error_model": "numpy", "fastmath": fastmath, "no_cfunc_wrapper": True}
    compiled = numba.njit(**options)(function)
    folder = find_folder()
    if folder is not None and hasattr(compiled, "_cache"):  # else NUMBA_DISABLE_JIT gave the function back
        compiled._cache = KernelCache(compiled.py_func, folder, options)
    elif folder is None and not _said:
        _log.warning("kernels are compiled anew in each process: there is no folder of your own that can be written")
        _said.add("no cache")
    return compiled


def is_cached(compiled: Any) -> bool:
    """Whether an earlier process left this kernel on disk."""
    kept = getattr(compiled, "_cache", None)
    return isinstance(kept, KernelCache) and kept.is_filled()
