"""The folder that a run fills: settings, finished units, results; one run at a time, resumed where it stopped."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from numpy.typing import ArrayLike

from .._atomic import bad_output, make_folder, write_bytes
from .._files import PathLike, bad_input, one_line, read_bytes, reason_of
from ..errors import InputError, OutputError
from . import _config
from ._places import CONFIG, LANDMARKS, MANIFEST, MAP, PARTS, TIMINGS, check_places, is_result, is_word
from ._record import checked_rows, read_object
from ._settling import is_ours, read_config, refuse_foreign, refuse_other_format, settle_config, sweep, unmake
from .lock import FolderLock
from .manifest import Unit, append_unit, read_manifest, sha256_file, write_manifest
from .trajectory import write_kitti, write_tum

_FRAME = re.compile(r"frames/(\d{6,})\.npz")


class RunFolder:
    """The folder of one run. Make or resume it with `create`, look into it with `open`; use it in a ``with`` block.

    A block that an error ends before a first file is finished leaves nothing behind that `create` made. No link in a
    run folder is ever followed: one in the place of a file or folder of ours is refused.

    Attributes
    ----------
    path : Path
        The folder.
    config : dict
        The settings, plain.
    config_hash : str
        Their SHA-256.
    units : dict
        Finished units by name.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with RunFolder.create(f"{folder}/run", {"detector": "orb"}) as run:
    ...         _ = run.frame_path(0).write_bytes(b"a frame")
    ...         _ = run.record(run.frame_path(0), input_hash="of the pair")
    ...     with RunFolder.create(f"{folder}/run", {"detector": "orb"}) as run:
    ...         run.is_done(run.frame_path(0), input_hash="of the pair")
    True
    """

    def __init__(
        self, path: Path, config: Mapping[str, Any], lock: FolderLock | None, made: Sequence[Path] = ()
    ) -> None:
        self.path = path
        self.config = config
        self.config_hash = _config.hash_of(config)
        self._lock, self._made = lock, made
        self._manifest = path / MANIFEST
        self.units, self._size = read_manifest(self._manifest)

    @classmethod
    def create(cls, path: PathLike, config: Mapping[str, Any]) -> RunFolder:
        """Make a run folder, or resume one of the same settings, and lock it; without a finished unit it is a new one.

        Parameters
        ----------
        path : str or path
            The folder; missing, empty, or a run folder.
        config : dict
            The settings: nested dicts, lists, text, finite numbers, booleans, None.

        Returns
        -------
        RunFolder
            Locked until it is closed; a last line torn off the manifest and abandoned temporary files are gone.

        Raises
        ------
        InputError
            If the folder holds something else, a link in a place of ours, a damaged manifest, a run of another format
            or of other settings (each differing key is named), or a run that is still going on. Nothing is touched
            then.
        OutputError
            If the folder cannot be made or written.
        """
        folder, settings = Path(path), _config.plain(config)
        if not isinstance(settings, dict):
            raise InputError(f"config is {type(config).__name__}, expected a mapping")
        refuse_foreign(folder)
        made, lock = make_folder(folder), None
        try:
            lock = FolderLock(folder)
            made += settle_config(folder, settings)
            for part in PARTS:
                made += make_folder(folder / part)
            sweep(folder)
            run = cls(folder, settings, lock, made)
            run._own_manifest()
        except BaseException:
            unmake(folder, made, lock)
            raise
        return run

    @classmethod
    def open(cls, path: PathLike) -> RunFolder:
        """Open an existing run folder for reading; no lock is taken and nothing is written.

        Parameters
        ----------
        path : str or path
            The run folder.

        Returns
        -------
        RunFolder
            Its writing methods raise `OutputError`.

        Raises
        ------
        InputError
            If it is not a run folder of ours, of another format, or damaged, or has a link in a place of ours.
        """
        folder = Path(path)
        try:
            check_places(folder)
        except (OSError, ValueError) as error:
            raise bad_input(path, f"cannot be read ({reason_of(error)})", "a run folder of ours") from error
        if not is_ours(folder):
            raise bad_input(path, f"holds no {CONFIG} of a run", "a run folder of ours")
        refuse_other_format(folder)
        return cls(folder, read_config(folder), None)

    def close(self) -> None:
        """Let go of the lock; a second call does nothing."""
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and self._lock is not None and not self.units:
            unmake(self.path, self._made, self._lock)
        self.close()

    def frame_path(self, index: int) -> Path:
        """Return where the frame of that index goes.

        Parameters: as `finished_frame`.
        Returns: as `picture_path`.
        """
        return self.path / "frames" / f"{index:06d}.npz"

    def picture_path(self, name: str) -> Path:
        """Return where the picture of that name goes; `InputError` if it is not one word.

        Parameters
        ----------
        name : str
            One word, without suffix.

        Returns
        -------
        Path
        """
        if not is_word(name):
            raise InputError(one_line(f"picture is called {name!r}; expected letters, digits, - and _"))
        return self.path / "pictures" / f"{name}.png"

    @property
    def report_path(self) -> Path:
        """Where the report goes."""
        return self.path / "report.html"

    @property
    def map_npz_path(self) -> Path:
        """Where the map goes, with all that is known of it."""
        return self.path / MAP

    @property
    def landmarks_path(self) -> Path:
        """Where the landmarks go that the map is made of."""
        return self.path / LANDMARKS

    @property
    def map_vtu_path(self) -> Path:
        """Where the map goes as VTU."""
        return self.path / "map.vtu"

    @property
    def map_ply_path(self) -> Path:
        """Where the map goes as PLY."""
        return self.path / "map.ply"

    def record(self, path: PathLike, *, input_hash: str, content: PathLike | None = None) -> Unit:
        """Note in the manifest that a file of this folder is finished.

        Parameters
        ----------
        path : str or path
            The file, written and closed.
        input_hash : str
            Hash of what it was made from.
        content : str or path, optional
            The file that takes its place next, if it is not there yet.

        Returns
        -------
        Unit
            The line that was appended.

        Raises
        ------
        InputError
            If the file is not one that a run makes in this folder, or cannot be read.
        OutputError
            If the manifest cannot be written.
        """
        self._writable(self._manifest)
        name = self._name(path)
        if not is_result(name):
            raise bad_input(path, "is not in its place", "a file that a run makes")
        content = path if content is None else content
        unit = Unit(name, sha256_file(content), os.path.getsize(content), input_hash, self.config_hash)
        append_unit(self._manifest, unit)
        self.units[name] = unit
        return unit

    def is_done(self, path: PathLike, *, input_hash: str) -> bool:
        """Whether a file is noted as finished from that input with these settings, and is still what it was.

        Parameters
        ----------
        path : str or path
            The file.
        input_hash : str
            Hash of what it would be made from.

        Returns
        -------
        bool
            False also when the file is missing or was changed.
        """
        unit = self.units.get(self._name(path))
        if unit is None or (unit.input, unit.config) != (input_hash, self.config_hash):
            return False
        target = Path(path)
        if not target.is_file() or target.stat().st_size != unit.bytes or unit.bytes == 0:
            return False
        return sha256_file(target) == unit.sha256

    def finished_frame(self, index: int) -> Path:
        """Return where the stored frame of that index is, after it was held against the manifest.

        Parameters
        ----------
        index : int
            Place in the sequence.

        Returns
        -------
        Path
            Its file, byte for byte as the run left it.

        Raises
        ------
        InputError
            If the run did not finish that frame, or its file is missing or was changed.
        """
        target = self.frame_path(index)
        unit = self.units.get(self._name(target))
        if unit is None:
            stored = self.stored_frames
            near = sorted([k for k in stored if k < index][-1:] + [k for k in stored if k > index][:1])
            nearest = f", the nearest {' and '.join(map(str, near))}" if near else ""
            why = f"has no finished frame {index}{self._why_not(index)}"
            raise bad_input(self.path, why, f"one of its {len(stored)} frames{nearest}")
        self.check_unchanged(target)
        return target

    def check_unchanged(self, path: PathLike) -> None:
        """Raise `InputError` if a file that the manifest lists is missing or was changed since the run.

        Parameters
        ----------
        path : str or path
            The file.
        """
        unit = self.units.get(self._name(path))
        if unit is not None and not self.is_done(path, input_hash=unit.input):
            raise bad_input(path, "is missing or was changed since the run", "the file that the manifest lists")

    @property
    def stored_frames(self) -> tuple[int, ...]:
        """Indices of the frames that have a file, ascending."""
        found = (_FRAME.fullmatch(name) for name in self.units)
        return tuple(sorted(int(match[1]) for match in found if match))

    def _why_not(self, index: int) -> str:
        """Why a frame of a finished run has no file, if ``run.json`` tells."""
        with contextlib.suppress(InputError):  # there may be none yet
            rows = self.read_run().get("per_frame")
            for row in rows if isinstance(rows, list) else ():
                if isinstance(row, dict) and row.get("index") == index:
                    return f": {row.get('no_complex') or 'it is no keyframe, so it has a pose and no file'}"
        return ""

    def keep(self, names: Iterable[str]) -> None:
        """Make these the folder's only finished units: the files of others go, and the manifest lists these by name.

        Parameters
        ----------
        names : iterable of str
            Units, as in `units`.

        Raises
        ------
        OutputError
            If a file cannot be removed or the manifest not be written.
        """
        self._writable(self._manifest)
        kept = {name: self.units[name] for name in sorted(set(names))}
        try:
            for name in self.units.keys() - kept.keys():
                (self.path / name).unlink(missing_ok=True)
        except OSError as error:
            raise bad_output(self.path, error) from error
        write_manifest(self._manifest, kept.values())
        self.units = kept

    def write_run(self, values: Mapping[str, Any]) -> Path:
        """Write ``run.json``: what the run found; nothing in it may differ when the run is repeated.

        Parameters
        ----------
        values : dict
            Fit for JSON, without NaN.

        Returns
        -------
        Path
            The file.
        """
        return self._write_json("run.json", values)

    def write_timings(self, values: Mapping[str, Any]) -> None:
        """Write ``timings.json``, the only place for what varies from run to run.

        Parameters: as `write_run`.
        """
        self._write_json(TIMINGS, values)

    def read_run(self) -> dict[str, Any]:
        """Return what ``run.json`` holds; `InputError` if it is missing or damaged.

        Returns
        -------
        dict
        """
        return read_object(self.path / "run.json")

    def read_rows(self) -> list[dict[str, Any]]:
        """Return the rows of ``per_frame`` in ``run.json``: numbers of each frame that has a pose, in order.

        Each has at least its ``index`` and its ``stamp``. A run of a single mesh has none.

        Returns
        -------
        list of dict

        Raises
        ------
        InputError
            If ``run.json`` is missing or damaged, or its rows are no such rows.
        """
        return checked_rows(self.path / "run.json", self.read_run())

    def read_timings(self) -> dict[str, Any]:
        """Return what ``timings.json`` holds; `InputError` if it is missing or damaged.

        Returns: as `read_run`.
        """
        return read_object(self.path / TIMINGS)

    def write_trajectory(self, stamp: ArrayLike, T_world_camera: ArrayLike) -> list[Path]:
        """Write ``trajectory.tum`` and ``trajectory.kitti.txt``.

        Parameters
        ----------
        stamp : (T,) float array
            Times, s.
        T_world_camera : (T, 4, 4) float array
            Poses, camera to world, m.

        Returns
        -------
        list of Path
            The two files.
        """
        tum, kitti = self.path / "trajectory.tum", self.path / "trajectory.kitti.txt"
        self._writable(tum)
        write_tum(tum, stamp, T_world_camera)
        write_kitti(kitti, T_world_camera)
        return [tum, kitti]

    def _write_json(self, name: str, values: Mapping[str, Any]) -> Path:
        target = self.path / name
        self._writable(target)
        try:
            data = (json.dumps(values, sort_keys=True, indent=1, allow_nan=False) + "\n").encode("ascii")
        except (TypeError, ValueError, RecursionError) as error:
            raise bad_input(target, f"cannot hold these values ({error})", "plain JSON, no NaN") from error
        write_bytes(target, data)
        return target

    def _name(self, path: PathLike) -> str:
        try:
            return Path(path).resolve().relative_to(self.path.resolve()).as_posix()
        except (OSError, ValueError) as error:
            raise bad_input(path, "is not in this run folder", f"a file below {self.path}") from error

    def _writable(self, target: Path) -> None:
        if self._lock is None:
            raise OutputError(one_line(f"{target}: the run folder is open for reading only; expected a created one"))

    def _own_manifest(self) -> None:
        """Write the manifest anew without a torn last line, or if the file has a second name, which others may use."""
        try:
            status = os.lstat(self._manifest)
        except FileNotFoundError:
            return
        except OSError as error:
            raise bad_output(self._manifest, error) from error
        if status.st_size > self._size or status.st_nlink > 1:
            whole = read_bytes(self._manifest, "a manifest")[: self._size] if status.st_size else b""
            write_bytes(self._manifest, whole)
