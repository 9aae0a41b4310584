"""The offset that all disparities of a path have in common, and what the whole path says of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ...._brief import Brief
from ....types import Rig
from ..least_squares.offsets import Estimate
from .offset_steps import OffsetStep

LARGE_OFFSET = 0.5  # px: recordings calibrated with care have up to 0.4 (KITTI 05)
LARGE_FOCAL = 0.05  # of the focal length: KITTI 05, which turns, has 0.022 and a path that is right to 0.04 m
SURE = 3.0  # standard deviations


@dataclass(frozen=True, repr=False)
class CalibrationHealth(Brief):
    """What the motion tells of the calibration.

    Attributes
    ----------
    offset : Estimate
        Of all disparities, measured less true, px.
    thirds : tuple of 3 Estimate or None
        The same over the first, middle and last third of the keyframes; None where there are too few.
    drift : Estimate or None
        That of the last third less that of the first, px; uncertain where the middle one is not between them.
    far_near : Estimate
        That of farther points less that of nearer ones, px.
    right_left : Estimate
        That of the right half of the image less that of the left half, px.
    focal : Estimate
        Share by which the true focal length is more than that of the calibration; uncertain where nothing turns.
    step : OffsetStep or None
        Where the offset steps the most; None where there are too few keyframes.
    """

    offset: Estimate
    thirds: tuple[Estimate | None, ...]
    drift: Estimate | None
    far_near: Estimate
    right_left: Estimate
    focal: Estimate
    step: OffsetStep | None = None

    @property
    def unexplained(self) -> tuple[tuple[str, Estimate], ...]:
        """Large differences that one offset of all disparities cannot explain, px, with what is compared."""
        found = [("far and near points", self.far_near), ("the right and left of the image", self.right_left)]
        found += [] if self.drift is None else [("the last and first third of the path", self.drift)]
        large = [(words, each) for words, each in found if each.exceeds(LARGE_OFFSET, SURE)]
        if (step := self.sure_step) is not None:
            large.append((f"frames from {step.after} on and those up to {step.before}", step.size))
        return tuple(large)

    @property
    def sure_step(self) -> OffsetStep | None:
        """The step, if it is large and certain."""
        return self.step if self.step is not None and self.step.exceeds(LARGE_OFFSET) else None


class DisparityBias:
    """The offset that all disparities have in common, measured less true, px: what windows of keyframes say, weighed.

    Windows share keyframes, so each counts for its share only. Before the first one the offset is 0 ± `sigma`.

    Parameters
    ----------
    sigma : float
        Standard deviation before anything is seen, px.
    window : int
        Keyframes in a window.

    Attributes
    ----------
    value : float
        The offset, px.
    is_used : bool
        Whether path and map have it taken off.
    health : CalibrationHealth or None
        What the whole path tells of the calibration, once it is finished; None where that is too little.
    """

    def __init__(self, sigma: float, window: int) -> None:
        self.sigma, self._window = sigma, window
        self.value, self._information, self.is_used = 0.0, sigma**-2.0, True
        self.health: CalibrationHealth | None = None

    @property
    def std(self) -> float:
        """Its standard deviation, px."""
        return float(self._information**-0.5)

    @property
    def prior(self) -> tuple[float, float | None]:
        """Where an adjustment starts, px, and the standard deviation before anything is seen; None to leave it at 0."""
        return (self.value, self.sigma) if self.is_used else (0.0, None)

    def correct(self, rig: Rig) -> Rig:
        """Make cameras whose disparities are those that are measured: the one place where the offset is applied.

        Parameters
        ----------
        rig : Rig
            As calibrated.

        Returns
        -------
        Rig
            With ``doffs`` less the offset, if it is used.
        """
        return replace(rig, doffs=rig.doffs - (self.value if self.is_used else 0.0))

    def settle(self, offset: float, std: float) -> None:
        """Take over what all keyframes together say; one that is not used stays as it was.

        Parameters
        ----------
        offset, std : float
            The offset and its standard deviation, px.
        """
        if self.is_used:
            self.value, self._information = offset, std**-2.0

    @property
    def state(self) -> tuple[float, float]:
        """Value and information."""
        return self.value, self._information

    @state.setter
    def state(self, state: tuple[float, float]) -> None:
        """Take them over."""
        self.value, self._information = state

    def update(self, offset: float, std: float) -> None:
        """Weigh in what a window found, which began at the same 0 ± `sigma`.

        Parameters
        ----------
        offset, std : float
            The offset and its standard deviation, px.
        """
        own = std**-2.0 - self.sigma**-2.0
        if own <= 0:
            return
        measured, weight = offset * std**-2.0 / own, own / self._window
        self._information += weight
        self.value += (measured - self.value) * weight / self._information
