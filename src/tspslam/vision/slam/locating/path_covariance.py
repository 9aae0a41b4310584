"""How well a frame is known against the first one: by the steps to it, and by the loops that were closed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....errors import GeometryError
from ....types import BoolArray, FloatArray
from ...se3 import inverse, normalised
from ..least_squares.pose_graph import PoseEdges, marginal_covariance

_LEAST = 1e-12  # of the largest variance: what rounding leaves of a matrix


@dataclass(frozen=True)
class Links:
    """Which frames were located against which, and how well.

    Attributes
    ----------
    frame, against : (E,) int64
        Numbers of the frames, and of those that they were located against, which are before them.
    covariance : (E, 6, 6) float64
        Of (ω, υ) of the first in its own frame, rad and m; NaN where its pose was guessed.
    """

    frame: NDArray[np.int64]
    against: NDArray[np.int64]
    covariance: FloatArray

    @classmethod
    def of_none(cls) -> Links:
        """Make an empty one.

        Returns
        -------
        Links
        """
        return cls(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 6, 6)))

    def and_one(self, frame: int, against: int, covariance: FloatArray) -> Links:
        """Add one.

        Parameters
        ----------
        frame, against : int
            Numbers of the frames.
        covariance : (6, 6) float64
            Of the first against the second.

        Returns
        -------
        Links
        """
        joined = np.concatenate([self.covariance, covariance[None]])
        return Links(np.append(self.frame, frame), np.append(self.against, against), joined)


def covariance_from_start(frame: int, poses: FloatArray, steps: Links, loops: Links) -> FloatArray:
    """Find the covariance of a frame's pose against the first one's, from steps and loops as independent edges.

    Without loops on the way it is the sum of the steps' covariances, each taken to the frame by the adjoint; with them
    the block of the inverse of the graph's normal equations: a loop around which ten like steps lead leaves the fifth
    a quarter of what they add up to.

    Parameters
    ----------
    frame : int
        Number of the frame.
    poses : (T, 4, 4) float64
        Of all frames.
    steps : Links
        Of all frames, in order; the first one's is not used.
    loops : Links
        Frames that saw an old place again, against keyframes there.

    Returns
    -------
    (6, 6) float64
        Of (ω, υ), rad and m, in the camera's frame; infinite where only guesses lead to it.
    """
    if frame == 0:
        return np.zeros((6, 6))
    among = _before([frame, *loops.frame.tolist(), *loops.against.tolist()], steps.against)
    child = np.concatenate([among[1:], loops.frame])
    parent = np.concatenate([steps.against[among[1:]], loops.against])
    covariance = np.concatenate([steps.covariance[among[1:]], loops.covariance])
    known = np.isfinite(covariance).all(axis=(1, 2))
    child, parent, information = child[known], parent[known], _inverses(covariance[known])
    is_held = _held(len(poses), child, parent)
    if not is_held[frame]:
        return np.full((6, 6), np.inf)
    kept, nodes = is_held[child], among[is_held[among]]
    i, j = np.searchsorted(nodes, parent[kept]), np.searchsorted(nodes, child[kept])
    T = normalised(poses[nodes])
    edges = PoseEdges(i, j, normalised(inverse(T[i]) @ T[j]), information[kept])
    try:
        return marginal_covariance(T, edges, int(np.searchsorted(nodes, frame)))
    except GeometryError:  # edges of which next to nothing is known
        return np.full((6, 6), np.inf)


def _before(frames: Sequence[int], against: NDArray[np.int64]) -> NDArray[np.int64]:
    """Some frames, those that they were located against, and so on to the first: ascending."""
    found = {0}
    for frame in frames:
        while frame not in found:
            found.add(frame)
            frame = int(against[frame])
    return np.array(sorted(found), np.int64)


def _held(count: int, child: NDArray[np.int64], parent: NDArray[np.int64]) -> BoolArray:
    """Which of `count` frames edges join to the first."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    _, part = connected_components(coo_matrix((np.ones(len(child)), (child, parent)), (count, count)), directed=False)
    return np.asarray(part == part[0])


def _inverses(covariance: FloatArray) -> FloatArray:
    """Information of covariances (E, 6, 6)."""
    value, turn = np.linalg.eigh(covariance)
    value = np.maximum(value, np.maximum(_LEAST * value[:, -1:], np.finfo(float).tiny))
    found: FloatArray = (turn / value[:, None, :]) @ np.swapaxes(turn, 1, 2)
    return (found + np.swapaxes(found, 1, 2)) / 2
