"""What is adjusted beside the tracking: the last keyframes, and a piece of what a loop has moved."""

from __future__ import annotations

from dataclasses import dataclass

from ...._brief import Brief
from ....errors import GeometryError
from ....types import Rig
from ..keyframes.map import Map
from ..least_squares.bundle import Adjustment
from .adjustment_problem import AdjustmentProblem, choose_piece, collect_problem, window_of
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
    """

    problem: AdjustmentProblem
    rig: Rig
    offset: float
    offset_sigma: float | None
    max_steps: int

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
        """Take over poses and landmarks, and drop outliers; what one keyframe alone saw goes with it.

        Parameters
        ----------
        map_ : Map
            Changed.
        found : Adjustment
            What `solve` gave.
        """
        self.problem.apply(map_, found)
        map_.unsettled.difference_update(self.problem.moving)


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
    return AdjustmentJob(problem, rig, offset, None if piece else offset_sigma, map_.settings.max_steps)
