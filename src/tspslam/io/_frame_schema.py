"""Which arrays a stored frame has, of which type and shape."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import is_rigid
from .._npz import Arrays, check_shapes
from ..errors import InputError

MAGIC = "tspslam frame"
VERSION = 2

# Letters are sizes that must agree: n vertices, e edges, f faces, s surface faces, b bytes of the name;
# "c*" and "r*" stand for one more axis (channels of the signals, of the response) or none.
SCHEMA: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "magic": ("|u1", (len(MAGIC),)),
    "version": ("<i8", ()),
    "index": ("<i8", ()),
    "stamp": ("<f8", ()),
    "name": ("|u1", ("b",)),
    "rig": ("<f8", (7,)),
    "image_size": ("<i8", (2,)),
    "T_world_camera": ("<f8", (4, 4)),
    "is_keyframe": ("|b1", ()),
    "is_lost": ("|b1", ()),
    "cloud_xyz": ("<f8", ("n", 3)),
    "cloud_uv": ("<f8", ("n", 2)),
    "cloud_disparity": ("<f8", ("n",)),
    "cloud_covariance": ("<f8", ("n", 3, 3)),
    "landmark": ("<i8", ("n",)),
    "surface_faces": ("<i4", ("s", 3)),
    "complex_n": ("<i8", ()),
    "complex_edges": ("<i4", ("e", 2)),
    "complex_faces": ("<i4", ("f", 3)),
    "complex_face_edges": ("<i4", ("f", 3)),
    "signals_vertex": ("<f8", ("n", "c*")),
    "signals_edge": ("<f8", ("e", "c*")),
    "signals_face": ("<f8", ("f", "c*")),
    "signals_edge_uv": ("<f8", ("e", 2)),
    "signals_face_uv": ("<f8", ("f", 2)),
    "signals_edge_pixels": ("<i4", ("e",)),
    "signals_face_pixels": ("<i4", ("f",)),
    "signals_vertex_ok": ("|b1", ("n",)),
    "signals_edge_ok": ("|b1", ("e",)),
    "signals_face_ok": ("|b1", ("f",)),
    "response_z": ("<c16", ("n", "r*")),
    "response_order": ("<i8", ()),
    "response_defined": ("|b1", ("n",)),
}
OPTIONAL = frozenset({"cloud_covariance", "landmark"})
SINCE_LAST = frozenset({"T_world_camera", "is_keyframe", "is_lost"})  # arrays that version 1 has not
# A point without a projection has NaN pixels.
MAY_BE_NAN = frozenset({"cloud_uv", "cloud_disparity"})
_LARGEST_VALUE = 1e100  # whose square is still finite; covariances of points at infinity come to 1e40


def to_schema(name: str, value: Any) -> NDArray[Any]:
    """Return `value` in the schema's type; it must be exact."""
    code = SCHEMA[name][0]
    array = np.asarray(value)
    if array.dtype.kind == "O" or not np.can_cast(array.dtype, code, "same_kind"):
        raise InputError(f"array {name} has dtype {array.dtype}, where {code} goes")
    stored = np.ascontiguousarray(array.astype(code)).reshape(array.shape)
    if not np.array_equal(stored, array, equal_nan=array.dtype.kind in "fc"):
        raise InputError(f"array {name} does not fit into {code}")
    return stored


def check(arrays: Arrays) -> None:
    """Raise `InputError` unless the arrays, all that are not optional, are those of one consistent frame."""
    known: dict[str, tuple[int, ...]] = {"n": (int(arrays["complex_n"]),)} if arrays["complex_n"].ndim == 0 else {}
    check_shapes(arrays, SCHEMA, known)
    for name, values in arrays.items():
        with np.errstate(over="ignore"):
            is_good = np.abs(values) < _LARGEST_VALUE if values.dtype.kind in "fc" else np.isfinite(values)
        if not (is_good | np.isnan(values) if name in MAY_BE_NAN else is_good).all():
            raise InputError(f"array {name} holds a value that is not finite or too large")
    if arrays["response_order"] < 0:
        raise InputError(f"has a response of order {arrays['response_order']}")
    if arrays["index"] < 0:
        raise InputError(f"has the index {arrays['index']}")
    if "landmark" in arrays:
        _check_landmarks(arrays["landmark"])
    if not is_rigid(arrays["T_world_camera"]):
        raise InputError("array T_world_camera holds no rigid motion")
    _check_indices(arrays, known["n"][0], known["e"][0])


def _check_landmarks(landmark: NDArray[Any]) -> None:
    known = landmark[landmark != -1]
    if (known < 0).any():
        raise InputError(f"array landmark holds {known.min()}, where -1 is the least")
    if len(np.unique(known)) < len(known):
        raise InputError("array landmark holds a landmark twice")


def _check_indices(arrays: Arrays, n: int, n_edges: int) -> None:
    limits = {"surface_faces": n, "complex_edges": n, "complex_faces": n, "complex_face_edges": n_edges}
    for name, limit in limits.items():
        values = arrays[name]
        if values.size and (values.min() < 0 or values.max() >= limit):
            raise InputError(f"array {name} holds {values.min()} to {values.max()}, where 0 to {limit - 1} go")
    edges, faces = arrays["complex_edges"], arrays["complex_faces"]
    if not (np.diff(edges) > 0).all() or not (np.diff(faces) > 0).all():
        raise InputError("has an edge or a face of the complex that does not ascend")
    if not (np.diff(edges @ np.array([n, 1], np.int64)) > 0).all():
        raise InputError("has edges of the complex that are not in lexicographic order")
    sides = faces[:, [[0, 1], [1, 2], [0, 2]]]
    if not np.array_equal(edges[arrays["complex_face_edges"]], sides):
        raise InputError("has complex_face_edges that are not the sides of complex_faces")
