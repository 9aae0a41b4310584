"""What happens before a run folder can be used, and when it was not."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._atomic import bad_output, is_temporary, write_bytes
from .._files import bad_input, read_bytes
from ..errors import InputError
from . import _config
from ._places import CONFIG, MANIFEST, PARTS, check_places
from .lock import LOCK_NAME, FolderLock
from .manifest import read_manifest

_EXPECTED = "an empty or new folder, or a run folder of ours"
_LONGEST_LINE = 64  # bytes of the first line of the settings
_MAX_NAMED, _LONGEST = 10, 400  # settings that differ; characters of each


def is_ours(folder: Path) -> bool:
    """Whether a folder, in which nothing of ours is a link, holds the settings of a run, of whatever format."""
    return _format_of(folder) is not None


def is_run_folder(folder: Path) -> bool:
    """Whether a folder is one of a run, of whatever format, with no link in a place of ours."""
    try:
        check_places(folder)
    except (InputError, OSError, ValueError):
        return False
    return is_ours(folder)


def refuse_other_format(folder: Path) -> None:
    """Refuse the run folder of another version of this package: it is neither gone on with nor read."""
    found = _format_of(folder)
    if found not in (None, _config.FORMAT):
        said = f"is a run folder of format {found}, as another version of tspslam makes them"
        way = f"format {_config.FORMAT}: make the run anew, into another folder (--out), or delete this one first"
        raise bad_input(folder, said, way)


def _format_of(folder: Path) -> int | None:
    try:
        with open(folder / CONFIG, "rb") as handle:
            return _config.format_of(handle.readline(_LONGEST_LINE))
    except (OSError, ValueError):
        return None


def refuse_foreign(folder: Path) -> None:
    """Refuse a folder that holds something else than a run of this format, or a link where a file of ours goes."""
    try:
        check_places(folder)
        names = os.listdir(folder)
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:
        raise bad_output(folder, error) from error
    # An interrupted start leaves no more than these.
    alien = [name for name in names if name != LOCK_NAME and not is_temporary(name)]
    if alien and not is_ours(folder):
        without = f"holds {sorted(alien)[0]!r} and no {CONFIG} of a run"
        other = f"holds a {CONFIG} whose first line is not that of a run"
        raise bad_input(folder, other if CONFIG in names else without, _EXPECTED)
    refuse_other_format(folder)


def read_config(folder: Path) -> dict[str, Any]:
    """Return the settings of a run."""
    data = read_bytes(folder / CONFIG, "the settings of a run")
    try:
        config = _config.load(data)
    except InputError as error:
        raise bad_input(folder / CONFIG, str(error), "the settings of a run") from error
    if not isinstance(config, dict):
        raise bad_input(folder / CONFIG, "is no mapping", "the settings of a run")
    return config


def settle_config(folder: Path, config: dict[str, Any]) -> list[Path]:
    """Write the settings into a folder without a finished unit; hold them against those of any other.

    Returns the file, if it is new.
    """
    is_new = not is_ours(folder)
    if is_new or not read_manifest(folder / MANIFEST)[0]:
        write_bytes(folder / CONFIG, _config.dump(config))
        return [folder / CONFIG] if is_new else []
    lines = _config.differences(read_config(folder), config)
    if lines:
        more = f"; and {len(lines) - _MAX_NAMED} more" if len(lines) > _MAX_NAMED else ""
        said = "; ".join(line[:_LONGEST] for line in lines[:_MAX_NAMED]) + more
        raise bad_input(folder, said, "the settings of the run in it, or another folder")
    return []


def unmake(folder: Path, made: Sequence[Path], lock: FolderLock | None) -> None:
    """Remove what was made in and above a folder where nothing was finished since, and let go of the lock."""
    outer = [path for path in made if path.parent != folder]
    if lock is not None:
        with contextlib.suppress(OSError):
            _unmake_within(folder, made[len(outer) :])
        lock.release()
    with contextlib.suppress(OSError):  # of a folder that holds anything
        for path in reversed(outer):
            path.rmdir()


def _unmake_within(folder: Path, made: Sequence[Path]) -> None:
    manifest = folder / MANIFEST
    if manifest.exists() and not manifest.stat().st_size:  # its first line did not fit on the disk
        manifest.unlink()
    if not set(os.listdir(folder)) - {CONFIG, LOCK_NAME, *PARTS}:
        for path in reversed(made):
            path.unlink() if path.name == CONFIG else path.rmdir()


def sweep(folder: Path) -> None:
    """Remove the temporary files of a run that was killed."""
    try:
        for part in (folder, *(folder / name for name in PARTS)):
            for entry in part.iterdir():
                if is_temporary(entry.name):
                    entry.unlink()
    except OSError as error:
        raise bad_output(folder, error) from error
