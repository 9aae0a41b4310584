"""Windows of keyframes as odometry adjusts them, and the same problem as a factor graph of GTSAM.

`adjust` minimises Huber costs of (u, v, disparity) where disparity is ``u_left - u_right``; GTSAM's stereo factor
measures (u_left, u_right, v). The same Gaussian written for the one or the other has the same length of residual, and
GTSAM's costs are half of ours.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tspslam import Rig
from tspslam.types import BoolArray, FloatArray
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.least_squares.bundle import Adjustment, Observations, adjust

gtsam = pytest.importorskip("gtsam")

RIG = Rig(fx=718.0, fy=716.0, cx=607.0, cy=185.0, baseline=0.54, width=1241, height=376, doffs=2.5)
HELD, MOVING = 7, 7  # keyframes
HUBER = 2.5
_POINTS = 4800  # strewn, of which some are seen too rarely
_BEARINGS, _OUTLIERS = 0.3, 0.05  # shares of the observations
_LONG = 5  # observations of a point that may be bearings only


@dataclass(frozen=True)
class Window:
    """What `adjust` takes, and where everything truly is."""

    rig: Rig
    T_world_camera: FloatArray
    xyz: FloatArray
    seen: Observations
    fixed: BoolArray
    truth: FloatArray


def window(seed: int = 0, points: int = _POINTS) -> Window:
    """A drive of 14 keyframes through strewn points: noise, bearings, wild observations; the last 7 poses are to be found."""
    rng = np.random.default_rng(seed)
    T = _drive(HELD + MOVING)
    xyz = rng.uniform((-14, -5, 5), (14, 2, 45), (points, 3))
    pose, point, uv, disparity = _sights(rng, T, xyz)
    kept, point = np.unique(point, return_inverse=True)
    scale = 1.2 ** rng.integers(0, 6, len(pose))
    uv += rng.normal(0, 1, uv.shape) * scale[:, None] * 0.7
    disparity += rng.normal(0, 0.25, len(pose)) * scale
    uv += rng.uniform(-30, 30, uv.shape) * (rng.random((len(pose), 1)) < _OUTLIERS)
    disparity[_are_bearings(rng, point)] = np.nan
    fixed = np.arange(len(T)) < HELD
    start = T.copy()
    start[HELD:] = _shaken(rng, T[HELD:])
    near = xyz[kept] * (1 + rng.normal(0, 0.02, (len(kept), 1)))
    return Window(RIG, start, near, Observations(pose, point, uv, disparity, scale, 0.3 * scale), fixed, T)


def _are_bearings(rng: np.random.Generator, point: NDArray[np.integer]) -> BoolArray:
    """Which observations have no disparity: some of them, but the first one of a point only in points of five and more."""
    _, first, counts = np.unique(point, return_index=True, return_counts=True)
    bearings = rng.random(len(point)) < _BEARINGS
    bearings[first[counts < _LONG]] = False
    return bearings


def _drive(count: int) -> FloatArray:
    """Poses 1 m apart on a bend."""
    T = np.tile(np.eye(4), (count, 1, 1))
    along = np.arange(count)
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(along, (0.001, 0.02, 0.0))).as_matrix()
    T[:, :3, 3] = np.column_stack([0.01 * along**2, 0.0 * along, 1.0 * along])
    return T


def _shaken(rng: np.random.Generator, T: FloatArray) -> FloatArray:
    """Poses off by centimetres and milliradians."""
    off = T.copy()
    off[:, :3, :3] = Rotation.from_rotvec(rng.normal(0, 0.002, (len(T), 3))).as_matrix() @ T[:, :3, :3]
    off[:, :3, 3] += rng.normal(0, 0.03, (len(T), 3))
    return off


def _sights(
    rng: np.random.Generator, T: FloatArray, xyz: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Exact observations of points in the images of three to eight keyframes in a row: pose, point, uv, disparity."""
    T_camera_world = inverse(T)
    p = np.einsum("kij,mj->kmi", T_camera_world[:, :3, :3], xyz) + T_camera_world[:, None, :3, 3]
    z = np.maximum(p[..., 2], 1e-3)
    uv = np.stack([RIG.cx + RIG.fx * p[..., 0] / z, RIG.cy + RIG.fy * p[..., 1] / z], axis=-1)
    inside = (p[..., 2] > 3) & ((uv > 0) & (uv < (RIG.width, RIG.height))).all(axis=-1)
    first = rng.integers(-1, len(T) - 1, len(xyz))
    last = first + rng.integers(3, 9, len(xyz))
    when = np.arange(len(T))[:, None]
    inside &= (first <= when) & (when < last)
    inside &= (inside.sum(axis=0) >= 3) & inside[HELD:].any(axis=0)
    pose, point = np.nonzero(inside)
    return pose, point, uv[pose, point], RIG.fx * RIG.baseline / z[pose, point] - RIG.doffs


