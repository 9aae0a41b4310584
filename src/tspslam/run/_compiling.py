"""Kernels of a run, compiled before they are needed: by helper processes that fill the folder they are kept in."""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .._jit import find_folder, is_cached
from .._threads import thread_count
from ..mapping._carving import carve
from ..topology._harmonics import filter_one_ring
from ..vision.slam._patch_tracking import track_level

LIST = Path(__file__).with_name("kernels.txt")
"""A line a kernel: its module, its name, the types that a run calls it with.

What a first frame needs comes first, and of that the longest early, so that the helpers end together; the rest is in
the order of need, and last what only a loop needs.
"""
_HELPERS = 2  # processes; more gain little, as a first frame needs seven kernels
_OF_PATHS = ".slam."  # in the names of modules that a run of one pair does not need


def are_compiled(*, is_sequence: bool) -> bool:
    """Tell whether an earlier process left the longest kernels; of a sequence those of its path and map too."""
    wanted = [filter_one_ring, track_level, carve] if is_sequence else [filter_one_ring]
    return all(is_cached(each) for each in wanted)


def listed() -> list[tuple[str, str, str]]:
    """Kernels that a run calls: module, name, and types as numba writes them."""
    lines = LIST.read_text(encoding="ascii").splitlines()
    return [(each[0], each[1], each[2]) for line in lines if len(each := line.split(" ", 2)) == 3]


@contextlib.contextmanager
def compiling(*, is_sequence: bool) -> Iterator[None]:
    """Have helper processes compile what a run will need, if that is not done and there are threads for it.

    They fill the folder of kernels; whoever needs one that is being compiled waits for it. They end with the block, or
    with this process.
    """
    is_needed = thread_count() > 1 and find_folder() is not None and not are_compiled(is_sequence=is_sequence)
    with contextlib.ExitStack() as helpers:
        for _ in range(min(_HELPERS, thread_count()) if is_needed else 0):
            helpers.enter_context(_helper(is_sequence))
        yield


@contextlib.contextmanager
def _helper(is_sequence: bool) -> Iterator[None]:
    """A process that compiles until the block ends; none where this interpreter cannot be started again."""
    call = f"from {__name__} import compile_listed; compile_listed({is_sequence})"
    code, quiet = f"import sys; sys.path[:] = {sys.path!r}; {call}", subprocess.DEVNULL
    process = None
    if sys.executable and not getattr(sys, "frozen", False):
        with contextlib.suppress(OSError):
            process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=quiet, stderr=quiet)
    try:
        yield
    finally:
        if process:
            assert process.stdin is not None
            process.stdin.close()  # by which it ends
            process.wait()


def compile_listed(is_sequence: bool) -> None:
    """Compile what is listed, and neither there nor being compiled; end when standard input does."""
    threading.Thread(target=_end_with_input, daemon=True).start()
    gc.disable()  # a compiler's objects are looked through again and again otherwise: a tenth of its time
    for module, name, types in listed():
        if is_sequence or _OF_PATHS not in module:
            compile_one(getattr(importlib.import_module(module), name), types)
            gc.collect()
            gc.freeze()  # what is left by now stays


def compile_one(kernel: Any, types: str) -> None:
    """Compile a kernel for the types of its arguments, unless that is done or under way elsewhere."""
    from numba.core import types as names

    signature = eval(types, {"__builtins__": {}}, vars(names))  # our own file
    if kernel._cache.is_left(signature, kernel.targetctx):
        kernel.compile(signature)


def _end_with_input() -> None:
    sys.stdin.buffer.read()
    os._exit(0)
