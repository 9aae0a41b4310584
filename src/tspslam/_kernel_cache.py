"""Where compiled kernels are kept: a folder of the user's own, keyed by what they are made of, shared by environments.

A kernel's file is named by its code, the code and constants that it uses, the versions that compiled it, and the
processor: another environment, or another copy of the package, finds it; a changed one does not. Files hold machine
code: a folder that others can write is not used.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import platform
import secrets
import sys
import time
import types
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import compiler, config
from numba.core.caching import _Cache
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

FOLDER = "tspslam-kernels"
_DIGEST = 32  # bytes of SHA-256 before the content of each file: a torn file is none
_NAME = 16  # hexadecimal digits of a key in a file's name
_PATIENCE = 60.0  # s that one process waits for another's compilation: several times the longest
_PAUSE = 0.01  # s between two looks
_KEPT = 90 * 86_400.0  # s that a file nobody asked for stays
_DAY = 86_400.0  # s; a file that is read is marked as used once in this time


class KernelCache(_Cache):  # type: ignore[misc]
    """The specialisations of one function on disk, a file each; numba asks it before it compiles.

    While one process compiles, others that need the same wait for it.

    Parameters
    ----------
    function : function
        What is compiled.
    folder : path
        As `find_folder` gives it.
    options : dict
        How it is compiled.
    """

    def __init__(self, function: types.FunctionType, folder: Path, options: dict[str, Any]) -> None:
        self._function, self._folder, self._options = function, folder, options
        self._claims: dict[Path, int] = {}

    @property
    def cache_path(self) -> str:
        """The folder."""
        return str(self._folder)

    def enable(self) -> None:
        """Nothing: it always is."""

    def disable(self) -> None:
        """Nothing."""

    def flush(self) -> None:
        """Remove the files of this function."""
        for path in self._folder.glob(f"{self.stem}.*"):
            path.unlink(missing_ok=True)

    @cached_property
    def stem(self) -> str:
        """How the names of this function's files begin."""
        key = _hash(self._function.__qualname__, fingerprint(self._function), _tell(self._options))
        return f"{self._function.__name__}-{key[:_NAME]}"

    def is_filled(self) -> bool:
        """Whether any specialisation is there."""
        return next(self._folder.glob(f"{self.stem}.*.bin"), None) is not None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled specialisation, or None: then the caller is to compile it, and others wait."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        payload = _read(path)
        if payload is None and self._wait_for_claim(path):
            payload = _read(path)
            if payload is not None:
                self._let_go(path)
        return None if payload is None else compiler.CompileResult._rebuild(target_context, *payload)

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a specialisation, if the disk has room."""
        path = self._path(sig, data.codegen)
        if not data.lifted and not data.library.has_dynamic_globals:
            with contextlib.suppress(OSError):
                _write(path, dumps(data._reduce()))
                _forget_old(self._folder)
        self._let_go(path)

    def is_left(self, sig: Any, target_context: Any) -> bool:
        """Whether a specialisation is neither there nor being compiled by another process."""
        target_context.refresh()
        path = self._path(sig, target_context.codegen())
        if path.exists():
            return False
        descriptor = _claim(path)
        if descriptor is None:
            return False
        _release(path, descriptor)
        return True

    def _path(self, sig: Any, codegen: Any) -> Path:
        flags = config.OPT, config.LOOP_VECTORIZE, config.SLP_VECTORIZE, config.BOUNDSCHECK, config.DEBUGINFO_DEFAULT
        key = _hash(repr(sig), str(sig), *map(str, codegen.magic_tuple()), *map(str, flags))
        return self._folder / f"{self.stem}.{key[:_NAME]}.bin"

    def _wait_for_claim(self, path: Path) -> bool:
        """Wait until no other process compiles this, and keep others waiting; False if the folder refuses.

        A compilation of our own that was interrupted, or failed, has left its claim: numba compiles one at a time.
        """
        if path in self._claims:
            return True
        last = time.monotonic() + _PATIENCE
        while time.monotonic() < last:
            try:
                descriptor = _claim(path)
            except OSError:
                return False
            if descriptor is not None:
                self._claims[path] = descriptor
                return True
            time.sleep(_PAUSE)
        return False

    def _let_go(self, path: Path) -> None:
        descriptor = self._claims.pop(path, None)
        if descriptor is not None:
            _release(path, descriptor)


@cache
def find_folder() -> Path | None:
    """The folder for this interpreter and these versions: made if need be; None where none is safe and writable."""
    version = f"{sys.implementation.cache_tag}-{platform.machine()}"
    packages = _hash(sys.version, numba.__version__, llvmlite.__version__, np.__version__)[:_NAME]
    for base in filter(Path.is_absolute, _bases()):
        folder = base / FOLDER / f"{version}-{packages}"
        with contextlib.suppress(OSError):
            for made in (base / FOLDER, folder):
                made.parent.mkdir(parents=True, exist_ok=True)
                made.mkdir(mode=0o700, exist_ok=True)
            if _is_own(base / FOLDER) and _is_own(folder) and os.access(folder, os.W_OK):
                return folder
    return None


def _bases() -> list[Path]:
    """Where the folder may be: as NUMBA_CACHE_DIR says, or in the user's cache, or beside this file."""
    if config.CACHE_DIR:
        return [Path(config.CACHE_DIR).absolute()]
    return [Path(AppDirs("tspslam", False).user_cache_dir), Path(__file__).parent / "__pycache__"]


