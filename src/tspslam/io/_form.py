"""Files of ours that hold arrays: one versioned npz each, checked whole before it is written and after it is read."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._files import PathLike, bad_input, read_bytes
from .._npz import Arrays, Schema, check_shapes, read_npz
from ..errors import InputError
from ..types import Rig

T = TypeVar("T")
_LARGEST_VALUE = 1e100  # whose square is still finite; covariances of points at infinity come to 1e40
_RIG = ("fx", "fy", "cx", "cy", "baseline", "skew", "doffs")
RIG_SCHEMA: Schema = {"rig": ("<f8", (len(_RIG),)), "image_size": ("<i8", (2,))}


@dataclass(frozen=True)
class Form:
    """What a kind of file holds.

    Attributes
    ----------
    kind : str
        The file carries the mark ``tspslam`` and this word.
    version : int
        Of its format; others are refused.
    arrays : Schema
        Its arrays; letters are lengths that must agree, ``c*`` is one more axis or none. Those of mark, version and
        sizes are added.
    anew : str
        How one comes by a file of this version.
    check : callable, (Arrays, lengths by letter) -> None
        Raises `InputError` where arrays, of the right types and shapes and finite, do not fit each other.
    optional, may_be_nan, plain : set of str
        Arrays that may be missing, that may hold NaN, and that are stored without compression.
    level : int
        Of compression; 0 for none.
    """

    kind: str
    version: int
    arrays: Schema
    anew: str
    check: Callable[[Arrays, dict[str, tuple[int, ...]]], None]
    optional: Collection[str] = frozenset()
    may_be_nan: Collection[str] = frozenset()
    plain: Collection[str] = frozenset()
    level: int = 1

    @property
    def mark(self) -> bytes:
        """How the file begins."""
        return f"tspslam {self.kind}".encode("ascii")

    @property
    def named(self) -> str:
        """Its kind with an article, if it is one thing."""
        return self.kind if self.kind.endswith("s") else f"a {self.kind}"

    @property
    def schema(self) -> Schema:
        """All arrays, those that tell the kind first."""
        return {"magic": ("|u1", (len(self.mark),)), "version": ("<i8", ()), **self.arrays}


def write_arrays(path: PathLike, form: Form, values: Mapping[str, Any]) -> None:
    """Write values as a file of this form, whole or not at all; equal values give equal bytes."""
    given = {"magic": np.frombuffer(form.mark, np.uint8), "version": form.version, **values}
    schema = form.schema
    try:
        arrays = {name: _to_schema(name, schema[name][0], value) for name, value in given.items()}
        _check(form, arrays)
    except InputError as error:
        raise bad_input(path, f"cannot hold this: {error}", f"{form.named} whose arrays fit") from error
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for name in schema:
            if name in arrays:
                is_plain = name == "magic" or name in form.plain or not form.level  # the first bytes tell the kind
                method = zipfile.ZIP_STORED if is_plain else zipfile.ZIP_DEFLATED
                archive.writestr(_entry(name), _npy(arrays[name]), method, form.level)
    write_bytes(path, packed.getvalue())


def read_arrays(path: PathLike, form: Form, make: Callable[[Arrays], T], only: Collection[str] | None = None) -> T:
    """Return what `make` makes of the arrays of a file of this form; what it refuses is told of the file.

    Of `only` some arrays are read, shapes and numbers are checked, but not whether they fit the others.
    """
    expected = f"{form.named} of format version {form.version}"
    data = read_bytes(path, expected)

    def check_mark(name: str, values: NDArray[Any]) -> None:
        if name == "magic" and values.tobytes() != form.mark:
            raise InputError(f"does not carry the mark of {form.named}")
        if name == "version" and (values.shape != () or int(values) != form.version):
            raise InputError(f"has the format version {str(values.tolist())[:40]}{_way_out(form, values)}")

    try:
        wanted = None if only is None else {"magic", "version", *only}
        arrays = read_npz(data, form.schema, optional=form.optional, check=check_mark, only=wanted)
        _check(form, arrays, is_whole=only is None)
        return make(arrays)
    except (InputError, UnicodeDecodeError, MemoryError) as error:
        raise bad_input(path, str(error), expected) from error


def _way_out(form: Form, version: NDArray[Any]) -> str:
    """How to come by a file of today's version, where the one at hand is whole and of another."""
    if version.shape != () or int(version) <= 0:
        return ""
    return f" of {'a former' if int(version) < form.version else 'a later'} tspslam, and {form.anew}"


