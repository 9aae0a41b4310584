"""Which pose of an estimate has which true one, and whether enough of them have any."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ..._checks import require
from ...errors import InputError
from ...types import FloatArray, Trajectory, real_array

_FARTHEST = 1e10  # m
_FEWEST = 3  # positions: through fewer, the motion that lays a path on another is not one
_MIN = 0.05  # of the estimate: below, what is compared says nothing of it
_FEW = 0.5  # of a path: below, it is a part, which is said
_LONGEST_GAP = 1 << 40  # frames
_ROTATION = 1e-3


@dataclass(frozen=True, repr=False)
class Known(Brief):
    """Stamps and poses that are known, ascending, and how many are not."""

    stamps: FloatArray
    poses: FloatArray
    unknown: int


@dataclass(frozen=True, repr=False)
class Overlap(Brief):
    """Two paths, and the places of poses that match."""

    estimate: Known
    truth: Known
    own: NDArray[np.int64]
    other: NDArray[np.int64]

    def span_of(self, path: Known, at: NDArray[np.int64]) -> float:
        """Share of a path's time between the first match and the last."""
        return float(np.ptp(path.stamps[at]) / np.ptp(path.stamps))

    @property
    def density(self) -> float:
        """Share of poses between the first match and the last that match, of the path that has fewer there."""
        return len(self.own) / (1 + int(min(np.ptp(self.own), np.ptp(self.other))))

    def check(self, most: float) -> None:
        """Refuse an overlap that says nothing of the path."""
        matched, total = len(self.own), len(self.estimate.stamps)
        said = f"evaluation: {matched} of {total} poses have a true one within {most:g} s"
        spans = f"stamps are {_span(self.estimate.stamps)}, true ones {_span(self.truth.stamps)}"
        if matched < _FEWEST:
            raise InputError(f"{said}, expected at least {_FEWEST}; {spans}")
        share = self.density * self.span_of(self.estimate, self.own)
        if share < _MIN:
            raise InputError(f"{said}, {100 * share:.2g} % of the path, expected at least {100 * _MIN:g} %; {spans}")

    def warnings(self) -> tuple[str, ...]:
        """What to say where less than half is compared."""
        found = []
        known, unknown = len(self.estimate.stamps), self.estimate.unknown
        if unknown > known:
            said = f"{unknown} of {known + unknown} poses of the estimated path are NaN"
            found.append(f"{said}: the errors are those of the {known} others, and say little")
        paths = ("estimated", self.estimate, self.own), ("true", self.truth, self.other)
        for name, path, at in paths:
            share = self.density * self.span_of(path, at)
            if share < _FEW:
                said = (
                    f"only {100 * share:.2g} % of the {name} path is compared ({len(at)} of {len(path.stamps)} poses)"
                )
                found.append(f"{said}: the errors are those of a part")
        return tuple(found)

    def frames_between(self) -> NDArray[np.int64]:
        """How many frames of the estimate each match is behind the one before it."""
        stamps = self.estimate.stamps
        interval = float(np.median(np.diff(stamps)))
        return np.clip(np.rint(np.diff(stamps[self.own]) / interval), 1, _LONGEST_GAP).astype(np.int64)


def match_stamps(stamps: FloatArray, others: FloatArray, most: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Places of stamps that are nearest to each other, and near enough."""
    after = np.clip(np.searchsorted(others, stamps), 1, max(len(others) - 1, 1))
    after = np.minimum(after, len(others) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(stamps - others[before] <= others[after] - stamps, before, after)
    off = np.abs(others[nearest] - stamps)
    order = np.lexsort((np.arange(len(stamps)), off))
    order = order[off[order] <= most]
    _, first = np.unique(nearest[order], return_index=True)  # of those that share a true pose, the nearest
    own = np.sort(order[first])
    return own, nearest[own]


def checked_path(trajectory: Trajectory, what: str) -> Known:
    """Stamps and poses that are known, ascending."""
    require(trajectory, Trajectory, what)
    stamps = real_array(trajectory.stamp, f"{what}: stamp", "(T,)").astype(np.float64)
    poses = real_array(trajectory.T_world_camera, f"{what}: T_world_camera", "(T, 4, 4)").astype(np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or stamps.shape != poses.shape[:1]:
        raise InputError(f"{what}: stamp and poses have shapes {stamps.shape}, {poses.shape}, expected (T,), (T, 4, 4)")
    count, known = len(poses), ~np.isnan(poses).any(axis=(1, 2))
    stamps, poses = stamps[known], poses[known]
    if not len(stamps):
        raise InputError(f"{what}: has no pose that is known of {count}, expected at least {_FEWEST}")
    if not np.isfinite(stamps).all() or not np.isfinite(poses).all() or (np.diff(stamps) <= 0).any():
        raise InputError(f"{what}: stamps or poses are not finite, or stamps do not increase, expected both")
    if np.abs(poses).max() > _FARTHEST:
        raise InputError(
            f"{what}: a position is {np.abs(poses).max():.3g} m from the origin, expected {_FARTHEST:g} at most"
        )
    R = poses[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero((off > _ROTATION) | (np.linalg.det(R) < 0))
    if bad.size:
        raise InputError(
            f"{what}: pose {bad[0]} holds no rotation (R Rᵀ - I has {off[bad[0]]:.2g}), expected one to 1e-3"
        )
    bad = np.flatnonzero((poses[:, 3] != (0, 0, 0, 1)).any(axis=1))
    if bad.size:
        row = " ".join(f"{value:g}" for value in poses[bad[0], 3])
        raise InputError(f"{what}: pose {bad[0]} has the last row {row}, expected 0 0 0 1")
    return Known(stamps, poses, count - len(stamps))


def _span(stamps: FloatArray) -> str:
    return f"{stamps[0]:.3f} to {stamps[-1]:.3f} s"
