"""``tspslam denoise``: a map, a frame or a mesh with less noise, in its places and in its signals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..apps.cloud import denoise_cloud
from ..apps.mesh import denoise_mesh
from ..apps.noise import estimate_noise
from ..apps.signals import denoise_signals
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..types import Cloud, FloatArray, Signals
from .given import Given, Shown, name_beside

FARTHEST = 2.0  # standard deviations that a landmark moves: from 1 to none it hardly matters (maps of development)
LEAST_NOISE = 1e-4  # luminance: a fortieth of a step of 8-bit pixels; below it nothing changes


def denoise(given: Given, *, places: bool = True, signals: bool = True, noise: float | None = None) -> Given:
    """Denoise what a run or a file holds.

    Parameters
    ----------
    given : Given
        As `open_given` reads it.
    places, signals : bool
        Whether vertices are moved, and whether signals are changed. A stereo frame's points move along their rays
        (`denoise_cloud`), a map's vertices by their covariance, a mesh' by its faces (`denoise_mesh`).
    noise : float, optional
        Standard deviation of the noise of luminance, as `denoise_signals` takes it. Default: found, of frames and maps
        in the image and in how views differ.

    Returns
    -------
    Given
        Of the same kind. Response and directions are those that were measured: they are not filtered anew.

    Raises
    ------
    InputError, GeometryError
        If there is nothing to work on.
    """
    smooth = _smooth(given, noise) if signals and has_three_levels(given) else given.signals
    shown = given.shown
    if isinstance(shown, Frame):
        return replace(given, shown=replace(shown, cloud=_cloud(shown) if places else shown.cloud, signals=smooth))
    if isinstance(shown, TopologicalMap):
        return replace(given, shown=replace(shown, xyz=_landmarks(shown) if places else shown.xyz, signals=smooth))
    xyz = denoise_mesh(given.xyz, given.faces) if places else given.xyz
    return replace(given, shown=shown._replace(xyz=xyz, signals=smooth))


def _cloud(frame: Frame) -> Cloud:
    """A stereo frame's points move along their rays; those of a mesh that a photo shows, with their faces."""
    if frame.image is not None and frame.rig.baseline > 0 and frame.cloud.covariance is not None:
        return denoise_cloud(frame.cloud, frame.surface, frame.image, rig=frame.rig)
    return replace(frame.cloud, xyz=denoise_mesh(frame.cloud.xyz, frame.surface.faces))


def _landmarks(map_: TopologicalMap) -> FloatArray:
    """Places of a map by its faces, none farther from where it was measured than its covariance has it."""
    moves = denoise_mesh(map_.xyz, map_.surface.faces, covariance=map_.covariance) - map_.xyz
    known = np.linalg.pinv(map_.covariance, hermitian=True)
    deviations = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", moves, known, moves), 0))
    return map_.xyz + moves * np.minimum(1.0, FARTHEST / np.maximum(deviations, FARTHEST))[:, None]


def has_three_levels(given: Given) -> bool:
    """Say whether edges and faces have signals of their own: not means of vertices, which tell nothing of noise.

    Parameters
    ----------
    given : Given
        As `open_given` reads it.

    Returns
    -------
    bool
    """
    return bool(given.signals.edge_pixels.any() or given.signals.face_pixels.any())


def _smooth(given: Given, noise: float | None) -> Signals:
    shown = given.shown
    uv = shown.cloud.uv if isinstance(shown, Frame) else None
    return denoise_signals(given.complex_, given.signals, uv=uv, noise=_noise(shown) if noise is None else noise)


def _noise(shown: Shown) -> float | None:
    """What is known of the noise of a pixel: a frame's from its image, a map's from how views differ; else nothing."""
    if isinstance(shown, Frame) and shown.image is not None:
        found = estimate_noise(shown.image)
    elif isinstance(shown, TopologicalMap) and (np.asarray(shown.view_count.vertex) > 1).any():
        count = np.asarray(shown.view_count.vertex)
        several = count > 1
        found = float(np.sqrt(np.median(np.asarray(shown.view_variance.vertex)[several] / (count[several] - 1))))
    else:
        return None
    return max(found, LEAST_NOISE)


def describe_change(before: Given, after: Given) -> dict[str, Any]:
    """How far vertices moved, and how much signals changed.

    Parameters
    ----------
    before, after : Given
        Of one complex.

    Returns
    -------
    dict
        ``moved_m`` (median and largest), ``changed`` (root mean square, of each level that has signals).
    """
    moved = np.linalg.norm(after.xyz - before.xyz, axis=1)
    levels = ("vertex", "edge", "face")
    changed = {level: _rms(before.signals, after.signals, level) for level in levels}
    return {
        "moved_m": {"median": float(np.median(moved)), "largest": float(moved.max())} if len(moved) else {},
        "changed": {level: value for level, value in changed.items() if value is not None},
    }


def _rms(before: Signals, after: Signals, level: str) -> float | None:
    ok = getattr(before, f"{level}_ok")
    difference: FloatArray = (getattr(after, level) - getattr(before, level))[ok]
    return float(np.sqrt(np.mean(difference**2))) if difference.size else None


def name_of_result(source: Path) -> Path:
    """Name the result of what `source` is: a run folder's and an .npz's is a VTU, a mesh' is of its own format.

    Parameters
    ----------
    source : path
        The run folder or the file.

    Returns
    -------
    Path
    """
    own = source.suffix.lower()
    return name_beside(source, "denoised", own if own in (".vtu", ".ply") else ".vtu")
