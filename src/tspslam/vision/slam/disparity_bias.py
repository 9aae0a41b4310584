"""The offset that all disparities of a path have in common, as the windows of keyframes tell it."""

from __future__ import annotations

from dataclasses import replace

from ...types import Rig


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
    """

    def __init__(self, sigma: float, window: int) -> None:
        self.sigma, self._window = sigma, window
        self.value, self._information = 0.0, sigma**-2.0

    @property
    def std(self) -> float:
        """Its standard deviation, px."""
        return float(self._information**-0.5)

    def correct(self, rig: Rig) -> Rig:
        """Make cameras whose disparities are those that are measured: the one place where the offset is applied.

        Parameters
        ----------
        rig : Rig
            As calibrated.

        Returns
        -------
        Rig
            With ``doffs`` less the offset.
        """
        return replace(rig, doffs=rig.doffs - self.value)

    def settle(self, offset: float, std: float) -> None:
        """Take over what all keyframes together say.

        Parameters
        ----------
        offset, std : float
            The offset and its standard deviation, px.
        """
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
