"""Runs whose disparities have another offset than the first's: one rig has one, so they need a calibration each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from ..._files import bad_input
from ...vision.slam.back_end.disparity_bias import LARGE_OFFSET, SURE
from ...vision.slam.least_squares.offsets import Estimate
from .runs import FinishedRun
from .states import read_step


def unlike_offsets(runs: Sequence[FinishedRun], states: Sequence[Path]) -> dict[str, str]:
    """Find runs whose offset is not that of the first, as recordings of one run are judged: by 0.5 px, for certain.

    Parameters
    ----------
    runs : sequence of FinishedRun
        The runs.
    states : sequence of Path
        Their checkpoints at the end of their paths.

    Returns
    -------
    dict of str to str
        Why each of them cannot be joined to the first, by its path.
    """
    return dict(_unlike(runs, [_offset(state) for state in states]))


def _unlike(runs: Sequence[FinishedRun], offsets: Sequence[Estimate]) -> Iterator[tuple[str, str]]:
    for run, own in zip(runs[1:], offsets[1:], strict=True):
        apart = own.less(offsets[0])
        if apart.exceeds(LARGE_OFFSET, SURE):
            said = (
                f"its disparities are off by {apart.value:+.2f} ± {apart.std:.2g} px more than those of {runs[0].path}"
            )
            yield run.path, str(bad_input(run.path, said, f"one calibration: at most {LARGE_OFFSET:g} px"))


def _offset(state: Path) -> Estimate:
    """The offset that a run's path and map have, px."""
    value, information = read_step(state)[1]["bias"].tolist()
    return Estimate(value, information**-0.5)
