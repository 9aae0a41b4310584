"""Kernels of a run, compiled before they are needed, with helper processes that fill the folder they are kept in."""

from __future__ import annotations

import contextlib
import gc
import importlib
import logging
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from .._jit import find_folder, is_cached
from .._threads import thread_count
from ..mapping._carving import carve
from ..topology._harmonics import filter_one_ring
from ..vision.slam._patch_tracking import track_level

_log = logging.getLogger("tspslam")
LIST = Path(__file__).with_name("kernels.txt")
"""A line a kernel: its module, its name, the types that a run calls it with.

Before the empty line is what a first frame needs, the longest first, so that all who compile it end together; the rest
is in the order of need, and last what only a loop needs.
"""
_HELPERS = 2  # processes; more gain little, as each first spends a second on what numba itself needs
_TAIL = 4096  # bytes of what a helper said that its last line is looked for in
_OF_PATHS = ".slam."  # in the names of modules that a run of one pair does not need


def are_compiled(*, is_sequence: bool) -> bool:
    """Tell whether an earlier process left the longest kernels; of a sequence those of its path and map too."""
    wanted = [filter_one_ring, track_level, carve] if is_sequence else [filter_one_ring]
    return all(is_cached(each) for each in wanted)


def listed(*, is_sequence: bool = True, is_first: bool = False) -> list[tuple[str, str, str]]:
    """Kernels that a run calls, or its first frame does: module, name, and types as numba writes them."""
    text = LIST.read_text(encoding="ascii")
    lines = (text.partition("\n\n")[0] if is_first else text).splitlines()
    rows = [(each[0], each[1], each[2]) for line in lines if len(each := line.split(" ", 2)) == 3]
    return [row for row in rows if is_sequence or _OF_PATHS not in row[0]]


@contextlib.contextmanager
def compiling(*, is_sequence: bool, has_frames: bool = True) -> Iterator[None]:
    """Compile what a run will need, if that is not done and there are threads for it.

    If it `has_frames` to process, what the first one needs is there when the block begins: this process compiles it
    together with helpers. These compile the rest meanwhile, into the folder of kernels; whoever needs one that is being
    compiled waits for it. They end with the block, or with this process.
    """
    count = thread_count()
    is_needed = count > 1 and find_folder() is not None and not are_compiled(is_sequence=is_sequence)
    with contextlib.ExitStack() as helpers:
        for _ in range(min(_HELPERS, count) if is_needed else 0):
            helpers.enter_context(_helper(is_sequence))
        if is_needed and has_frames:
            compile_first(is_sequence=is_sequence)
        yield


@contextlib.contextmanager
def _helper(is_sequence: bool) -> Iterator[subprocess.Popen[bytes] | None]:
    """A process that compiles until the block ends; none where this interpreter cannot be started again."""
    begun = _begin(is_sequence)
    if begun is None:
        yield None
        return
    process, said = begun
    with said:
        try:
            yield process
        finally:
            process.communicate()  # which closes its input: by that it ends
        if process.returncode:
            said.seek(max(0, said.tell() - _TAIL))
            why = (said.read().decode(errors="replace").strip() or "it said nothing").splitlines()[-1]
            _log.warning("a process that compiled kernels ahead ended with code %d: %.200s", process.returncode, why)


def _begin(is_sequence: bool) -> tuple[subprocess.Popen[bytes], IO[bytes]] | None:
    """The process, and the file that it says into: a pipe that nobody reads would stop it once it is full."""
    call = f"from {__name__} import compile_listed; compile_listed({is_sequence})"
    code = f"import sys; sys.path[:] = {sys.path!r}; {call}"
    with contextlib.suppress(OSError):
        if sys.executable and not getattr(sys, "frozen", False):
            command, quiet = [sys.executable, "-c", code], subprocess.DEVNULL
            said = tempfile.TemporaryFile()  # noqa: SIM115 - the helper's, which closes it
            return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=quiet, stderr=said), said
    return None


def compile_listed(is_sequence: bool) -> None:
    """Compile what is listed, and neither there nor being compiled; end this process then, or when its input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # ctrl-C is for the process that started this one
    threading.Thread(target=_end_with_input, daemon=True).start()
    gc.disable()  # a compiler's objects are looked through again and again otherwise: a tenth of its time
    for row in listed(is_sequence=is_sequence):
        compile_one(*row)
        gc.collect()
        gc.freeze()  # what is left by now stays


def compile_first(*, is_sequence: bool) -> None:
    """Compile what a first frame needs and nobody else does compile, and load the rest of it.

    numba loads and compiles one kernel at a time in a process: a frame could load none while a later kernel compiles.
    """
    rows, was_collecting = listed(is_sequence=is_sequence, is_first=True), gc.isenabled()
    gc.disable()
    try:
        for row in rows:
            compile_one(*row)
    finally:
        if was_collecting:
            gc.enable()
    for row in rows:
        kernel, signature = _find(*row)
        kernel.compile(signature)


def compile_one(module: str, name: str, types: str) -> None:
    """Compile a kernel for the types of its arguments, unless that is done or under way elsewhere."""
    kernel, signature = _find(module, name, types)
    if kernel._cache.is_left(signature, kernel.targetctx):
        kernel.compile(signature)


def _find(module: str, name: str, types: str) -> tuple[Any, Any]:
    """A kernel of the list, and the types of its arguments."""
    from numba.core import types as names

    signature = eval(types, {"__builtins__": {}}, vars(names))  # our own file
    return getattr(importlib.import_module(module), name), signature


def _end_with_input() -> None:
    while os.read(0, 1024):  # not through `sys.stdin`, which an interpreter that ends while it is read aborts for
        pass
    os._exit(0)
