"""The run folder of a join: frames and state are brought to it, then it is ended as any run is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ...io import RunFolder
from ...io._config import plain
from ...io._places import MANIFEST
from ...io._settling import is_run_folder, read_config, refuse_foreign, settle_config
from ...io.manifest import read_manifest
from ...run._stages import OnStep
from ...run.continuing import link_file
from ...run.pipeline import RunResult, run, settings_of
from ...run.record import FrameRecord
from ...run.sequence import STATE_NAME
from .joined_runs import JoinedRuns
from .states import read_step
from .steps import Plan

_RECORD = "run.json"


def check_out(out: Path, plan: Plan) -> bool:
    """Refuse a folder that holds something else than what this join leaves.

    Parameters
    ----------
    out : Path
        The run folder.
    plan : Plan
        Of the join.

    Returns
    -------
    bool
        Whether it has the joined state already, and what is to be said of that is known.

    Raises
    ------
    InputError
        If the folder holds something else, or a run of other recordings or settings.
    """
    if not _is_begun(out):
        return False
    settle_config(out, plain(settings_of(plan.joined, None, plan.runs[0].settings)))
    folder = RunFolder.open(out)
    state, record = (folder.units.get(name) for name in (STATE_NAME, _RECORD))
    is_told = record is not None and folder.is_done(out / _RECORD, input_hash=record.input)
    return state is not None and state.input == plan.digest and (is_told or plan.remarks.is_file())


def is_of_fewer(out: Path, plan: Plan) -> bool:
    """Tell whether a folder holds a join of some of the runs only: as where the others' states were of no use.

    Parameters
    ----------
    out : Path
        The run folder.
    plan : Plan
        Of the join.

    Returns
    -------
    bool

    Raises
    ------
    InputError
        If the folder holds something else than a run.
    """
    if not _is_begun(out):
        return False
    source = read_config(out).get("source")
    known = source.get("joined_from") if isinstance(source, dict) else None
    wanted = plan.joined.joined_from
    return isinstance(known, list) and len(known) < len(wanted) and [run for run in wanted if run in known] == known


def _is_begun(out: Path) -> bool:
    """Whether a unit of a run is finished there; refuses what is none of a run."""
    refuse_foreign(out)
    return is_run_folder(out) and bool(read_manifest(out / MANIFEST)[0])


def write_run(plan: Plan, out: Path, left_out: Mapping[str, str], on_step: OnStep | None) -> RunResult:
    """Write the run of a join whose state is there: what its calibration is like, the map, pictures and report.

    Parameters
    ----------
    plan : Plan
        Of the join.
    out : Path
        The run folder.
    left_out : dict of str to str
        Why runs were left out, by their paths.
    on_step : callable or None
        As for `tspslam.run.pipeline.run`.

    Returns
    -------
    RunResult
    """
    settings = plan.runs[0].settings
    source = JoinedRuns(
        plan.runs, _refused(plan, out), [f"{path} is left out: {why}" for path, why in left_out.items()]
    )
    with RunFolder.create(out, settings_of(source, None, settings)) as folder:
        if not folder.is_done(out / STATE_NAME, input_hash=plan.digest):
            _bring(plan, folder)
    return run(source, out, settings, on_step=on_step)


def _refused(plan: Plan, out: Path) -> list[str]:
    """What is to be said of places that were not believed: as the step says, or the run, once that is there."""
    if plan.remarks.is_file():
        return plan.remarks.read_text("utf-8").splitlines()
    warnings = RunFolder.open(out).read_run().get("warnings", [])
    return [one["message"] for one in warnings if one["code"] == "join_refused"]


def _bring(plan: Plan, folder: RunFolder) -> None:
    """Bring the frames, and the state: that counts once all is there."""
    rows, _ = read_step(plan.file("adjustment"))
    first = RunFolder.open(plan.runs[0].path)
    for row in rows:
        if not isinstance(row, FrameRecord) or row.complex_ is None:
            continue
        file, target = plan.frame(row.index), folder.frame_path(row.index)
        if row.index < plan.runs[0].pairs and plan.runs[0].is_numbered:  # it keeps its numbers
            file = first.finished_frame(row.index)
            first.check_unchanged(file.with_suffix(".json"))
        for suffix in (".npz", ".json"):
            link_file(file.with_suffix(suffix), target.with_suffix(suffix))
            folder.record(target.with_suffix(suffix), input_hash=row.input_hash)
    link_file(plan.file("adjustment"), folder.path / STATE_NAME)
    folder.record(folder.path / STATE_NAME, input_hash=plan.digest)
