"""The pose of a camera from landmarks: their windows followed into the image, then least squares without outliers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...types import BoolArray, FloatArray, Rig
from ..images import Pyramid
from ..rig import project
from ..se3 import inverse
from .patch_tracking import follow, warps
from .pose import fit_pose

MIN_MATCHES = 15
SIGMA = 0.3  # px, of a followed point
_GATES = (6.0, 3.5)  # standard deviations beyond which a match is dropped, round by round
_MIN_SHARE = 0.3  # of the followed points that must agree on a pose
# Shares of the landmarks in view that agree with a pose, from KITTI and EuRoC. Right ones: 0.35 to 0.6 at camera rate,
# 0.27 and more at 5 m a frame, 0.1 and more seconds apart. Wrong ones, found near where the camera was not: up to 0.1.
_CLEAR_SHARE = 0.25  # from which a pose needs no second opinion
_MIN_ALONE, MIN_RECOGNISED = 0.12, 0.1  # that a pose needs; with descriptors that led there too
_MIN_STEADY = 0.05  # where the motion goes on as before, as behind an object that fills half of the view
_MANY_MORE = 3  # times the landmarks of the other pose: right poses had 4 and more times those of wrong ones
_SAME = 0.02  # m per m of depth between two poses that are one
_MIN_DEPTH = 0.1  # m
_NEARER = 2.5  # times as near as in the reference, or as far: windows no longer look alike
_NOTHING = 1e-9 * np.eye(6)  # of information, so that all have an inverse


@dataclass(frozen=True)
class _Stage:
    """Levels of the pyramid to go through, px of standard deviation, gates in those, and about how many points."""

    levels: range
    sigma: float
    gates: tuple[float, ...]
    most: int


_ROUGH, _FINE = _Stage(range(3, 0, -1), 2.0, (5.0,), 300), _Stage(range(0, -1, -1), SIGMA, _GATES, 1_000_000)


@dataclass(frozen=True)
class Reference:
    """A keyframe's image, and the landmarks that it was the last to see.

    Attributes
    ----------
    image : Pyramid
        The left image.
    T_world_camera : (4, 4) float64
        Its pose.
    uv : (K, 2) float64
        Where it sees them, px.
    landmark : (K,) int64
        Which they are.
    """

    image: Pyramid
    T_world_camera: FloatArray
    uv: FloatArray
    landmark: NDArray[np.int64]


@dataclass(frozen=True)
class PoseEstimate:
    """A pose, and the landmarks that agree with it.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        The pose.
    landmark : (K,) int64
        Which landmarks.
    uv : (K, 2) float64
        Where they are seen, px.
    disparity : (K,) float64
        px; NaN where not known.
    covariance : (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame.
    in_view : int
        How many landmarks should be seen from there.
    """

    T_world_camera: FloatArray
    landmark: NDArray[np.int64]
    uv: FloatArray
    disparity: FloatArray
    covariance: FloatArray
    in_view: int = 0

    def __len__(self) -> int:
        return len(self.landmark)

    @property
    def share(self) -> float:
        """Share of the landmarks in view that agree."""
        return len(self) / max(self.in_view, 1)


def track_pose(
    rig: Rig, image: Pyramid, references: Sequence[Reference], xyz: FloatArray, T_guess: FloatArray
) -> PoseEstimate | None:
    """Find a camera's pose near a guess, from bearings; None where too few landmarks agree on one.

    Parameters
    ----------
    rig : Rig
        The camera.
    image : Pyramid
        What it shows.
    references : sequence of Reference
        Where the landmarks were seen before.
    xyz : (M, 3) float64
        All landmarks, m.
    T_guess : (4, 4) float64
        ``T_world_camera`` to start from.
    """
    rough = _track_level(rig, image, references, xyz, T_guess, _ROUGH)
    return rough and _track_level(rig, image, references, xyz, rough.T_world_camera, _FINE)


def refine_pose(
    rig: Rig, estimate: PoseEstimate, xyz: FloatArray, disparity: FloatArray, sigma_disparity: float
) -> PoseEstimate:
    """The estimate bettered by disparities of its landmarks; itself if too few agree."""
    measured = replace(estimate, disparity=disparity)
    return _fit_robustly(rig, xyz, measured, SIGMA, sigma_disparity, _GATES) or estimate


def is_clear(estimate: PoseEstimate, xyz: FloatArray, T_ahead: FloatArray | None) -> bool:
    """Whether a pose needs no second opinion: many landmarks agree, or some, and it is where a steady motion has it.

    Parameters
    ----------
    estimate : PoseEstimate
        The pose.
    xyz : (M, 3) float64
        All landmarks, m.
    T_ahead : (4, 4) float64 or None
        Pose that a steady motion leads to; None where the last motion is not known.
    """
    if estimate.share >= _CLEAR_SHARE:
        return True
    return estimate.share >= _MIN_STEADY and T_ahead is not None and _away(estimate, T_ahead, xyz) <= _SAME


def choose_pose(followed: PoseEstimate | None, recognised: PoseEstimate | None, xyz: FloatArray) -> PoseEstimate | None:
    """Which of two poses to believe: the one followed to from a guess, or the one that descriptors led to; or none.

    A camera that moved farther than windows are looked for finds a few landmarks near any guess, so a pose needs enough
    of those in view. Where both have enough, descriptors must lead to many more: they may be those of a moving object.

    Parameters
    ----------
    followed, recognised : PoseEstimate or None
        The two.
    xyz : (M, 3) float64
        All landmarks, m.
    """
    both = followed is not None and recognised is not None and _away(followed, recognised.T_world_camera, xyz) <= _SAME
    if followed is not None and followed.share < (MIN_RECOGNISED if both else _MIN_ALONE):
        followed = None
    if recognised is not None and recognised.share < MIN_RECOGNISED:
        recognised = None
    if followed is None or recognised is None:
        return recognised if followed is None else followed
    return recognised if len(recognised) >= _MANY_MORE * len(followed) else followed


def _away(estimate: PoseEstimate, T_world_camera: FloatArray, xyz: FloatArray) -> float:
    """How far a pose is from another, m per m of depth of its landmarks in the median."""
    depth = float(np.median(_of_camera(xyz, estimate.landmark, estimate.T_world_camera)[:, 2]))
    return float(np.linalg.norm((T_world_camera - estimate.T_world_camera)[:3, 3])) / depth


def _track_level(
    rig: Rig, image: Pyramid, references: Sequence[Reference], xyz: FloatArray, T: FloatArray, stage: _Stage
) -> PoseEstimate | None:
    """Follow what should be seen from a pose, and settle on a pose."""
    visible = [_visible(rig, reference, xyz, T) for reference in references]
    in_view = sum(map(len, visible))
    step = max(1, in_view // stage.most)
    found = [
        _followed(rig, image, reference, rows[::step], xyz, T, stage.levels)
        for reference, rows in zip(references, visible, strict=True)
    ]
    uv, landmark = (np.concatenate(parts) for parts in zip(*found, strict=True))
    estimate = PoseEstimate(T, landmark, uv, np.full(len(uv), np.nan), np.full((6, 6), np.inf), in_view)
    settled = _fit_robustly(rig, xyz, estimate, stage.sigma, 1.0, stage.gates)
    return settled if settled and len(settled) >= _MIN_SHARE * len(estimate) else None


def _visible(rig: Rig, reference: Reference, xyz: FloatArray, T: FloatArray) -> NDArray[np.int64]:
    """Rows of a reference's landmarks that lie in the view of a camera at T, about as near as in the reference."""
    before, now = (_of_camera(xyz, reference.landmark, pose) for pose in (reference.T_world_camera, T))
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = before[:, 2] / now[:, 2]
    alike = (now[:, 2] > _MIN_DEPTH) & (ratio < _NEARER) & (ratio * _NEARER > 1)
    return np.flatnonzero(alike & _inside(rig, project(rig, now)))


def _followed(
    rig: Rig, image: Pyramid, reference: Reference, rows: NDArray[np.int64], xyz: FloatArray, T: FloatArray,
    levels: range,
) -> tuple[FloatArray, NDArray[np.int64]]:  # fmt: skip
    """Places of some of a reference's landmarks in an image that was taken at about the pose T, and which they are."""
    landmark = reference.landmark[rows]
    places = project(rig, _of_camera(xyz, landmark, T))
    shapes = warps(rig, inverse(T) @ reference.T_world_camera, _of_camera(xyz, landmark, reference.T_world_camera))
    uv, good = follow(reference.image, image, reference.uv[rows], shapes, places, levels)
    return uv[good], landmark[good]


def _of_camera(xyz: FloatArray, landmark: NDArray[np.int64], T: FloatArray) -> FloatArray:
    """Landmarks in a camera's frame."""
    seen: FloatArray = (xyz[landmark] - T[:3, 3]) @ T[:3, :3]
    return seen


def _inside(rig: Rig, uv: FloatArray) -> BoolArray:
    with np.errstate(invalid="ignore"):
        inside = (uv >= 0) & (uv <= (rig.width - 1, rig.height - 1))
    return np.asarray(inside[:, 0] & inside[:, 1])


def _fit_robustly(
    rig: Rig, xyz: FloatArray, estimate: PoseEstimate, sigma: float, sigma_disparity: float, gates: tuple[float, ...]
) -> PoseEstimate | None:
    """Least squares on the pose, with fewer and fewer outliers."""
    T, points, seen = (
        estimate.T_world_camera,
        xyz[estimate.landmark],
        np.column_stack([estimate.uv, estimate.disparity]),
    )
    left = np.arange(len(estimate))
    for gate in gates:
        if len(left) < MIN_MATCHES:
            return None
        found = fit_pose(rig, T, points[left], seen[left], (sigma, sigma_disparity))
        T, left = found.T_world_camera, left[found.distance <= gate]
    if len(left) < MIN_MATCHES:
        return None
    found = fit_pose(rig, T, points[left], seen[left], (sigma, sigma_disparity), max_steps=0)
    covariance: FloatArray = np.linalg.inv(found.information + _NOTHING).astype(np.float64)
    return PoseEstimate(
        T, estimate.landmark[left], estimate.uv[left], estimate.disparity[left], covariance, estimate.in_view
    )
