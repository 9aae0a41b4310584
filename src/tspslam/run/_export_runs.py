"""What exports of a whole run need of its folder: the map, the path, and the images of the keyframes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .._files import bad_input
from ..io.frames import read_frame_image
from ..io.runfolder import RunFolder
from ..io.runs import StoredRun, load_run
from ..io.topological import load_map
from ..topological_map import TopologicalMap
from ..types import Image, Trajectory


@dataclass(frozen=True)
class RunData:
    """A finished run whose map has keyframes with stored frames.

    Attributes
    ----------
    run : StoredRun
        The run: its record and its path.
    map_ : TopologicalMap
        The map.
    """

    run: StoredRun
    map_: TopologicalMap

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the left camera, by stamp."""
        return self.run.trajectory

    def image_of(self, row: int) -> Image:
        """Read the left image of a keyframe.

        Parameters
        ----------
        row : int
            Of the map's keyframes.

        Returns
        -------
        (H, W) or (H, W, 3) uint8, uint16 or float32

        Raises
        ------
        InputError
            If its file is missing, was changed, or holds no image.
        """
        folder = RunFolder.open(self.run.path)
        return read_frame_image(folder.finished_frame(int(self.map_.keyframes[row])))
