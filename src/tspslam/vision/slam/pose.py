"""Pose of one camera from points whose places are known: perspective-n-point, then least squares."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ..._checks import is_rigid, told
from ...errors import GeometryError, InputError
from ...types import Cloud, FloatArray, Rig
from ..rig import project
from ..se3 import inverse
from ..stereo.reconstruct import Stereo
from .least_squares.bundle import NO_SOLUTION, SEARCH, lens_of

if TYPE_CHECKING:
    import cv2

_NOTHING = 1e-9 * np.eye(6)  # information added, so that all matrices have an inverse
_HUBER, _STEPS = 2.5, 10  # standard deviations beyond which a cost is linear; Levenberg-Marquardt steps of a fit
_SAMPLES, _SURE = 2000, 0.999  # of RANSAC: enough where up to 85 % are outliers, as three points make a pose


@dataclass(frozen=True, repr=False)
class Rival(Brief):
    """Another pose that many landmarks agree on, as where a vehicle fills much of the view.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        The pose.
    landmarks : int
        How many agree on it.
    probability : float
        Of its being the right one.
    covariance : (6, 6) float64
        Of (ω, υ), rad and m, in its own frame.
    """

    T_world_camera: FloatArray
    landmarks: int
    probability: float
    covariance: FloatArray


@dataclass(frozen=True, repr=False)
class PoseEstimate(Brief):
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
    found : int
        How many of those were found in the image, whether or not they agree.
    rival : Rival or None
        Another pose that may be the right one.
    """

    T_world_camera: FloatArray
    landmark: NDArray[np.int64]
    uv: FloatArray
    disparity: FloatArray
    covariance: FloatArray
    in_view: int = 0
    found: int = 0
    rival: Rival | None = None

    def __len__(self) -> int:
        return len(self.landmark)

    @property
    def share(self) -> float:
        """Share of the landmarks in view that agree."""
        return len(self) / max(self.in_view, 1)

    @property
    def agreement(self) -> float:
        """Share of the landmarks that were found that agree; 1 where that was not counted."""
        return len(self) / max(self.found, len(self), 1)


@dataclass(frozen=True, repr=False)
class Tracked(Brief):
    """Where a frame was taken, and which landmarks it sees.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        Pose of the left camera; the world is the first frame's.
    covariance : (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame: of the pose against the last keyframe (`pose_covariance`). Infinite
        where it is not known.
    matches : int
        Landmarks that agree with it.
    is_keyframe : bool
        Whether the map rests on it.
    is_lost : bool
        Whether too few landmarks were found: the pose is that of a constant velocity.
    stereo : Stereo or None
        What both images show, where that was looked for.
    seconds : dict
        Time of following, of the points of a keyframe, of adding it to the map, and of waiting for an adjustment, s;
        varies from run to run.
    landmark : (K,) int64
        Numbers of the landmarks that it sees (`Map.landmark_id`), which stay.
    uv : (K, 2) float64
        Where, px.
    disparity : (K,) float64
        As measured, px; NaN where not known.
    """

    T_world_camera: FloatArray
    covariance: FloatArray = field(default_factory=lambda: np.full((6, 6), np.inf))
    matches: int = 0
    is_keyframe: bool = False
    is_lost: bool = False
    stereo: Stereo | None = None
    seconds: dict[str, float] = field(default_factory=dict)
    landmark: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    uv: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    disparity: FloatArray = field(default_factory=lambda: np.empty(0))

    def __post_init__(self) -> None:
        """Refuse a pose that is none, and columns that do not fit; what they mean is left to the odometry."""
        T, K = self.T_world_camera, np.shape(self.landmark)
        if np.shape(T) != (4, 4) or not is_rigid(np.asarray(T, np.float64)):
            raise InputError(f"tracked: T_world_camera is {told(T)}, expected a (4, 4) rigid motion")
        if len(K) != 1 or np.shape(self.uv) != (*K, 2) or np.shape(self.disparity) != K:
            shapes = ", ".join(str(np.shape(column)) for column in (self.landmark, self.uv, self.disparity))
            raise InputError(f"tracked: landmark, uv, disparity have shapes {shapes}, expected (K,), (K, 2), (K,)")
        landmark = np.asarray(self.landmark)
        if landmark.dtype.kind not in "iu" or (landmark < 0).any() or _has_twice(landmark):
            raise InputError(f"tracked: landmark is {told(landmark)}, expected whole numbers from 0, each once")

    def landmarks_of(self, cloud: Cloud, within: float = 1.0) -> NDArray[np.int64]:
        """Tell which landmark each point of the frame's cloud is.

        Parameters
        ----------
        cloud : Cloud
            N points of this frame.
        within : float
            Largest distance of the two in u, v and disparity, px.

        Returns
        -------
        (N,) int64
            Numbers of landmarks, each at most once; -1 where a point is none.
        """
        from scipy.spatial import cKDTree

        seen = np.column_stack([self.uv, self.disparity])
        known = np.flatnonzero(np.isfinite(seen).all(axis=1))
        found = np.full(len(cloud), -1)
        if len(known):
            points = np.column_stack([cloud.uv, cloud.disparity])
            away, nearest = cKDTree(seen[known]).query(points, distance_upper_bound=within)
            order = np.argsort(away, kind="stable")
            one, first = np.unique(nearest[order], return_index=True)  # the nearest point of each
            is_seen = one < len(known)
            found[order[first[is_seen]]] = self.landmark[known[one[is_seen]]]
        return found


