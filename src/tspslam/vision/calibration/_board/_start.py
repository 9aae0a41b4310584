"""Where the least squares of a calibration start: a focal length, places of the board, the pose of the right camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....types import LENSES, FloatArray
from ._adjustment import Seen, undistorted

_FOCAL = np.geomspace(0.25, 6.0, 24)  # of the image's width: fields of view of 127° to 10° through a pinhole
_TRIED = 10  # views, or up to twice as many, that tell the focal length to begin with
_WORST = 1e3  # px, of a board that has no place


def start_camera(lens: str, size: tuple[int, int], seen: Sequence[Seen]) -> tuple[FloatArray, dict[int, FloatArray]]:
    """Numbers of a camera with the focal length of `_FOCAL` that fits best, no distortion; and the board's places."""
    best, found, some = np.inf, None, seen[:: max(1, len(seen) // _TRIED)]
    for share in _FOCAL:
        f, (width, height) = share * size[0], size
        camera = np.array([f, f, (width - 1) / 2, (height - 1) / 2, *([0.0] * len(LENSES[lens]))])
        if (middle := _middle_error(lens, camera, some, best)) < best:
            best, found = middle, camera
    assert found is not None
    return found, {each.place: place_board(lens, found, each)[0] for each in seen}


def _middle_error(lens: str, camera: FloatArray, seen: Sequence[Seen], most: float) -> float:
    """Median of the errors of the board's places, px; `most` as soon as it cannot be less."""
    errors: list[float] = []
    for each in seen:
        errors.append(min(place_board(lens, camera, each)[1], _WORST))
        if 2 * sum(error >= most for error in errors) > len(seen):
            return most
    return float(np.median(errors))


def place_board(lens: str, camera: FloatArray, seen: Seen) -> tuple[FloatArray, float]:
    """Rotation vector and translation from the board to a camera, and the root mean square of its error, px."""
    import cv2

    rays = undistorted(lens, camera, seen.uv)
    if not np.isfinite(rays).all() or np.abs(rays).max() > 1e3:
        return _before(seen), np.inf
    eye = np.eye(3)
    middle = seen.xyz.mean(axis=0)
    count, turns, moves, _ = cv2.solvePnPGeneric(seen.xyz - middle, rays[:, None], eye, None, flags=cv2.SOLVEPNP_IPPE)
    best, error = _before(seen), np.inf
    for turn, move in zip(turns[:count], moves[:count], strict=True):
        turn, move = cv2.solvePnPRefineLM(seen.xyz - middle, rays[:, None], eye, None, turn, move)
        R = cv2.Rodrigues(turn)[0]
        points = (seen.xyz - middle) @ R.T + move.ravel()
        if points[:, 2].min() > 0:
            off = points[:, :2] / points[:, 2:] - rays
            if (rms := float(np.sqrt(np.mean(np.sum(off**2, axis=1))))) * camera[0] < error:
                best, error = np.concatenate([turn.ravel(), move.ravel() - R @ middle]), rms * camera[0]
    return best, error


def _before(seen: Seen) -> FloatArray:
    """A place before the camera, for want of a better one."""
    reach = float(np.ptp(seen.xyz, axis=0).max())
    return np.array([0, 0, 0, *(-seen.xyz.mean(axis=0)[:2]), 3 * reach])


def matrix_of_pose(pose: FloatArray) -> FloatArray:
    """Rigid motion (4, 4) of a rotation vector and a translation."""
    import cv2

    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(pose[:3].copy())[0], pose[3:]
    return T


def pose_of_matrix(T: FloatArray) -> FloatArray:
    """Rotation vector and translation of a rigid motion."""
    import cv2

    return np.concatenate([cv2.Rodrigues(T[:3, :3])[0].ravel(), T[:3, 3]])


def start_pose(left: dict[int, FloatArray], right: dict[int, FloatArray]) -> FloatArray:
    """The right camera's pose on which most views agree: that which is nearest to the others in the median."""
    motions = [matrix_of_pose(right[k]) @ np.linalg.inv(matrix_of_pose(left[k])) for k in sorted(left) if k in right]
    sums = []
    for T in motions:
        turns = [np.linalg.norm(T[:3, :3] - other[:3, :3]) for other in motions]
        moves = [
            np.linalg.norm(T[:3, 3] - other[:3, 3]) / max(float(np.linalg.norm(T[:3, 3])), 1e-9) for other in motions
        ]
        sums.append(float(np.median(np.add(turns, moves))))
    return pose_of_matrix(motions[int(np.argmin(sums))])