def adjusted(problem: Window, *, max_steps: int = 20) -> Adjustment:
    """What `adjust` makes of a window."""
    return adjust(
        problem.rig, problem.T_world_camera, problem.xyz, problem.seen,
        fixed=problem.fixed, huber=HUBER, max_steps=max_steps,
    )  # fmt: skip


def graph_of(problem: Window, *, hold: str = "equality") -> gtsam.NonlinearFactorGraph:
    """The factors of a window; held poses by equality (a hard constraint, for QR) or by a tight "prior"."""
    graph, models = gtsam.NonlinearFactorGraph(), _Models()
    rig, seen = problem.rig, problem.seen
    lens = gtsam.Cal3_S2(rig.fx, rig.fy, 0.0, rig.cx, rig.cy)
    stereo = gtsam.Cal3_S2Stereo(rig.fx, rig.fy, 0.0, rig.cx, rig.cy, rig.baseline)
    count = len(problem.T_world_camera)
    rows = zip(
        seen.pose.tolist(), (seen.point + count).tolist(), seen.uv, (seen.disparity + rig.doffs).tolist(),
        seen.sigma_uv.tolist(), seen.sigma_disparity.tolist(), strict=True,
    )  # fmt: skip
    for pose, point, uv, total, sigma_uv, sigma_disparity in rows:
        model = models.of(sigma_uv, sigma_disparity if total == total else None)
        if total != total:
            graph.add(gtsam.GenericProjectionFactorCal3_S2(uv, model, pose, point, lens))
        else:
            there = gtsam.StereoPoint2(uv[0], uv[0] - total, uv[1])
            graph.add(gtsam.GenericStereoFactor3D(there, model, pose, point, stereo))
    _hold(graph, problem, hold)
    return graph


class _Models:
    """Robust noise models, one for each pair of standard deviations."""

    def __init__(self) -> None:
        self._huber, self._known = gtsam.noiseModel.mEstimator.Huber(HUBER), {}

    def of(self, sigma_uv: float, sigma_disparity: float | None) -> gtsam.noiseModel.Robust:
        key = sigma_uv, sigma_disparity
        if key not in self._known:
            self._known[key] = gtsam.noiseModel.Robust.Create(self._huber, _gaussian(*key))
        return self._known[key]


def _gaussian(sigma_uv: float, sigma_disparity: float | None) -> gtsam.noiseModel.Gaussian:
    """Of (u, v); or of (u_left, u_right, v) such that u_left - u_right has its own standard deviation."""
    if sigma_disparity is None:
        return gtsam.noiseModel.Isotropic.Sigma(2, sigma_uv)
    a, b = sigma_uv**-2.0, sigma_disparity**-2.0
    return gtsam.noiseModel.Gaussian.Information(np.array([[a + b, -b, 0], [-b, b, 0], [0, 0, a]]))


def _hold(graph: gtsam.NonlinearFactorGraph, problem: Window, how: str) -> None:
    tight = gtsam.noiseModel.Isotropic.Sigma(6, 1e-7)
    for k in np.flatnonzero(problem.fixed).tolist():
        pose = gtsam.Pose3(problem.T_world_camera[k])
        factor = gtsam.NonlinearEqualityPose3(k, pose) if how == "equality" else gtsam.PriorFactorPose3(k, pose, tight)
        graph.add(factor)


def start_of(problem: Window) -> gtsam.Values:
    """Where the search starts."""
    values, count = gtsam.Values(), len(problem.T_world_camera)
    for k, T in enumerate(problem.T_world_camera):
        values.insert(k, gtsam.Pose3(T))
    for m, xyz in enumerate(problem.xyz):
        values.insert(count + m, xyz)
    return values


def solved(
    graph: gtsam.NonlinearFactorGraph, start: gtsam.Values, *, solver: str = "MULTIFRONTAL_QR",
    enough: float = 1e-14, max_steps: int = 300,
) -> tuple[gtsam.Values, int]:  # fmt: skip
    """The optimum that GTSAM finds by Levenberg-Marquardt steps, and how many it took."""
    settings = gtsam.LevenbergMarquardtParams()
    settings.setLinearSolverType(solver)
    settings.setRelativeErrorTol(enough)
    settings.setAbsoluteErrorTol(0.0)
    settings.setMaxIterations(max_steps)
    search = gtsam.LevenbergMarquardtOptimizer(graph, start, settings)
    return search.optimize(), search.iterations()


def poses_of(values: gtsam.Values, count: int) -> FloatArray:
    """The first poses, (K, 4, 4)."""
    return np.stack([values.atPose3(k).matrix() for k in range(count)])
