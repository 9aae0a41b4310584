"""Files that stand beside a calibration file: that of the other camera, or another part."""

from __future__ import annotations

import os
from pathlib import Path

from ...._files import PathLike

_SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("cam0", "cam1"), ("camera0", "camera1"))


def partner(path: PathLike) -> tuple[Path, Path] | None:
    """Return the files of the left and the right camera, one of which is given; None if its name names no side.

    The side is in the name of the file, else in that of its folder.

    Examples
    --------
    >>> [path.as_posix() for path in partner("calib/right.yaml")]
    ['calib/left.yaml', 'calib/right.yaml']
    """
    own = Path(path).absolute()
    for place in (own, own.parent):
        for one, other in _SIDES:
            for at, (mine, its) in enumerate(((one, other), (other, one))):
                if mine in place.name:
                    swapped = place.with_name(its.join(place.name.rsplit(mine, 1)))
                    found = swapped if place is own else swapped / own.name
                    given = Path(path)
                    if place is own:
                        found = given.with_name(found.name)
                    return (given, found) if at == 0 else (found, given)
    return None


def first_of(folder: PathLike, places: tuple[str, ...]) -> Path | None:
    """Return the first of some files that is in a folder."""
    return next((Path(folder, place) for place in places if os.path.exists(os.path.join(folder, place))), None)
