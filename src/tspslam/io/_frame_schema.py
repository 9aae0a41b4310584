"""Which arrays a stored frame has, of which type and shape; those of its complex and signals a map has too."""

from __future__ import annotations

from typing import Any

import numpy as np

from .._checks import is_rigid
from .._npz import Arrays, Schema
from ..errors import InputError
from ..topology.complex import Complex
from ..types import Response, Signals
from ._form import RIG_SCHEMA, Form, check_landmarks, check_least, check_limits, part_of

# Letters are sizes that must agree: n vertices, e edges, f faces, s surface faces, b bytes of the name;
# "c*", "r*" and "p*" stand for one more axis (channels of signals, response and image) or none.
COMPLEX_SCHEMA: Schema = {
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
_ARRAYS: Schema = {
    "index": ("<i8", ()),
    "stamp": ("<f8", ()),
    "name": ("|u1", ("b",)),
    **RIG_SCHEMA,
    "T_world_camera": ("<f8", (4, 4)),
    "is_keyframe": ("|b1", ()),
    "is_lost": ("|b1", ()),
    "cloud_xyz": ("<f8", ("n", 3)),
    "cloud_uv": ("<f8", ("n", 2)),
    "cloud_disparity": ("<f8", ("n",)),
    "cloud_covariance": ("<f8", ("n", 3, 3)),
    "landmark": ("<i8", ("n",)),
    "surface_faces": ("<i4", ("s", 3)),
    **COMPLEX_SCHEMA,
    "image": ("|u1 <u2 <f4", ("h", "w", "p*")),
    "valid": ("|b1", ("h", "w")),
}


def _check_frame(arrays: Arrays, lengths: dict[str, tuple[int, ...]]) -> None:
    check_least(arrays, "index")
    if "landmark" in arrays:
        check_landmarks(arrays, "landmark")
    if not is_rigid(arrays["T_world_camera"]):
        raise InputError("array T_world_camera holds no rigid motion")
    check_limits(arrays, {"surface_faces": lengths["n"][0]})
    check_complex(arrays, lengths["n"][0], lengths["e"][0])
    if "image" in arrays:
        _check_image(arrays)
    if "valid" in arrays:
        _check_mask(arrays)


def _check_mask(arrays: Arrays) -> None:
    shape, (width, height) = arrays["valid"].shape, arrays["image_size"].tolist()
    if shape != (height, width):
        raise InputError(f"array valid has shape {shape}, where {(height, width)} goes")


def _check_image(arrays: Arrays) -> None:
    shape, (width, height) = arrays["image"].shape, arrays["image_size"].tolist()
    if shape not in ((height, width), (height, width, 3)):
        raise InputError(f"array image has shape {shape}, where {(height, width)} or {(height, width, 3)} goes")


def check_complex(arrays: Arrays, n: int, n_edges: int) -> None:
    """Raise `InputError` unless complex, signals and response, of the right shapes, are consistent."""
    check_least(arrays, "signals_edge_pixels", "signals_face_pixels")
    if arrays["response_order"] < 0:
        raise InputError(f"has a response of order {arrays['response_order']}")
    check_limits(arrays, {"complex_edges": n, "complex_faces": n, "complex_face_edges": n_edges})
    edges, faces = arrays["complex_edges"], arrays["complex_faces"]
    if not (np.diff(edges) > 0).all() or not (np.diff(faces) > 0).all():
        raise InputError("has an edge or a face of the complex that does not ascend")
    if not (np.diff(edges @ np.array([n, 1], np.int64)) > 0).all():
        raise InputError("has edges of the complex that are not in lexicographic order")
    sides = faces[:, [[0, 1], [1, 2], [0, 2]]]
    if not np.array_equal(edges[arrays["complex_face_edges"]], sides):
        raise InputError("has complex_face_edges that are not the sides of complex_faces")


def complex_arrays(complex_: Complex, signals: Signals, response: Response) -> dict[str, Any]:
    """Return a complex, its signals and its response as values of `COMPLEX_SCHEMA`."""
    of = {"complex": complex_, "signals": signals, "response": response}
    return {name: getattr(of[name.partition("_")[0]], name.partition("_")[2]) for name in COMPLEX_SCHEMA}


def complex_of(arrays: Arrays) -> tuple[Complex, Signals, Response]:
    """Return what `complex_arrays` was given."""
    complex_, response = part_of(arrays, "complex_"), part_of(arrays, "response_")
    shape = Complex(int(complex_.pop("n")), **complex_)
    answer = Response(response["z"], int(response["order"]), response["defined"])
    return shape, Signals(**part_of(arrays, "signals_")), answer


FORM = Form(
    "frame",
    3,
    _ARRAYS,
    "the run is to be made anew",
    _check_frame,
    optional=frozenset({"cloud_covariance", "landmark", "image", "valid"}),
    may_be_nan=frozenset({"cloud_uv", "cloud_disparity"}),  # a point without a projection has NaN pixels
    plain=frozenset({"image"}),
)
SCHEMA = FORM.schema
