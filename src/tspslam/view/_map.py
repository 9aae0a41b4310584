"""What is shown of a map: luminance, its deviation over views, magnitude and direction of the response, by faces."""

from __future__ import annotations

import numpy as np

from .._checks import require
from ..errors import InputError
from ..topological_map import TopologicalMap
from ..types import FloatArray, one_channel
from ._frame import Shown, is_colour, log_magnitude, on_faces
from ._viewpoints import Outlook


def check_map(map_: TopologicalMap) -> None:
    """Refuse a map whose parts do not belong together.

    Raises
    ------
    InputError
        If it is none, has no keyframe, lengths differ, or a vertex is not finite.
    """
    require(map_, TopologicalMap, "map")
    n, F, K = len(map_.xyz), len(map_.surface.faces), len(map_.keyframes)
    lengths = {
        "complex_.n": (map_.complex_.n, n),
        "complex_.faces": (len(map_.complex_.faces), F),
        "signals.face": (len(map_.signals.face), F),
        "signals.face_ok": (len(map_.signals.face_ok), F),
        "view_count.face": (len(map_.view_count.face), F),
        "view_variance.face": (len(map_.view_variance.face), F),
        "response.z": (len(map_.response.z), n),
        "direction": (len(map_.direction), n),
        "observations.start": (len(map_.observations.start), n + 1),
        "T_world_camera": (len(map_.T_world_camera), K),
    }
    for what, (seen, expected) in lengths.items():
        if seen != expected:
            raise InputError(f"view: the map has {what} of length {seen}, expected {expected}")
    if not K or not (np.isfinite(map_.xyz).all() and np.isfinite(map_.T_world_camera).all()):
        raise InputError("view: the map has no keyframe or places that are not finite, expected one of build_map")


def luminance(map_: TopologicalMap) -> Shown:
    """Mean luminance of each face over the views; a signal with channels shows their mean."""
    return Shown(one_channel(map_.signals.face), map_.signals.face_ok)


def deviation(map_: TopologicalMap) -> Shown:
    """Standard deviation of the luminance of each face that two keyframes or more see."""
    variance = np.asarray(map_.view_variance.face, np.float64)
    return Shown(np.sqrt(one_channel(variance)), np.asarray(map_.view_count.face) > 1)


def magnitude(map_: TopologicalMap) -> Shown:
    """Mean ``log10 |r|`` of each face over those of its vertices that have a response."""
    return on_faces(map_.surface.faces, log_magnitude(map_)[0])


def tangents(map_: TopologicalMap, outlook: Outlook) -> tuple[FloatArray, FloatArray]:
    """Mean direction of each face on a picture.

    Returns
    -------
    angle : (F,) float64
        From the right, clockwise on the picture, rad.
    length : (F,) float64
        In [0, 1]: 1 where the direction lies in the picture, 0 where it stands across it, or is not defined.
    """
    faces = map_.surface.faces
    strength = np.abs(one_channel(map_.response.z)) * map_.defined
    mean = (map_.direction * strength[:, None])[faces].sum(axis=1)
    norm = np.linalg.norm(mean, axis=1, keepdims=True)
    seen = np.divide(mean, norm, out=np.zeros_like(mean), where=norm > 0) @ outlook.axes.T
    flat = seen[:, :2]
    if not outlook.is_above:
        middle = (map_.xyz[faces].mean(axis=1) - outlook.eye) @ outlook.axes.T
        flat = flat - seen[:, 2:] * middle[:, :2] / np.maximum(middle[:, 2:], outlook.near)
    return np.arctan2(flat[:, 1], flat[:, 0]), np.minimum(np.linalg.norm(flat, axis=1), 1.0)


def rgb_of(map_: TopologicalMap) -> FloatArray:
    """Colours of the faces' mean over the views, (F, 3) in [0, 1]: itself if it has three channels, else a grey."""
    signal = map_.signals.face
    return np.clip(signal if is_colour(signal) else np.repeat(one_channel(signal)[:, None], 3, axis=1), 0, 1)
