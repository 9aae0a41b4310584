"""What is done beside the tracking: the last keyframes are adjusted; a loop is closed on a copy of the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...._brief import Brief
from ....errors import GeometryError
from ....types import FloatArray, Rig
from ..keyframes.map import Map
from ..least_squares.bundle import Adjustment
from .adjustment_problem import AdjustmentProblem, choose_piece, collect_problem, window_of
from .loop_correction import LoopProblem, close_loop
from .sweeping import PIECE


@dataclass(frozen=True, repr=False)
class AdjustmentJob(Brief):
    """An adjustment of part of a map.

    Attributes
    ----------
    problem : AdjustmentProblem
        What is adjusted.
    rig : Rig
        The cameras as calibrated.
    offset : float
        Offset of the disparities to start from, px.
    offset_sigma : float or None
        Its standard deviation before anything is seen, px; None where it stays.
    max_steps : int
        Steps at most.
    outlier : float
        Standard deviations beyond which an observation goes.
    """

    problem: AdjustmentProblem
    rig: Rig
    offset: float
    offset_sigma: float | None
    max_steps: int
    outlier: float

    def solve(self) -> Adjustment | None:
        """Adjust; may be called in another thread.

        Returns
        -------
        Adjustment or None
            None if what was seen does not fix the keyframes.
        """
        try:
            return self.problem.solve(self.rig, self.offset, self.offset_sigma, self.max_steps)
        except GeometryError:
            return None

    def apply(self, map_: Map, found: Adjustment) -> None:
        """Take over poses and landmarks, and drop outliers.

        Parameters
        ----------
        map_ : Map
            Changed.
        found : Adjustment
            What `solve` gave.
        """
        self.problem.apply(map_, found, self.outlier)
        map_.unsettled.difference_update(self.problem.moving)


@dataclass(frozen=True, repr=False)
class ClosedLoop(Brief):
    """What closes a loop.

    Attributes
    ----------
    motions : (K, 4, 4) float64
        How each keyframe moves.
    job : AdjustmentJob or None
        The adjustment that followed, of the last keyframes and of what is nearest to them.
    found : Adjustment or None
        What it found.
    """

    motions: FloatArray
    job: AdjustmentJob | None
    found: Adjustment | None

    def apply(self, map_: Map, same_landmark: float) -> None:
        """Close the loop of a map.

        Parameters
        ----------
        map_ : Map
            That of which a copy was closed; changed.
        same_landmark : float
            Distance of two observations, in u, v and disparity, of one landmark, px.
        """
        close_loop(map_, self.motions, same_landmark)
        if self.job is not None and self.found is not None:
            self.job.apply(map_, self.found)


def solve_loop(
    copy: Map, before: Callable[[Map], None], prepare: Callable[[Map], AdjustmentJob | None], *,
    sigma_uv: float, same_landmark: float,
) -> ClosedLoop | None:  # fmt: skip
    """Close the loop of a copy of a map, and adjust what is near; may be called in another thread.

    Parameters
    ----------
    copy : Map
        As `copy_map` made it; changed.
    before : callable
        Brings the copy to where the map will be when the loop is closed.
    prepare : callable
        Makes the adjustment that follows.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    same_landmark : float
        Distance of two observations, in u, v and disparity, of one landmark, px.

    Returns
    -------
    ClosedLoop or None
        None if the graph of the poses has no solution.
    """
    copy.note_sightings()
    before(copy)
    try:
        motions = LoopProblem.of(copy, sigma_uv).solve()
    except GeometryError:
        return None
    close_loop(copy, motions, same_landmark)
    job = prepare(copy)
    return ClosedLoop(motions, job, None if job is None else job.solve())


def copy_map(map_: Map) -> Map:
    """Copy what an adjustment changes of a map: keyframes and landmarks; who sees what is not noted yet.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.

    Returns
    -------
    Map
    """
    copy = Map(map_.rig, window=map_.window, settings=map_.settings)
    copy.keyframes, copy.xyz, copy.landmark_id = list(map_.keyframes), map_.xyz, map_.landmark_id
    copy.merged, copy.loop, copy.unsettled = map_.merged, map_.loop, set(map_.unsettled)
    return copy


def collect_job(
    map_: Map, sigma_uv: float, rig: Rig, offset: float, offset_sigma: float | None
) -> AdjustmentJob | None:  # fmt: skip
    """Collect what follows a keyframe: the last keyframes, and a piece of what a loop has moved.

    With such a piece the offset of the disparities stays: its keyframes have said what they know of it.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    rig : Rig
        The cameras as calibrated.
    offset, offset_sigma : float
        Offset of the disparities, and its standard deviation before anything is seen, px; None where it stays.

    Returns
    -------
    AdjustmentJob or None
        None where there is too little to adjust.
    """
    size = 0 if map_.loop is not None else PIECE
    piece = choose_piece(map_, map_.unsettled, size, last=map_.window) if map_.unsettled and size else []
    problem = collect_problem(map_, [*piece, *window_of(map_)], sigma_uv)
    if problem is None:
        return None
    settings = map_.settings
    return AdjustmentJob(problem, rig, offset, None if piece else offset_sigma, settings.max_steps, settings.outlier)
