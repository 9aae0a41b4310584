"""What a batch has come to: a row for each recording, in ``batch.json`` and on a page."""

from __future__ import annotations

import contextlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from .. import __version__
from .._atomic import write_bytes
from .._files import PathLike
from ..errors import InputError
from ..io import RunFolder
from ..io._record import read_object
from ..view.batch import write_batch_page

JSON, PAGE = "batch.json", "batch.html"
STATES = ("complete", "degraded", "failed", "refused", "not written", "poisoned", "unfinished")
"""What can become of a recording. The first two have results; of the others an error says why they have none."""
_COUNTS = ("frames", "tracked", "keyframes", "landmarks", "loops")
_ERRORS = ("ate_rmse_m", "rpe_translation_percent_10m", "rpe_rotation_deg_frame", "matched", "total")
_PICTURES = ("map_path", "path", "view3d_signal", "mesh_depth", "keypoints_depth")  # the first that is there is shown
_NAME = re.compile(r"[^./\\\0][^/\\\0]{0,254}")


@dataclass(frozen=True)
class Row:
    """What has become of one recording.

    Attributes
    ----------
    name : str
        Of its run folder, which is beside ``batch.json``.
    source : str
        Where it is.
    state : str
        One of `STATES`.
    how : str
        "new", "resumed", or "there" if an earlier batch had finished it.
    error : str
        Why there is no result.
    frames, tracked, lost, skipped, keyframes, landmarks, loops : int
        As ``run.json`` tells.
    attempts : int
        How often it was begun in this batch; more than 1 if its worker died.
    seconds, frames_per_s : float or None
        Time of the run and its pace, as ``timings.json`` tells.
    evaluation : dict or None
        Errors of the path, as ``tspslam eval`` names them: of true poses that were given, or that the recording has.
    warnings : list of str
        What the run warns of.
    picture : str
        A picture of the run, relative to the folder; empty if there is none.
    """

    name: str
    source: str
    state: str = "unfinished"
    how: str = "new"
    error: str = ""
    frames: int = 0
    tracked: int = 0
    lost: int = 0
    skipped: int = 0
    keyframes: int = 0
    landmarks: int = 0
    loops: int = 0
    attempts: int = 0
    seconds: float | None = None
    frames_per_s: float | None = None
    evaluation: dict[str, Any] | None = None
    warnings: list[str] = field(default_factory=list)
    picture: str = ""

    @property
    def is_finished(self) -> bool:
        """Whether there is a result, whole or degraded."""
        return self.state in STATES[:2]


def found_of(folder: Path) -> dict[str, Any]:
    """What a finished run folder tells, by the names of `Row`.

    Parameters
    ----------
    folder : path
        The run folder.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        If it is none, or not finished, or changed since.
    """
    run = RunFolder.open(folder)
    for name in ("run.json", "report.html"):  # the last two that a run writes
        if name not in run.units:
            raise InputError(f"{folder}: is not finished, expected a {name} that the manifest lists")
        run.check_unchanged(folder / name)
    for name, unit in run.units.items():  # to read all of it would take as long as to look at the images again
        if not (folder / name).is_file() or (folder / name).stat().st_size != unit.bytes:
            raise InputError(f"{folder / name}: is missing or was changed since the run")
    record, rows, times = run.read_run(), run.read_rows(), {}
    with contextlib.suppress(InputError):  # killed after the last result, before its times
        times = run.read_timings()
    lost = sum(bool(row.get("is_lost")) for row in rows)
    told = record.get("evaluation") or {}
    return {name: int(record.get(name) or 0) for name in _COUNTS} | {
        "state": "complete" if record.get("status") == "complete" else "degraded",
        "lost": lost, "skipped": int(record.get("frames") or 0) - len(rows),
        "seconds": times.get("total_s"), "frames_per_s": times.get("frames_per_s"),
        "evaluation": {name: told.get(name) for name in _ERRORS} if told else None,
        "warnings": [str(each.get("message", "")) for each in record.get("warnings") or ()],
        "picture": _picture_of(folder),
    }  # fmt: skip


def errors_of(described: Mapping[str, Any]) -> dict[str, Any]:
    """Those errors of a path that a row has.

    Parameters
    ----------
    described : mapping
        As `tspslam.run.evaluate.describe_errors` gives them.

    Returns
    -------
    dict
    """
    return {name: described.get(name) for name in _ERRORS}


def _picture_of(folder: Path) -> str:
    names = (f"{folder.name}/pictures/{name}.png" for name in _PICTURES)
    return next((name for name in names if (folder.parent / name).is_file()), "")


def settings_of(folder: Path) -> Mapping[str, Any]:
    """The settings that a run folder was made with; `InputError` if it is none.

    Parameters
    ----------
    folder : path
        The run folder.

    Returns
    -------
    mapping
        As ``config.yaml`` holds them.
    """
    return RunFolder.open(folder).config


def read_names(runs: Path) -> dict[str, str]:
    """Names that earlier batches gave, by source; none where there was no batch.

    Parameters
    ----------
    runs : path
        The folder of a batch.

    Returns
    -------
    dict of str to str
        A name that is a path, hidden or given twice is left out.

    Raises
    ------
    InputError
        If ``batch.json`` is there and is not what a batch writes.
    """
    path = runs / JSON
    if not path.exists():
        return {}
    told = read_object(path).get("names")
    if not isinstance(told, dict):
        raise InputError(f"{path}: has no names of recordings, expected the summary of a batch, or a free name")
    names = {key: name for key, name in told.items() if isinstance(name, str) and _NAME.fullmatch(name)}
    times = Counter(name.casefold() for name in names.values())
    return {key: name for key, name in names.items() if times[name.casefold()] == 1}


def count_states(rows: Iterable[Row]) -> dict[str, int]:
    """How many recordings there are of each state that there is.

    Parameters
    ----------
    rows : iterable of Row
        Of a batch.

    Returns
    -------
    dict of str to int

    Examples
    --------
    >>> count_states([Row("a", "/a", "complete"), Row("b", "/b", "refused"), Row("c", "/c", "complete")])
    {'complete': 2, 'refused': 1}
    """
    found = Counter(row.state for row in rows)
    return {state: found[state] for state in STATES if found[state]}


def describe_batch(rows: list[Row], names: Mapping[str, str], **more: Any) -> dict[str, Any]:
    """The content of ``batch.json``.

    Parameters
    ----------
    rows : list of Row
        In the order in which the recordings were given.
    names : mapping of str to str
        Of all recordings that ever were in this folder, by source.
    more : plain values
        What else is said of the batch.

    Returns
    -------
    dict
        Fit for JSON.
    """
    return {
        "version": __version__, "recordings": len(rows), "states": count_states(rows), **more,
        "names": dict(sorted(names.items())), "rows": [asdict(row) for row in rows],
    }  # fmt: skip


def write_summary(runs: PathLike, described: Mapping[str, Any], *, has_page: bool = True) -> None:
    """Write ``batch.json``, and ``batch.html`` from it.

    Parameters
    ----------
    runs : path
        The folder of the batch.
    described : mapping
        As `describe_batch` makes it.
    has_page : bool
        Whether the page is written too.

    Raises
    ------
    OutputError
        If they cannot be written; each is whole or as it was.
    """
    data = json.dumps(described, indent=1, allow_nan=False) + "\n"
    write_bytes(Path(runs) / JSON, data.encode("ascii"))
    if has_page:
        write_batch_page(Path(runs) / PAGE, described)