def _to_schema(name: str, codes: str, value: Any) -> NDArray[Any]:
    """Return `value` in the schema's type, of several in its own; it must be exact."""
    array = np.asarray(value)
    little = array.dtype.newbyteorder("<").str
    code = little if little in codes.split() else codes.split()[0]
    if array.dtype.kind == "O" or not np.can_cast(array.dtype, code, "same_kind"):
        raise InputError(f"array {name} has dtype {array.dtype}, where {' or '.join(codes.split())} goes")
    stored = np.ascontiguousarray(array.astype(code)).reshape(array.shape)
    if not np.array_equal(stored, array, equal_nan=array.dtype.kind in "fc"):
        raise InputError(f"array {name} does not fit into {code}")
    return stored


def _check(form: Form, arrays: Arrays, *, is_whole: bool = True) -> None:
    lengths: dict[str, tuple[int, ...]] = {}
    if "complex_n" in arrays and arrays["complex_n"].ndim == 0:
        lengths["n"] = (int(arrays["complex_n"]),)
    check_shapes(arrays, form.schema, lengths)
    for name, values in arrays.items():
        if values.dtype.kind in "fc":
            with np.errstate(over="ignore"):
                is_good = np.abs(values) < _LARGEST_VALUE
            if not (is_good | np.isnan(values) if name in form.may_be_nan else is_good).all():
                raise InputError(f"array {name} holds a value that is not finite or too large")
    if is_whole:
        form.check(arrays, lengths)


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(f"{name}.npy", (1980, 1, 1, 0, 0, 0))
    # Otherwise these two tell the operating system that wrote the file.
    entry.create_system, entry.external_attr = 3, 0o600 << 16
    return entry


def _npy(values: NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array(stream, values, version=(1, 0), allow_pickle=False)
    return stream.getvalue()


def part_of(arrays: Arrays, prefix: str) -> Arrays:
    """Return the arrays whose names begin so, by the rest of their names."""
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


def rig_arrays(rig: Rig) -> dict[str, list[float]]:
    """Return a rig as values of `RIG_SCHEMA`."""
    return {"rig": [float(getattr(rig, key)) for key in _RIG], "image_size": [rig.width, rig.height]}


def rig_of(arrays: Arrays) -> Rig:
    """Return the rig that `rig_arrays` gave; `InputError` if it is none."""
    width, height = arrays["image_size"].tolist()
    return Rig(width=width, height=height, **dict(zip(_RIG, arrays["rig"].tolist(), strict=True)))


def check_least(arrays: Arrays, *names: str, least: float = 0) -> None:
    """Raise `InputError` where one of these arrays holds less."""
    for name in names:
        if arrays[name].size and arrays[name].min() < least:
            raise InputError(f"array {name} holds {arrays[name].min():g}, where {least} is the least")


def check_limits(arrays: Arrays, limits: Mapping[str, int]) -> None:
    """Raise `InputError` where one of these arrays of indices holds a negative one, or one from its limit on."""
    for name, limit in limits.items():
        values = arrays[name]
        if values.size and (values.min() < 0 or values.max() >= limit):
            raise InputError(f"array {name} holds {values.min()} to {values.max()}, where 0 to {limit - 1} go")


def check_ascending(arrays: Arrays, *names: str) -> None:
    """Raise `InputError` where one of these arrays holds a number below 0, or does not grow from one to the next."""
    check_least(arrays, *names)
    for name in names:
        if not (np.diff(arrays[name]) > 0).all():
            raise InputError(f"array {name} does not ascend")


def check_starts(arrays: Arrays, name: str, rows: int, count: int) -> None:
    """Raise `InputError` unless an array says where each of `rows` rows of a CSR begins, and where its `count` end."""
    start = arrays[name]
    if len(start) != rows + 1:
        raise InputError(f"array {name} has shape {start.shape}, where {(rows + 1,)} goes")
    if start[0] != 0 or start[-1] != count or not (np.diff(start) >= 0).all():
        raise InputError(f"array {name} does not ascend from 0 to {count}")


def check_landmarks(arrays: Arrays, name: str) -> None:
    """Raise `InputError` unless an array holds -1, and numbers of landmarks once each."""
    check_least(arrays, name, least=-1)
    known = arrays[name][arrays[name] != -1]
    if len(np.unique(known)) < len(known):
        raise InputError(f"array {name} holds a landmark twice")
