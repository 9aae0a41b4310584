"""Which stage a run is in, and how long each took."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from .._stopwatch import Stopwatch
from .sequence import SequenceRun, Step

OnStep = Callable[[Step], object]


class Stages:
    """Which stage a run is in: told where one begins, and timed."""

    def __init__(self, sequence: SequenceRun, on_step: OnStep | None) -> None:
        self._sequence, self._on_step, self._stage, self._watch = sequence, on_step, "", Stopwatch()
        self._tracked: list[float] = []  # when tracking began, and when each pair was done, s

    def __call__(self, stage: str) -> None:
        """Say that a stage begins, or goes on."""
        if stage != self._stage:
            self._watch.lap(self._stage)
            self._stage = stage
        if stage == "tracking":
            self._tracked.append(time.perf_counter())
        if self._on_step:
            self._on_step(self._sequence.step(stage))

    def end(self) -> dict[str, Any]:
        """Seconds of each stage, pairs done anew, and their pace after the first one, which may wait for kernels."""
        self._watch.lap(self._stage)
        seconds = {stage: spent for stage, spent in self._watch.seconds.items() if stage}
        anew = len(self._tracked) - 1
        spent = self._tracked[-1] - self._tracked[1] if anew > 1 else 0
        return {"stages_s": seconds, "frames_anew": anew, "frames_per_s": (anew - 1) / spent if spent else None}
