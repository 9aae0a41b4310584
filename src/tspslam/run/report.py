"""The report of a whole run: in its folder when it ends, or later as one page to hand on (``tspslam report``)."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from PIL import Image as PillowImage

from .._files import PathLike, bad_input
from ..errors import GeometryError, InputError
from ..frame import Frame
from ..io import RunFolder, read_frame, read_trajectory
from ..io._record import checked_rows, read_object
from ..io.topological import read_map
from ..session import Settings
from ..topological_map import TopologicalMap
from ..types import FloatArray, Rig
from ..view._map_section import MAP_CAPTIONS
from ..view._report_gallery import shot_of, thinned
from ..view._report_parts import FrameState, Shot, WholeRun
from ..view.report import CAPTIONS, write_report
from ..vision.evaluate import TrajectoryErrors
from .config import Resolved, describe, resolve
from .evaluate import describe_errors, evaluated
from .evaluate_recordings import evaluated_recordings
from .guard import PAGE, check_place
from .health import frame_states, judge_calibration

T = TypeVar("T")
TIMES_VARY = (
    "Seconds differ from run to run, and the bytes of this page do not: timings.json beside it has them, and "
    "“tspslam report” writes the page with their picture in it."
)


@dataclass(frozen=True)
class Page:
    """A page that was written, and what it could not show, a line each."""

    path: Path
    missing: tuple[str, ...]


def describe_whole(
    folder: RunFolder, record: Mapping[str, Any], settings: Resolved | Settings, stored: Sequence[int],
    *, rig: Rig, made: TopologicalMap | None, poses: Mapping[int, FloatArray], errors: TrajectoryErrors | None,
) -> WholeRun:  # fmt: skip
    """Collect what the report in a run's own folder shows; frames are read one at a time, when their turn comes.

    Parameters
    ----------
    folder : RunFolder
        With the stored frames.
    record : dict
        Content of ``run.json``.
    settings : Resolved or Settings
        Of the run.
    stored : sequence of int
        Its frames that have a file; the folder may still have those of an earlier call.
    rig : Rig
        Its cameras.
    made : TopologicalMap or None
        Its map.
    poses : dict of int to (4, 4) float64
        By the places of the frames.
    errors : TrajectoryErrors or None
        Of its path, where the true one is known.

    Returns
    -------
    WholeRun
    """
    states = frame_states(record)
    return WholeRun(
        states=states, poses=poses, errors=errors,
        findings=judge_calibration(record["calibration"], rig, None if made is None else made.gain),
        settings=_changed(settings),
        shots=_shots(states, thinned(stored), lambda index: read_frame(folder.frame_path(index))),
        stored=len(stored), timings=TIMES_VARY,
    )  # fmt: skip


def write_page(
    run: PathLike,
    output: Path | None = None,
    *,
    truth: PathLike | Sequence[PathLike] | None = None,
    is_forced: bool = False,
) -> Page:
    """Write the report of a run as one page with all in it, for handing on; what cannot be read is named on it.

    Parameters
    ----------
    run : path
        The run folder, finished or not.
    output : path, optional
        The HTML file; RUN-report.html here by default.
    truth : path or sequence of path, optional
        True poses, as `evaluated` takes them; of a run of several recordings one for each, in their order.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    Page

    Raises
    ------
    InputError
        If it is no run folder of this version, nothing in it can be shown, or the page may not be written there.
    OutputError
        If it cannot be written.
    """
    folder = RunFolder.open(run)
    target = output or Path(f"{folder.path.resolve().name}-report.html")
    truths = [Path(each) for each in ([truth] if isinstance(truth, str | os.PathLike) else truth or ())]
    check_place(target, PAGE, [folder.path, *truths], is_forced=is_forced)
    found = _Found(folder)
    record, made = found.record(), found.map()
    states, shots = frame_states(record), list(found.shots(frame_states(record)))
    frame = found.first_frame()
    if frame is None and made is None and not found.has_record:
        raise bad_input(run, f"holds nothing that can be shown ({'; '.join(found.missing[:2])})", "a run with a frame")
    errors = found.tried(lambda: _measure(folder.path, truths, record)) if truths else None
    rig = made.rig if made is not None else None if frame is None else frame.rig
    calibration = record.get("calibration")
    findings = judge_calibration(calibration, rig, made.gain if made else None) if isinstance(calibration, dict) else []
    whole = WholeRun(
        states=states, poses=found.poses(record), errors=errors, findings=findings, settings=found.settings(),
        shots=shots, stored=len(folder.stored_frames), timings=found.timings(), missing=found.missing,
    )  # fmt: skip
    write_report(frame, record, found.pictures(), target, map_=made, whole=whole)
    return Page(target, tuple(found.missing))


def _measure(run: Path, truths: Sequence[Path], record: dict[str, Any]) -> TrajectoryErrors:
    """Errors of the path, noted in the record; those of each recording too, where there is a true path for each."""
    if len(truths) == 1:
        errors = evaluated(run, truths[0])
    else:
        found = evaluated_recordings(run, truths)
        errors = found.joint
        for one in record["recordings"]:
            one["evaluation"] = describe_errors(found.each[one["name"]])
    record["evaluation"] = describe_errors(errors)
    return errors


@dataclass
class _Found:
    """What of a run folder can be read; what cannot is noted in `missing`."""

    folder: RunFolder
    missing: list[str] = field(default_factory=list)
    has_record: bool = False

    def tried(self, read: Callable[[], T]) -> T | None:
        """What a reader gives, or None after a line on why not."""
        try:
            return read()
        except (InputError, GeometryError) as error:
            if str(error) not in self.missing:
                self.missing.append(str(error))
            return None

    def record(self) -> dict[str, Any]:
        """``run.json``; where there is none, what the files of the frames say."""
        path = self.folder.path / "run.json"
        if path.exists():
            record = self.tried(lambda: self._whole(path))
            if record is not None:
                self.has_record = True
                if self.tried(lambda: checked_rows(path, record)) is None:
                    del record["per_frame"]
                return record
        else:
            self.missing.append(
                "run.json is not there yet: the run has not ended, and this is what it has stored so far"
            )
        rows = [row for row in map(self._row, self.folder.stored_frames) if row is not None]
        source = self.folder.config.get("source")
        name = source.get("name") if isinstance(source, Mapping) else self.folder.path.resolve().name
        counts = {"frames": len(rows), "keyframes": sum(bool(row.get("is_keyframe")) for row in rows)}
        return {"status": "not finished", "source": str(name), **counts, "per_frame": rows}

    def _whole(self, path: Path) -> dict[str, Any]:
        self.folder.check_unchanged(path)
        return self.folder.read_run()

    def _row(self, index: int) -> dict[str, Any] | None:
        """Numbers of a stored frame."""
        path = self.folder.frame_path(index).with_suffix(".json")
        read = self.tried(lambda: read_object(path))
        rows = None if read is None else self.tried(lambda: checked_rows(path, {"per_frame": [read]}))
        return rows[0] if rows else None

    def map(self) -> TopologicalMap | None:
        """The map of several keyframes."""
        path = self.folder.map_npz_path
        if path.name not in self.folder.units:
            return None
        made = self.tried(lambda: self._unchanged_map(path))
        return made if made is not None and len(made.keyframes) > 1 else None

    def _unchanged_map(self, path: Path) -> TopologicalMap:
        self.folder.check_unchanged(path)
        return read_map(path)

    def shots(self, states: Sequence[FrameState]) -> Iterator[Shot]:
        """Frames of the gallery that can be read."""
        return _shots(states, thinned(self.folder.stored_frames), self._frame)

    def first_frame(self) -> Frame | None:
        """The first stored frame that can be read, as the pages need it."""
        for index in self.folder.stored_frames:
            frame = self._frame(index)
            if frame is not None:
                blank = np.zeros((frame.rig.height, frame.rig.width), np.uint8)  # of filter: it shows its mesh
                return frame if frame.image is not None else replace(frame, image=blank)
        return None

    def _frame(self, index: int) -> Frame | None:
        return self.tried(lambda: read_frame(self.folder.finished_frame(index)))

    def poses(self, record: Mapping[str, Any]) -> dict[int, FloatArray]:
        """Poses of the frames, by their places."""
        path = self.folder.path / "trajectory.tum"
        if path.name not in self.folder.units:
            return {}
        track = self.tried(lambda: read_trajectory(path))
        if track is None:
            return {}
        at = {stamp: k for k, stamp in enumerate(track.stamp.tolist())}
        rows = [(row["index"], at.get(row["stamp"])) for row in record.get("per_frame", [])]
        return {index: track.T_world_camera[k] for index, k in rows if k is not None}

    def settings(self) -> dict[str, dict[str, Any]] | None:
        """Settings that are not the default; of ``tspslam filter`` they have no names."""
        if "command" in self.folder.config:
            return None
        resolved = self.tried(lambda: resolve(file=self.folder.path / "config.yaml"))
        return None if resolved is None else _changed(resolved)

    def timings(self) -> dict[str, Any] | None:
        """``timings.json``, which is written last."""
        times = self.tried(self.folder.read_timings) if self.has_record else None  # else it is not written yet
        return times if times is not None and "frames" in times else None

    def pictures(self) -> list[Path]:
        """Pictures that are as they were left, in the order in which a run draws them."""
        names = [name for name in self.folder.units if name.startswith("pictures/")]
        order = {name: k for k, name in enumerate((*MAP_CAPTIONS, *CAPTIONS))}
        paths = sorted((self.folder.path / name for name in names), key=lambda p: (order.get(p.stem, 99), p.stem))
        return [path for path in paths if self.tried(lambda path=path: self._whole_picture(path))]  # type: ignore[misc]

    def _whole_picture(self, path: Path) -> Path:
        self.folder.check_unchanged(path)
        try:
            with PillowImage.open(path) as picture:
                picture.verify()
        except (OSError, ValueError, SyntaxError) as error:
            raise bad_input(path, f"is not a picture that can be read ({error})", "a PNG") from error
        return path


def _shots(states: Sequence[FrameState], indices: Sequence[int], read: Callable[[int], Frame | None]) -> Iterator[Shot]:
    """Frames for the gallery, each read when it is its turn; one without an image has nothing to show there."""
    known = {one.frame: one for one in states}
    for index in indices:
        frame = read(index)
        if frame is not None and frame.image is not None:
            one = known.get(index)
            state = one.state if one else "lost" if frame.is_lost else "keyframe"
            yield shot_of(frame, state, one.landmarks if one else None)


def _changed(settings: Resolved | Settings) -> dict[str, dict[str, Any]]:
    """Settings that are not the default."""
    return {name: row for name, row in describe(settings).items() if row["value"] != row["default"]}
