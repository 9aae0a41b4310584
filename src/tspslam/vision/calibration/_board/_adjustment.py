"""Least squares over one or two cameras and the places of a board: intrinsics, pose of the right camera, covariance.

All that is unknown is one vector: the left camera's numbers, the right one's, the right camera's pose, then six numbers
for each place of the board in the left camera's frame. OpenCV projects, and gives the derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...._brief import Brief
from ....types import LENSES, BoolArray, FloatArray

FOCAL, CENTRE = slice(0, 2), slice(2, 4)  # of a camera's numbers; then those of its lens
_ROUNDS = 4  # of new weights, at most
_SAME = 0.01  # relative change of the standard deviation at which weights stay
_STEPS = 40  # of a round
_ENOUGH = 1e-9  # relative fall of the cost at which a round ends
_HUBER = 3.0  # standard deviations: corners farther off count less
_PER_SIGMA = 1.1774  # median length of a 2-D normal error of standard deviation 1
_FINEST = 1e-4  # px: errors below are rounding
_LARGEST_DAMPING = 1e12


@dataclass(frozen=True, repr=False)
class Seen(Brief):
    """Corners of one place of the board in one camera: place, side (0 left, 1 right), on the board, in the image."""

    place: int
    side: int
    xyz: FloatArray
    uv: FloatArray


@dataclass(frozen=True)
class Shape:
    """Where everything is in the vector of unknowns."""

    lens: str
    sides: int
    places: int

    @property
    def camera(self) -> int:
        """How many numbers a camera has."""
        return 4 + len(LENSES[self.lens])

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return self.sides * self.camera + 6 * (self.sides - 1 + self.places)

    def of_camera(self, side: int) -> slice:
        """Numbers of a camera."""
        return slice(side * self.camera, (side + 1) * self.camera)

    @property
    def of_pose(self) -> slice:
        """Rotation vector and translation from the left camera's frame to the right one's."""
        return slice(2 * self.camera, 2 * self.camera + 6)

    def of_place(self, place: int) -> slice:
        """Rotation vector and translation from the board's frame to the left camera's."""
        start = self.sides * self.camera + 6 * (self.sides - 1 + place)
        return slice(start, start + 6)


@dataclass(frozen=True, repr=False)
class Solution(Brief):
    """Unknowns, their covariance, and residuals (N, 2) of each `Seen`, px; ``cost`` is the sum of Huber's losses."""

    values: FloatArray
    covariance: FloatArray
    residuals: list[FloatArray]
    sigma: float
    cost: float


def adjust(shape: Shape, seen: Sequence[Seen], start: FloatArray, free: BoolArray) -> Solution:
    """Minimise the corners' errors (Levenberg and Marquardt), with Huber's weights at a robust standard deviation."""
    values, scale = start.copy(), np.inf
    residuals = _residuals(shape, seen, values)
    for _ in range(_ROUNDS):
        before, scale = scale, _HUBER * spread(residuals)
        if abs(scale - before) <= _SAME * scale:
            break
        values = _descend(shape, seen, values, free, scale)
        residuals = _residuals(shape, seen, values)
    H, _, cost = _equations(shape, seen, values, scale)
    count = sum(each.size for each in residuals)
    variance = 2 * cost / max(count - int(free.sum()), 1)
    covariance = np.zeros_like(H)
    covariance[np.ix_(free, free)] = _inverse(H[np.ix_(free, free)]) * variance
    return Solution(values, covariance, residuals, float(np.sqrt(variance)), cost)


def spread(residuals: Sequence[FloatArray]) -> float:
    """Robust standard deviation of one coordinate, px."""
    lengths = np.concatenate([np.linalg.norm(each, axis=1) for each in residuals])
    return max(float(np.median(lengths)) / _PER_SIGMA, _FINEST)


def _descend(shape: Shape, seen: Sequence[Seen], values: FloatArray, free: BoolArray, scale: float) -> FloatArray:
    H, g, cost = _equations(shape, seen, values, scale)
    damping = 1e-3
    for _ in range(_STEPS):
        tried = values.copy()
        tried[free] -= _step(H[np.ix_(free, free)], g[free], damping)
        new = _equations(shape, seen, tried, scale)
        if not new[2] < cost:
            damping *= 10
            if damping > _LARGEST_DAMPING:
                break
            continue
        fall, damping = (cost - new[2]) / cost, max(damping / 10, 1e-12)
        values, (H, g, cost) = tried, new
        if fall < _ENOUGH:
            break
    return values


def _step(H: FloatArray, g: FloatArray, damping: float) -> FloatArray:
    diagonal = np.maximum(np.diag(H), 1e-12)
    return np.asarray(np.linalg.solve(H + np.diag(damping * diagonal), g), np.float64)


