"""A run folder followed from outside, while a run fills it or afterwards: what can be shown, and what cannot."""

from __future__ import annotations

import os
import re
import sys
from collections import OrderedDict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .._atomic import is_temporary
from .._checks import require_path
from .._files import PathLike, bad_input, reason_of
from ..errors import InputError
from ..frame import Frame
from ..io import RunFolder, Unit, read_frame, read_map, read_trajectory
from ..io._places import CONFIG, MANIFEST, MAP, check_places
from ..io._record import checked_rows, read_object
from ..io.lock import LOCK_NAME
from ..io.manifest import sha256_file
from ..topological_map import TopologicalMap
from ..view.live.world import State, Station, World

_KEPT = 8  # frames that are kept in memory
_AT_A_TIME = 10  # frames that one look reads: a long run appears bit by bit
_FRAME = re.compile(r"(\d{6,12})\.npz")
_LOOKED_AT = (CONFIG, MANIFEST, "run.json", MAP, "trajectory.tum", LOCK_NAME, "frames")


class RunWatch:
    """A run folder and what is in it by now.

    Parameters
    ----------
    path : str or path
        The folder; it may be filled later.

    Raises
    ------
    InputError
        If it is no folder, or a link stands in a place of a run's.
    """

    def __init__(self, path: PathLike) -> None:
        require_path(path)
        self._path = Path(path)
        self._signs: object = None
        self._frames: OrderedDict[int, Frame] = OrderedDict()
        self._tracked: dict[int, Station] = {}
        self._bad: dict[int, str] = {}
        self._map: tuple[object, TopologicalMap | None, list[str]] = (None, None, [])
        self._units: Mapping[str, Unit] = {}
        if self._path.exists() and not self._path.is_dir():
            raise bad_input(path, "is no folder", "a run folder")
        try:
            check_places(self._path)
        except (OSError, ValueError) as error:
            raise bad_input(path, f"cannot be read ({reason_of(error)})", "a run folder of ours") from error

    def look(self) -> World | None:
        """Look whether there is something new.

        Returns
        -------
        World or None
            None where nothing has changed since the last look.
        """
        signs = [_sign(self._path / name) for name in _LOOKED_AT], _is_locked(self._path)
        if signs == self._signs:
            return None
        world, is_all = self._read(_is_locked(self._path))
        self._signs = signs if is_all else None
        return world

    def frame(self, number: int) -> Frame:
        """Read a stored frame.

        Parameters
        ----------
        number : int
            One of `World.stored`.

        Returns
        -------
        Frame

        Raises
        ------
        InputError
            If it cannot be read, or was changed since the run.
        """
        if number in self._frames:
            self._frames.move_to_end(number)
            return self._frames[number]
        path = self._path / "frames" / f"{number:06d}.npz"
        unit = self._units.get(f"frames/{path.name}")
        if unit is not None and sha256_file(path) != unit.sha256:
            raise bad_input(path, "was changed since the run", "the file that the manifest lists")
        self._frames[number] = read_frame(path)
        while len(self._frames) > _KEPT:
            self._frames.popitem(last=False)
        return self._frames[number]

    def _read(self, is_live: bool) -> tuple[World, bool]:
        """What is there, and whether all of it was read."""
        missing: list[str] = []
        self._units, numbers = self._listed(missing)
        record, rows = self._record(missing)
        is_done = bool(record) and not is_live and (not self._units or "report.html" in self._units)
        map_ = self._read_map(missing) if is_done or MAP in self._units else None
        stations = self._path_of(rows, missing) if is_done and rows else None
        is_all = True
        if stations is None:
            is_all = self._read_stations(numbers)
            stations = tuple(self._tracked[number] for number in numbers if number in self._tracked)
        missing += [self._bad[number] for number in numbers if number in self._bad]
        stored = tuple(number for number in numbers if number not in self._bad and (is_done or number in self._tracked))
        said = _said(self._path, record if is_done else {}, is_live, stations)
        loops = _loops(record)
        return World(self._path.resolve().name, said, is_live, stations, stored, map_, loops, tuple(missing)), is_all

    def _listed(self, missing: list[str]) -> tuple[Mapping[str, Unit], list[int]]:
        """Finished units, and numbers of the stored frames; where the books are unreadable, of all that lie there."""
        try:
            folder = RunFolder.open(self._path)
        except InputError as error:
            if _names(self._path):
                missing.append(str(error))
            found = (_FRAME.fullmatch(name) for name in _names(self._path / "frames"))
            return {}, sorted(int(match[1]) for match in found if match)
        for number in folder.stored_frames:
            name = f"frames/{number:06d}.npz"
            if name in self._units and self._units[name] != folder.units[name]:  # it was made anew
                for known in (self._frames, self._tracked, self._bad):
                    known.pop(number, None)
        return folder.units, list(folder.stored_frames)

    def _record(self, missing: list[str]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
        """What ``run.json`` holds, and its rows."""
        path = self._path / "run.json"
        try:
            record = read_object(path) if path.exists() else {}
            return record, checked_rows(path, record)
        except InputError as error:
            missing.append(str(error))
            return {}, []

    def _read_map(self, missing: list[str]) -> TopologicalMap | None:
        """The map of two keyframes or more; what of it was read is not read again."""
        path, sign = self._path / MAP, _sign(self._path / MAP)
        if sign is None and MAP not in self._units:
            return None
        if sign != self._map[0]:
            faults: list[str] = []
            map_ = None
            try:
                unit = self._units.get(MAP)
                if unit is not None and sha256_file(path) != unit.sha256:
                    raise bad_input(path, "was changed since the run", "the file that the manifest lists")
                map_ = read_map(path)
            except InputError as error:
                faults.append(str(error))
            self._map = sign, map_ if map_ is not None and len(map_.keyframes) > 1 else None, faults
        missing += self._map[2]
        return self._map[1]

    def _path_of(self, rows: list[dict[str, Any]], missing: list[str]) -> tuple[Station, ...] | None:
        """Poses of all frames as the whole run has refined them; None if they cannot be read."""
        try:
            path = read_trajectory(self._path)
        except InputError as error:
            missing.append(str(error))
            return None
        poses = dict(zip(path.stamp.tolist(), path.T_world_camera, strict=True))
        return tuple(
            Station(row["index"], poses[row["stamp"]], _state(row.get("is_keyframe"), row.get("is_lost")))
            for row in sorted(rows, key=lambda row: int(row["index"])) if row["stamp"] in poses
        )  # fmt: skip

    def _read_stations(self, numbers: list[int]) -> bool:
        """Poses of stored frames as they were tracked, some at a time; whether there are no more to read."""
        new = [number for number in numbers if number not in self._tracked and number not in self._bad]
        for number in new[:_AT_A_TIME]:
            try:
                frame = self.frame(number)
            except InputError as error:
                self._bad[number] = str(error)
            else:
                state = _state(frame.is_keyframe, frame.is_lost)
                self._tracked[number] = Station(number, frame.T_world_camera, state)
        return len(new) <= _AT_A_TIME


def _state(is_keyframe: object, is_lost: object) -> State:
    return "lost" if is_lost is True else "keyframe" if is_keyframe is True else "tracked"


def _said(path: Path, record: dict[str, Any], is_live: bool, stations: tuple[Station, ...]) -> str:
    keyframes = sum(each.state == "keyframe" for each in stations)
    if record:
        return (
            f"{record.get('status', 'finished')}: {record.get('frames', len(stations))} frames, {keyframes} keyframes"
        )
    if is_live:
        return f"live: {keyframes} keyframes so far"
    if not stations:
        return "nothing to show yet" if _names(path) else "no run here yet; it is shown as soon as one begins"
    return f"not finished: {keyframes} keyframes; the same command goes on with it"


def _names(path: Path) -> list[str]:
    """What is in a folder but what a run begins with; nothing in one that is not there, or cannot be listed."""
    try:
        return [name for name in os.listdir(path) if name != LOCK_NAME and not is_temporary(name)]
    except OSError:
        return []


def _loops(record: dict[str, Any]) -> tuple[tuple[int, int], ...]:
    """Frames between which loops were closed, where ``run.json`` says."""
    pairs = record.get("loop_closures")
    good = [each for each in pairs if isinstance(each, list) and len(each) == 2] if isinstance(pairs, list) else []
    return tuple((a, b) for a, b in good if type(a) is int and type(b) is int)


def _sign(path: Path) -> tuple[int, int, int] | None:
    """What changes when a file does."""
    try:
        status = os.stat(path, follow_symlinks=False)
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino


def _is_locked(folder: Path) -> bool:
    """Whether a run goes on in a folder; the lock is looked at, never taken, so that no run finds it taken."""
    try:
        text = (folder / LOCK_NAME).read_bytes()[:32].strip()
    except OSError:
        return False
    if sys.platform == "win32" or not text.isdigit():  # there a lock stays after the run
        return sys.platform != "win32"
    try:
        os.kill(int(text), 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True
