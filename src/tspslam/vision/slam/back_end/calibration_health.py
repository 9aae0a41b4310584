"""Whether the calibration fits what a moving camera saw: the offset of disparities, and the focal length.

Near and far points ask for different motions where disparities are off, and a camera that turns sees its focal length.
A wrong baseline scales path and map alike: nothing in a stereo path tells.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from ....errors import GeometryError
from ....types import FloatArray, Rig
from ...se3 import inverse
from ..keyframes.keyframe import Keyframe
from ..keyframes.map import Map
from ..least_squares.bundle import Observations
from ..least_squares.offsets import Estimate, PieceEquations, Solution
from .disparity_bias import CalibrationHealth, DisparityBias
from .offset_steps import LEAST_DEPTH, find_step

_Make = Callable[[FloatArray, FloatArray, Observations], PieceEquations]  # of poses, points and what is seen

_LAP = 3  # keyframes that two pieces share: a step between them then has two on either side in one; they count twice
_PIECE = 60  # keyframes whose poses are free together: 30 MB of equations, and a second
_LEAST_POINTS = 30  # landmarks that a piece of the path needs: twice what a pose needs
_VAGUE = 10.0  # px; an offset that is known no better is not known
_ONE = np.eye(5)[:, :1]  # one offset of all, of (offset, far less near, right less left, their product, focal length)
_GROUPS, _TURNING = np.eye(5)[:, :4], np.eye(5)[:, [0, 4]]
_SHARED = 0.01  # px, that all matches err alike as they are interpolated: 0.010 in renderings
_HIDDEN = 0.02  # of the offset, that gates hide before it is known: 1 px comes out as 0.96 to 1.02 in renderings
_STEP = 1.5  # times that by which the middle third is off the middle: a step is 2 or more, wherever it is


def measure_health(map_: Map, rig: Rig, sigma_uv: float, sigma_offset: float) -> CalibrationHealth | None:
    """Measure what an adjusted map tells of its calibration.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    rig : Rig
        The cameras as calibrated.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    sigma_offset : float
        Of the offset before anything is seen, px.

    Returns
    -------
    CalibrationHealth or None
        None where there is too little to tell.
    """
    every, used = _Pieces(map_, sigma_uv), rig.doffs - map_.rig.doffs
    ends = np.linspace(0, len(map_.keyframes), 4).astype(int).tolist()
    pieces = every.each(map_.keyframes)
    if not pieces:
        return None
    whole = list(pieces.values())
    offset, spread = Solution(whole, _ONE).combine((1.0,))
    thirds = [_third(every.common(map_.keyframes[start:end]), spread) for start, end in pairwise(ends)]
    far_near, right_left = Solution(whole, _GROUPS).contrast((0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
    return CalibrationHealth(
        offset=_with_prior(_with_shared(offset.plus(used)), sigma_offset),
        thirds=tuple(None if found is None else found.plus(used) for found, _ in thirds),
        drift=_drift([contrast for _, contrast in thirds]),
        far_near=far_near,
        right_left=right_left,
        focal=Solution(whole, _TURNING).contrast((0.0, 1.0))[0],
        step=find_step(pieces, map_),
    )


def _third(pieces: Sequence[PieceEquations], spread: float) -> tuple[Estimate | None, Estimate | None]:
    """The offset of part of a path, and the same where it is what one offset of all would take for chance."""
    if not pieces:
        return None, None
    solution = Solution(pieces, np.eye(1))
    return _known(solution.combine((1.0,), spread)[0]), _known(solution.contrast((1.0,))[0])


def _with_shared(found: Estimate) -> Estimate:
    """An estimate with what no scatter tells: what all matches have in common."""
    return Estimate(found.value, float(np.linalg.norm([found.std, _SHARED, _HIDDEN * found.value])))


def _drift(thirds: Sequence[Estimate | None]) -> Estimate | None:
    """The offset of the last third less that of the first, if the middle one lies about between them."""
    first, middle, last = thirds
    if first is None or last is None:
        return None
    drift = last.less(first)
    wobble = 0.0 if middle is None else middle.value - (first.value + last.value) / 2
    return drift if abs(drift.value) > _STEP * abs(wobble) else Estimate(drift.value, max(drift.std, abs(wobble)))


def _with_prior(found: Estimate, sigma: float) -> Estimate:
    """An estimate with what was known before: where nothing moves, 0 ± `sigma`. A sure one is not pulled to 0."""
    std = float((found.std**-2.0 + sigma**-2.0) ** -0.5)
    return Estimate(found.value * (std / found.std) ** 2 if found.std > sigma else found.value, std)


def _known(found: Estimate) -> Estimate | None:
    return None if found.std > _VAGUE else found


def settle_offset(bias: DisparityBias, map_: Map, rig: Rig, sigma_uv: float) -> bool:
    """Judge an adjusted map: how sure its offset is, and whether that explains what was seen; if not, it is not used.

    Parameters
    ----------
    bias : DisparityBias
        The offset; changed.
    map_ : Map
        Keyframes and landmarks.
    rig : Rig
        The cameras as calibrated.
    sigma_uv : float
        Standard deviation of a tracked point, px.

    Returns
    -------
    bool
        Whether the offset is used; if not, the map is to be adjusted anew.
    """
    health = measure_health(map_, rig, sigma_uv, bias.sigma) if bias.is_used else None
    if health is not None:
        bias.settle(bias.value, health.offset.std)
        bias.health, bias.is_used = health, not health.unexplained
    return bias.is_used


class _Pieces:
    """Pieces of a map's path, each adjusted by itself; neighbours share a few keyframes."""

    def __init__(self, map_: Map, sigma_uv: float) -> None:
        self._map, self._rig, self._sigma_uv = map_, map_.rig, sigma_uv
        disparity = map_.observations()["disparity"]
        known = disparity[np.isfinite(disparity)]
        self._middle = float(np.median(known)) if len(known) else 0.0

    def each(self, frames: Sequence[Keyframe]) -> dict[int, PieceEquations]:
        """Those of keyframes in a row, with an offset of each, piece by piece by the place of its first keyframe.

        Those of the focal length and of groups of points come with them; none where too little is told.
        """
        return self._equations(
            frames,
            lambda T, xyz, seen: PieceEquations(
                self._rig, T, xyz, seen, np.arange(len(T)), _columns(self._rig, T, xyz, seen, self._middle)
            ),
        )

    def common(self, frames: Sequence[Keyframe]) -> list[PieceEquations]:
        """Those of one offset of keyframes in a row."""
        found = self._equations(
            frames,
            lambda T, xyz, seen: PieceEquations(
                self._rig, T, xyz, seen, np.zeros(len(T), np.int64), np.empty((len(seen.pose), 3, 0))
            ),
        )
        return list(found.values())

    def _equations(self, frames: Sequence[Keyframe], make: _Make) -> dict[int, PieceEquations]:
        count = max(1, -(-len(frames) // _PIECE))
        ends = np.linspace(0, len(frames), count + 1).astype(int).tolist()
        found = {start: self._of_piece(frames[start : end + _LAP], make) for start, end in pairwise(ends)}
        return {start: each for start, each in found.items() if each is not None}

    def _of_piece(self, frames: Sequence[Keyframe], make: _Make) -> PieceEquations | None:
        if len(frames) < 2:
            return None
        seen, rows = self._observations(frames)
        if len(rows) < _LEAST_POINTS:
            return None
        try:
            return make(np.stack([frame.T_world_camera for frame in frames]), self._map.xyz[rows], seen)
        except GeometryError:
            return None

    def _observations(self, frames: Sequence[Keyframe]) -> tuple[Observations, FloatArray]:
        """What the keyframes saw of landmarks that two of them see, and the rows of these."""
        landmark = np.concatenate([frame.landmark for frame in frames])
        rows, point, count = np.unique(landmark, return_inverse=True, return_counts=True)
        is_kept = count[point] > 1
        place = np.cumsum(count > 1) - 1
        pose = np.repeat(np.arange(len(frames)), [len(frame.landmark) for frame in frames])
        uv, disparity, sigma = (
            np.concatenate([getattr(frame, name) for frame in frames])[is_kept] for name in ("uv", "disparity", "sigma")
        )
        sigma_uv = np.full(len(uv), self._sigma_uv)
        seen = Observations(pose[is_kept], place[point[is_kept]], uv, disparity, sigma_uv, sigma)
        return seen, rows[count > 1]


def _columns(rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, seen: Observations, middle: float) -> FloatArray:
    """Derivatives of (u, v, disparity), (O, 3, 4), by what groups of points differ in, and by the focal length.

    By the offset of far points less that of near ones, those of a disparity from `middle` on; of those on the right
    less that of those on the left; by the product of both; and by the focal length's logarithm.
    """
    T_camera_world = inverse(T_world_camera)
    points = (
        np.einsum("oij,oj->oi", T_camera_world[seen.pose, :3, :3], xyz[seen.point]) + T_camera_world[seen.pose, :3, 3]
    )
    columns, known = np.zeros((len(points), 3, 4)), np.flatnonzero(np.isfinite(seen.disparity))
    depth = np.maximum(points[:, 2], LEAST_DEPTH)
    expected = rig.fx * rig.baseline / depth - rig.doffs  # as measured ones would choose their group by their errors
    far, right = (np.where(is_so, 0.5, -0.5) for is_so in (expected < middle, seen.uv[:, 0] >= rig.width / 2))
    columns[known, 2, :3] = np.column_stack([far, right, far * right])[known]
    columns[:, 0, 3] = (rig.fx * points[:, 0] + rig.skew * points[:, 1]) / depth
    columns[:, 1, 3] = rig.fy * points[:, 1] / depth
    columns[known, 2, 3] = rig.fx * rig.baseline / depth[known]
    return columns