def _inverse(H: FloatArray) -> FloatArray:
    """Of a matrix whose rows have very different units; directions that nothing determines get a large variance."""
    scale = 1 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    values, vectors = np.linalg.eigh(H * scale[:, None] * scale)
    floor = np.finfo(np.float64).eps * float(values[-1])
    return np.asarray((vectors / np.maximum(values, floor)) @ vectors.T * scale[:, None] * scale)


def _equations(
    shape: Shape, seen: Sequence[Seen], values: FloatArray, scale: float
) -> tuple[FloatArray, FloatArray, float]:
    """Normal equations of the weighted problem, and its cost; infinite where a board would be behind a camera."""
    H, g, cost = np.zeros((shape.size, shape.size)), np.zeros(shape.size), 0.0
    for each in seen:
        uv, J, at = project(shape, values, each)
        r = uv - each.uv
        if not np.isfinite(r).all():
            return H, g, np.inf
        length = np.linalg.norm(r, axis=1)
        weight = np.minimum(1.0, scale / np.maximum(length, 1e-12))
        w = np.repeat(weight, 2)
        cost += float(np.sum(np.where(length <= scale, length**2 / 2, scale * (length - scale / 2))))
        weighted = J * w[:, None]
        H[at[:, None], at] += J.T @ weighted
        g[at] += weighted.T @ r.ravel()
    return H, g, cost


def _residuals(shape: Shape, seen: Sequence[Seen], values: FloatArray) -> list[FloatArray]:
    return [project(shape, values, each)[0] - each.uv for each in seen]


def project(shape: Shape, values: FloatArray, seen: Seen) -> tuple[FloatArray, FloatArray, Any]:
    """Pixels (N, 2) of a place's corners, their derivatives (2 N, M), and the M unknowns that these are after."""
    import cv2

    camera, place = values[shape.of_camera(seen.side)], values[shape.of_place(seen.place)]
    unknowns = np.arange(shape.size)
    numbers, six = unknowns[shape.of_camera(seen.side)], unknowns[shape.of_place(seen.place)]
    if seen.side == 0 or shape.sides == 1:
        uv, of_pose, of_camera = _project(shape.lens, camera, place, seen.xyz)
        return uv, np.hstack([of_camera, of_pose]), np.concatenate([numbers, six])
    pose = values[shape.of_pose]
    made = cv2.composeRT(place[:3], place[3:], pose[:3], pose[3:])
    both = np.concatenate([made[0].ravel(), made[1].ravel()])
    uv, of_both, of_camera = _project(shape.lens, camera, both, seen.xyz)
    turns, moves = np.hstack(made[2:6]), np.hstack(made[6:])
    after_both = of_both[:, :3] @ turns + of_both[:, 3:] @ moves
    return uv, np.hstack([of_camera, after_both]), np.concatenate([numbers, six, unknowns[shape.of_pose]])


def _project(
    lens: str, camera: FloatArray, pose: FloatArray, xyz: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pixels, and their derivatives by the pose (rotation vector, translation) and by the camera's numbers."""
    import cv2

    K = matrix_of(camera)
    turn, move, coefficients = pose[:3].copy(), pose[3:].copy(), camera[4:].copy()
    depth = xyz @ cv2.Rodrigues(turn)[0][2] + move[2]
    if depth.min() <= 0:  # the models would fold it to the front
        return np.full((len(xyz), 2), np.nan), np.zeros((2 * len(xyz), 6)), np.zeros((2 * len(xyz), len(camera)))
    if lens == "equidistant":
        uv, J = cv2.fisheye.projectPoints(xyz.reshape(1, -1, 3), turn, move, K, coefficients)
        return uv.reshape(-1, 2), J[:, 8:14], J[:, :8]
    uv, J = cv2.projectPoints(xyz, turn, move, K, coefficients)
    return uv.reshape(-1, 2), J[:, :6], J[:, 6:]


def matrix_of(camera: FloatArray) -> FloatArray:
    """Intrinsic matrix of a camera's numbers, (3, 3)."""
    return np.array([[camera[0], 0, camera[2]], [0, camera[1], camera[3]], [0, 0, 1.0]])


def undistorted(lens: str, camera: FloatArray, uv: FloatArray) -> FloatArray:
    """Where rays of pixels meet the plane z = 1, (N, 2)."""
    import cv2

    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-12)
    given = np.ascontiguousarray(uv, np.float64).reshape(-1, 1, 2)
    if lens == "equidistant":
        made = cv2.fisheye.undistortPoints(given, matrix_of(camera), camera[4:], criteria=stop)
    else:
        made = cv2.undistortPointsIter(given, matrix_of(camera), camera[4:], None, None, stop)
    return np.asarray(made, np.float64).reshape(-1, 2)