def _is_own(folder: Path) -> bool:
    """Whether a folder, no link to one, is this user's, and no one else's to write in."""
    if folder.is_symlink() or not folder.is_dir():
        return False
    if not hasattr(os, "getuid"):  # Windows: a user's folders are closed to others
        return True
    status = folder.stat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


@cache
def fingerprint(function: types.FunctionType) -> str:
    """Hash of a function's code and of all that is compiled into it: functions that it calls, constants it names."""
    return _hash(*_parts(function, set()))


def _parts(function: types.FunctionType, seen: set[int]) -> list[str]:
    """Byte code, constants and named globals of a function, and the same of the kernels among these."""
    if id(function) in seen:
        return [function.__name__]
    seen.add(id(function))
    parts = [function.__module__, *_code_parts(function.__code__, function.__doc__)]
    for name in sorted(_names(function.__code__) & function.__globals__.keys()):
        parts += [name, *_value_parts(function.__globals__[name], seen)]
    return [*parts, *(part for cell in function.__closure__ or () for part in _value_parts(cell.cell_contents, seen))]


def _code_parts(code: types.CodeType, doc: str | None = None) -> list[str]:
    """Byte code, names and constants, but what only explains."""
    parts = [code.co_code.hex(), repr(code.co_names), repr(code.co_varnames)]
    for each in (constant for constant in code.co_consts if doc is None or constant != doc):
        parts += _code_parts(each) if isinstance(each, types.CodeType) else [_tell(each)]
    return parts


def _names(code: types.CodeType) -> set[str]:
    inner = (_names(each) for each in code.co_consts if isinstance(each, types.CodeType))
    return set(code.co_names).union(*inner)


def _value_parts(value: Any, seen: set[int]) -> list[str]:
    """What tells a global from another one, the next time too."""
    if hasattr(value, "py_func"):
        return [_tell(value.targetoptions), *_parts(value.py_func, seen)]
    if isinstance(value, types.ModuleType):
        return [value.__name__]
    if isinstance(value, np.ndarray):
        return [repr(value.dtype), repr(value.shape), value.tobytes().hex()]
    if callable(value):  # compiled by other rules, such as an intrinsic's: of such, the whole file counts
        made_by = getattr(value, "_defn", value)
        return [getattr(made_by, "__name__", ""), _file_hash(getattr(made_by, "__module__", ""))]
    return [_tell(value)]


def _tell(value: Any) -> str:
    """`repr`, but the same in each process: sets and dictionaries in order."""
    if isinstance(value, dict):
        return str(sorted((str(key), _tell(each)) for key, each in value.items()))
    return str(sorted(map(repr, value))) if isinstance(value, set | frozenset) else repr(value)


@cache
def _file_hash(module: str) -> str:
    """Hash of the source of one of our modules; of others the version is in the folder's name."""
    source = getattr(sys.modules.get(module), "__file__", None)
    if not module.startswith(f"{__package__}.") or source is None:
        return module
    try:
        return _hash(Path(source).read_bytes().hex())
    except OSError:
        return module


def _hash(*parts: Any) -> str:
    return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()


def _read(path: Path) -> Any:
    """What a file holds; None if it is not there, torn, or names what this version of the package has not."""
    try:
        data = path.read_bytes()
        if time.time() - path.stat().st_mtime > _DAY:
            os.utime(path)
    except OSError:
        return None
    if hashlib.sha256(data[_DIGEST:]).digest() != data[:_DIGEST]:
        return None
    try:
        return pickle.loads(data[_DIGEST:])
    except (ImportError, AttributeError):  # made by another version of the package, which has other files
        return None


def _write(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    temporary = path.with_suffix(f".{secrets.token_hex(8)}.tmp")
    try:
        temporary.write_bytes(hashlib.sha256(data).digest() + data)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


_tidied: set[Path] = set()


def _forget_old(folder: Path) -> None:
    """Remove what no process has used for long, of older versions too; once a process."""
    if folder in _tidied:
        return
    _tidied.add(folder)
    oldest = time.time() - _KEPT
    for path in folder.parent.glob("*/*"):
        with contextlib.suppress(OSError):
            if path.lstat().st_mtime < oldest:
                path.unlink()


def _claim(path: Path) -> int | None:
    """Keep other processes from compiling what will be at `path`; None if one does. The system lets go with us."""
    lock = path.with_suffix(".lock")
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        os.close(descriptor)
        return None
    except OSError:
        os.close(descriptor)
        raise
    if sys.platform != "win32" and not _is_at(descriptor, lock):
        os.close(descriptor)
        return None
    return descriptor


def _is_at(descriptor: int, path: Path) -> bool:
    """Whether an open file is the one at `path` still: who released it has removed it, and another may be there."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _release(path: Path, descriptor: int) -> None:
    with contextlib.suppress(OSError):  # an open file cannot be removed on Windows
        if sys.platform != "win32":
            path.with_suffix(".lock").unlink(missing_ok=True)
    os.close(descriptor)