def _has_twice(numbers: NDArray[np.integer]) -> bool:
    ascending = np.sort(numbers)  # a fifth of the time of `np.unique`
    return bool((ascending[1:] == ascending[:-1]).any())


@dataclass(frozen=True)
class PoseFit:
    """What `fit_pose` found.

    Attributes
    ----------
    T_world_camera : (4, 4) float64
        The pose.
    information : (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame: inverse of the covariance.
    distance : (N,) float64
        Length of each residual, standard deviations; infinity where the point is behind the camera.
    """

    T_world_camera: FloatArray
    information: FloatArray
    distance: FloatArray


def fit_pose(
    rig: Rig,
    T_world_camera: FloatArray,
    xyz: FloatArray,
    seen: FloatArray,
    sigma: tuple[float, float | FloatArray],
    *,
    huber: float = _HUBER,
    max_steps: int = _STEPS,
) -> PoseFit:
    """Find the pose that agrees best with where known points are seen: `bundle.adjust` of a single camera, compiled.

    Parameters
    ----------
    rig : Rig
        The camera.
    T_world_camera : (4, 4) float64
        Where to start.
    xyz : (N, 3) float64
        Points in the world, m.
    seen : (N, 3) float64
        Their (u, v, disparity), px; a disparity NaN makes a bearing.
    sigma : (float, float or (N,) float64)
        Standard deviations of pixels and of disparities, px.
    huber : float
        Width of the Huber cost, standard deviations.
    max_steps : int
        Levenberg-Marquardt steps.

    Returns
    -------
    PoseFit

    Raises
    ------
    GeometryError
        If the equations have no solution at any damping.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> xyz = np.random.default_rng(0).uniform((-1, -1, 3), (1, 1, 6), (30, 3))
    >>> uv = xyz[:, :2] / xyz[:, 2:] * 500 + (320, 240)
    >>> off = np.eye(4)
    >>> off[0, 3] = 0.2
    >>> found = fit_pose(rig, off, xyz, np.column_stack([uv, 50 / xyz[:, 2]]), (1.0, 1.0))
    >>> bool(np.abs(found.T_world_camera - np.eye(4)).max() < 1e-6)
    True
    """
    return _fitted(rig, T_world_camera, xyz, seen, sigma, (), 0, (0, max_steps), huber)[0]


def _fitted(
    rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, seen: FloatArray, sigma: tuple[float, float | FloatArray],
    gates: tuple[float, ...], fewest: int, steps: tuple[int, int], huber: float = _HUBER,
) -> tuple[PoseFit, NDArray[np.int64]]:  # fmt: skip
    """The fit, and the rows that no gate drops; with gates, `xyz` and `seen` are written over."""
    from .least_squares._kernels import fit_camera

    T, weights, rows = inverse(T_world_camera), np.empty((len(xyz), 2)), np.arange(len(xyz))
    weights[:, 0], weights[:, 1] = sigma[0] ** -2.0, np.asarray(sigma[1]) ** -2.0
    pose, information, distance = (T[:3, :3].copy(), T[:3, 3].copy()), np.empty((6, 6)), np.empty(len(xyz))
    known = xyz, seen, weights, huber, SEARCH, np.array(gates, np.float64), fewest, steps
    count = fit_camera(lens_of(rig), *pose, *known, rows, information, distance)
    if count < 0:
        raise GeometryError(f"pose: {NO_SOLUTION}")
    T[:3, :3], T[:3, 3] = pose
    return PoseFit(inverse(T), information, distance), rows[:count]


