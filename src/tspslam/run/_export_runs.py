"""What exports of a whole run need of its folder: the map, the path, and the images of the keyframes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from .._files import bad_input
from ..io.bag import write_bag
from ..io.colmap import write_colmap
from ..io.frames import read_frame_image
from ..io.nerfstudio import write_nerfstudio
from ..io.runfolder import RunFolder
from ..io.runs import StoredRun, load_run
from ..io.topological import load_map
from ..topological_map import TopologicalMap
from ..types import Image, Trajectory
from .given import has_map


@dataclass(frozen=True)
class RunData:
    """A finished run and its map.

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
        return read_frame_image(self._folder.finished_frame(int(self.map_.keyframes[row])))

    @cached_property
    def _folder(self) -> RunFolder:
        return RunFolder.open(self.run.path)


def load_run_data(run: Path) -> RunData:
    """Read a finished run's map and path.

    Parameters
    ----------
    run : path
        The run folder.

    Returns
    -------
    RunData

    Raises
    ------
    InputError
        If it is no finished run, has no map or no path, or its path has not a pose for each row of its record.
    """
    data = RunData(load_run(run), load_map(run))
    rows = data.run.placed_rows
    if len(rows) != len(data.trajectory):
        told = f"has {len(rows)} rows of frames, and a path of {len(data.trajectory)} poses"
        raise bad_input(run, told, "one for each")
    return data


def export_colmap(run: Path, folder: Path) -> None:
    """Write a run's map, and the images of its keyframes, as a COLMAP model.

    Parameters
    ----------
    run : path
        The run folder.
    folder : path
        Not there yet, or empty.

    Raises
    ------
    InputError
        As `load_run_data` and `write_colmap`.
    OutputError
        If a file cannot be written.
    """
    data = load_run_data(run)
    write_colmap(folder, data.map_, data.image_of)


def export_nerfstudio(run: Path, folder: Path) -> None:
    """Write a run's keyframes, and the vertices of its map, for nerfstudio.

    Parameters: as `export_colmap`.
    """
    data = load_run_data(run)
    write_nerfstudio(folder, data.map_, data.image_of)


def export_bag(run: Path, folder: Path) -> None:
    """Write a run's path, and its map where it has one, as a ROS 2 bag.

    Parameters: as `export_colmap`.
    """
    stored = load_run(run)
    write_bag(folder, stored.trajectory, load_map(run) if has_map(RunFolder.open(run)) else None)
