"""Which arrays a stored map has, of which type and shape."""

from __future__ import annotations

import numpy as np

from .._checks import is_rigid
from .._npz import Arrays, Schema
from ..errors import InputError
from ._form import RIG_SCHEMA, Form, check_ascending, check_landmarks, check_least, check_limits, check_starts
from ._frame_schema import COMPLEX_SCHEMA, check_complex

AGAIN = '"tspslam map RUN" makes it'
_UNIT = 1e-6  # off length 1, of a direction

_SIZES = {"vertex": "n", "edge": "e", "face": "f"}
# Letters are sizes that must agree: n vertices, e edges, f faces, m observations, k keyframes, s vertices and one.
_ARRAYS: Schema = {
    **RIG_SCHEMA,
    "xyz": ("<f8", ("n", 3)),
    "covariance": ("<f8", ("n", 3, 3)),
    "surface_faces": ("<i4", ("f", 3)),
    **COMPLEX_SCHEMA,
    **{f"view_count_{level}": ("<i4", (size,)) for level, size in _SIZES.items()},
    **{f"best_view_{level}": ("<i4", (size,)) for level, size in _SIZES.items()},
    "response_view": ("<i4", ("n",)),
    **{f"view_variance_{level}": ("<f8", (size,)) for level, size in _SIZES.items()},
    "direction": ("<f8", ("n", 3)),
    "direction_spread": ("<f8", ("n",)),
    "direction_count": ("<i4", ("n",)),
    "landmark_id": ("<i8", ("n",)),
    "observations_start": ("<i8", ("s",)),
    "observations_keyframe": ("<i8", ("m",)),
    "observations_uv": ("<f8", ("m", 2)),
    "observations_disparity": ("<f8", ("m",)),
    "observations_weight": ("<f8", ("m",)),
    "keyframes": ("<i8", ("k",)),
    "T_world_camera": ("<f8", ("k", 4, 4)),
    "gain": ("<f8", ("k",)),
}
_AT_LEAST_0 = ("direction_spread", "direction_count", "observations_weight", "gain")


def _check_map(arrays: Arrays, lengths: dict[str, tuple[int, ...]]) -> None:
    check_least(arrays, *_AT_LEAST_0, *(name for name in arrays if name.startswith("view_")))
    counts = {name: arrays[name] for name in arrays if name.startswith("view_count_")}
    check_limits(counts, dict.fromkeys(counts, lengths["k"][0] + 1))
    if not ((arrays["observations_weight"] <= 1 + _UNIT).all() and (arrays["gain"] > 0).all()):
        raise InputError("array observations_weight holds more than 1, or gain 0")
    check_complex(arrays, lengths["n"][0], lengths["e"][0])
    if not np.array_equal(np.sort(arrays["surface_faces"], axis=1), arrays["complex_faces"]):
        raise InputError("has surface_faces that are not complex_faces, each wound one way or the other")
    views = [name for name in arrays if name.startswith("best_view_") or name == "response_view"]
    check_limits({name: arrays[name] + 1 for name in views}, dict.fromkeys(views, lengths["k"][0] + 1))
    length = np.linalg.norm(arrays["direction"], axis=1)
    if not ((length == 0) | (np.abs(length - 1) < _UNIT)).all():
        raise InputError("array direction holds one that is neither of length 1 nor 0")
    check_landmarks(arrays, "landmark_id")
    check_ascending(arrays, "keyframes")
    if not is_rigid(arrays["T_world_camera"]):
        raise InputError("array T_world_camera holds no rigid motion")
    _check_observations(arrays, lengths)


def _check_observations(arrays: Arrays, lengths: dict[str, tuple[int, ...]]) -> None:
    n, count = lengths["n"][0], lengths["m"][0]
    start, keyframe = arrays["observations_start"], arrays["observations_keyframe"]
    check_starts(arrays, "observations_start", n, count)
    check_limits(arrays, {"observations_keyframe": lengths["k"][0]})
    vertex = np.repeat(np.arange(n), np.diff(start))
    if ((np.diff(keyframe) <= 0) & (np.diff(vertex) == 0)).any():
        raise InputError("array observations_keyframe does not ascend within a vertex")


FORM = Form(
    "map",
    1,
    _ARRAYS,
    f"{AGAIN} anew",
    _check_map,
    may_be_nan=frozenset({"observations_disparity"}),
    level=0,  # numbers of measurements hardly shrink
)
SCHEMA = FORM.schema
