"""Images of two cameras as they are stored, without a calibration: what the cameras are calibrated by."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ._folder_images import FolderImages
from ._kinds import SUFFIXES, listed, no_source
from ._pairing import path_of
from ._reader import StoredImages
from ._ros import is_bag
from ._sides import find_sides

_DEEPER = (
    ("images/left", "images/right"), ("mav0/cam0/data", "mav0/cam1/data"), ("cam0/data", "cam1/data"),
    ("image_0", "image_1"), ("image_2", "image_3"), ("image_00", "image_01"), ("image_02", "image_03"),
    ("image_00/data", "image_01/data"), ("image_02/data", "image_03/data"),
)  # fmt: skip
_KNOWN = "two folders, one with left/ and right/ in it, one whose names tell left from right, a video or a bag"


def open_views(
    paths: Sequence[PathLike], layout: str | None = None, topics: tuple[str, str] | None = None,
    *, on_index: Callable[[int, int], object] | None = None,
) -> StoredImages:  # fmt: skip
    """Open the images of two cameras as they are stored, to calibrate by them.

    Parameters
    ----------
    paths : sequence of 1 or 2 str or path
        Two folders of images, left and right; a folder with both in folders of their own, or with names that tell which
        are which, as `tspslam.datasets.StereoFolder` knows them; a video with both, or one of each; a bag of ROS.
    layout : str, optional
        Of a video with both: ``"side-by-side"``, ``"over-under"`` or ``"alternate"``.
    topics : tuple of 2 str, optional
        Topics of a bag with the left and the right images.
    on_index : callable, optional
        Called with frames done and in all while videos are gone through.

    Returns
    -------
    StoredImages

    Raises
    ------
    InputError
        If there is no such source, or no pair of images in it.

    Examples
    --------
    >>> open_views(["no-such-folder"])
    Traceback (most recent call last):
    tspslam.errors.InputError: no-such-folder: is not there; expected two folders, one with left/ and right/ in it, ...
    """
    places = [path_of(path) for path in paths]
    if len(places) not in (1, 2):
        raise InputError(f"{len(places)} sources are given, expected one or two: {_KNOWN}")
    missing = next((place for place in places if not place.exists()), None)
    if missing is not None:
        raise bad_input(missing, "is not there", _KNOWN)
    if len(places) == 1 and is_bag(places[0]):
        from ._bag_images import BagImages

        return BagImages(places[0], topics)
    if topics is not None:
        raise InputError(one_line(f"{places[0]}: is no bag, expected one with topics {' and '.join(topics)}"))
    if all(place.is_file() and place.suffix.lower() not in SUFFIXES for place in places):
        from .video import VideoImages

        return VideoImages(places if len(places) == 2 else places[0], layout, on_index=on_index)
    if layout is not None:
        raise InputError(one_line(f"{places[0]}: is no video, expected one of layout {layout}"))
    for place in places:
        if not place.is_dir():
            raise no_source(place) or bad_input(place, "is no folder", _KNOWN)
    folders: Any = places if len(places) == 2 else _sides_in(places[0])
    return FolderImages(folders)


def _sides_in(folder: Path) -> Path | list[Path]:
    """The folder, or two folders in it: those of known layouts whose images lie deeper."""
    if find_sides(folder) is not None:
        return folder
    for left, right in _DEEPER:
        if (folder / left).is_dir() and (folder / right).is_dir():
            return [folder / left, folder / right]
    raise bad_input(folder, f"does not tell left from right (it holds {listed(folder)})", _KNOWN)