def fit_robustly(
    rig: Rig, xyz: FloatArray, estimate: PoseEstimate, sigma: tuple[float, float | FloatArray],
    gates: tuple[float, ...], min_matches: int,
) -> PoseEstimate | None:  # fmt: skip
    """Fit a pose to its landmarks with fewer and fewer outliers; None where too few are left.

    Parameters
    ----------
    rig : Rig
        The camera.
    xyz : (M, 3) float64
        All landmarks, m.
    estimate : PoseEstimate
        Where to start, and which landmarks are seen where.
    sigma : (float, float or (K,) float64)
        Standard deviations of pixels and of disparities, px.
    gates : tuple of float
        Standard deviations beyond which an observation is dropped, round by round.
    min_matches : int
        Landmarks that a pose needs.

    Returns
    -------
    PoseEstimate or None
    """
    seen = np.column_stack([estimate.uv, estimate.disparity])
    given = estimate.T_world_camera, xyz[estimate.landmark], seen, sigma, gates, min_matches, (_STEPS, 0)
    found, left = _fitted(rig, *given)
    if len(left) < min_matches:
        return None
    covariance: FloatArray = np.linalg.inv(found.information + _NOTHING).astype(np.float64)
    rows = estimate.landmark[left], estimate.uv[left], estimate.disparity[left]
    return PoseEstimate(found.T_world_camera, *rows, covariance, estimate.in_view, estimate.found)


def expected_sights(rig: Rig, T_world_camera: FloatArray, xyz: FloatArray) -> FloatArray:
    """Find where a camera should see points, and at which disparities.

    Parameters
    ----------
    rig : Rig
        The cameras, with the offset of the disparities in their `doffs`.
    T_world_camera : (4, 4) float64
        The camera's pose.
    xyz : (N, 3) float64
        Points in the world, m.

    Returns
    -------
    (N, 3) float64
        (u, v, disparity), px; u and v are NaN behind the camera.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> expected_sights(rig, np.eye(4), np.array([[0.0, 0.2, 2.0]])).tolist()
    [[320.0, 290.0, 25.0]]
    """
    camera = (xyz - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.column_stack([project(rig, camera), rig.fx * rig.baseline / camera[:, 2] - rig.doffs])


def distances_to_sights(rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, uv: FloatArray) -> FloatArray:
    """Find how far from where a camera should see points they were seen.

    Parameters
    ----------
    rig : Rig
        The camera.
    T_world_camera : (4, 4) float64
        The camera's pose.
    xyz : (N, 3) float64
        Points in the world, m.
    uv : (N, 2) float64
        Where they were seen, px.

    Returns
    -------
    (N,) float64
        px; NaN behind the camera.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> points, seen = np.array([[0.0, 0.2, 2.0], [0, 0, -1]]), np.array([[323.0, 294], [320, 240]])
    >>> distances_to_sights(rig, np.eye(4), points, seen).tolist()
    [5.0, nan]
    """
    camera = (xyz - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    with np.errstate(divide="ignore", invalid="ignore"):
        off: FloatArray = np.linalg.norm(project(rig, camera) - uv, axis=1)
    return off


def distance_to_sights(rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, estimate: PoseEstimate) -> float:
    """Find how far from where a camera should see the landmarks of an estimate they were seen, in the median.

    Parameters
    ----------
    rig : Rig
        The camera.
    T_world_camera : (4, 4) float64
        The camera's pose.
    xyz : (M, 3) float64
        All landmarks, m.
    estimate : PoseEstimate
        Where which of them were seen.

    Returns
    -------
    float
        px; infinite where most are behind that camera.
    """
    off = distances_to_sights(rig, T_world_camera, xyz[estimate.landmark], estimate.uv)
    return float(np.median(np.nan_to_num(off, nan=np.inf)))


def solve_pnp(rig: Rig, xyz: FloatArray, uv: FloatArray, *, max_error: float, min_matches: int) -> FloatArray | None:
    """Pose of a camera from points and where it sees them, many of them wrong: P3P in random samples (RANSAC).

    Parameters
    ----------
    rig : Rig
        The camera.
    xyz : (N, 3) float64
        Points, m.
    uv : (N, 2) float64
        Where they are seen, px.
    max_error : float
        Largest distance of a point that agrees from where it is seen, px.
    min_matches : int
        Points that must agree.

    Returns
    -------
    (4, 4) float64 or None
        ``T_world_camera``; None if too few agree on one.
    """
    import cv2

    if len(xyz) < min_matches:
        return None
    K = np.array([[rig.fx, rig.skew, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])
    found, _, turn, t, kept = cv2.solvePnPRansac(xyz, uv, K, None, params=_usac(max_error))
    if not found or kept is None or len(kept) < min_matches:
        return None
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(turn)[0].T
    T[:3, 3] = -T[:3, :3] @ t[:, 0]
    return T


def _usac(max_error: float) -> cv2.UsacParams:
    """How samples are drawn and judged: a third of the time of OpenCV's first RANSAC, which takes four points."""
    import cv2

    params = cv2.UsacParams()
    params.threshold, params.confidence, params.maxIterations = max_error, _SURE, _SAMPLES
    params.sampler, params.score, params.loMethod = cv2.SAMPLING_UNIFORM, cv2.SCORE_METHOD_MSAC, cv2.LOCAL_OPTIM_NULL
    params.isParallel, params.randomGeneratorState = False, 0  # so that runs repeat
    return params
