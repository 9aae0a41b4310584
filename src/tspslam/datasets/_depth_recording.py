"""A recording of colour and depth: its pairs, and what is known of its depths."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..types import FloatArray, Rig, StereoPair
from ._depth_reader import DepthReader, clock_doubts
from ._pairing import checked_index, name_of


class DepthRecording:
    """Pairs of images with depths, each read when it is asked for."""

    kind: str
    path: Path
    rig: Rig
    stamps: FloatArray
    apart: FloatArray
    unpaired: list[str]
    _reader: DepthReader

    @property
    def name(self) -> str:
        """Name of the folder, or of the file without its suffix."""
        return name_of(self.path.resolve().with_suffix("") if os.path.isfile(self.path) else self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self.stamps)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if it is bad."""
        index = checked_index(index, len(self))
        return self._reader.read(index, float(self.stamps[index]))

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))

    def describe(self) -> dict[str, Any]:
        """Tell of the depths what ``run.json`` says: sensor, unit, calibration, shares of a few maps, clocks.

        Returns
        -------
        dict
            Fit for JSON; shares of pixels from 0 to 1, times in s.
        """
        apart = np.abs(self.apart)
        clocks = {"apart_median_s": float(np.median(apart)), "apart_max_s": float(apart.max())}
        return {"layout": self.kind} | self._reader.describe() | clocks

    def doubts(self) -> Iterator[dict[str, str]]:
        """Tell what looks wrong with depths that can still be worked with.

        Yields
        ------
        dict of str
            ``code`` and ``message``.
        """
        yield from self._reader.doubts()
        if len(self) > 1:
            yield from clock_doubts(self.apart, float(np.median(np.diff(self.stamps))))
