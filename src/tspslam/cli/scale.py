"""Many recordings at once: ``tspslam batch``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..printing import note, say
from ._fleet import fleet_progress
from ._shared import (  # fmt: skip
    BAD_INPUT,
    COMPLETE,
    DEGRADED,
    INTERNAL,
    NOT_WRITTEN,
    ConfigOption,
    JsonOption,
    PresetOption,
    SetOption,
    ThreadsOption,
    app,
)
from ._workers import MemoryOption, SchedulerOption, find_workers

if TYPE_CHECKING:
    from ..scale.batch import BatchResult
    from ..scale.summary import Row


@app.command("batch")
def batch_command(
    sources: Annotated[
        list[Path],
        typer.Argument(
            metavar="LIST|FOLDER...", help="Lists of recordings, one a line; recordings; folders of them.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[Path, typer.Option("--out", help="Folder of the run folders, one a recording.")],
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes on this machine [default: one a core].")
    ] = None,
    scheduler: SchedulerOption = None,
    memory: MemoryOption = None,
    threads: ThreadsOption = None,
    truths: Annotated[
        Path | None, typer.Option("--eval", metavar="TRUTHS", help="True poses: a folder with NAME.txt, or a list.")
    ] = None,
    preset: PresetOption = "default",
    config: ConfigOption = None,
    assignments: SetOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Run many recordings, each into a folder of its own, on Dask. The same command again goes on."""
    from ..run import config as configuration
    from ..scale.batch import run_batch

    where = find_workers(workers, scheduler, threads, memory)
    resolved = configuration.resolve(preset, config, assignments or [])
    with fleet_progress(as_json) as on_event:
        result = run_batch(sources, out, resolved, workers=where, truths=truths, on_event=on_event)
    say(*([json.dumps(result.described)] if as_json else _tabulate(result)))
    if result.lost:
        left = sum(row.state == "unfinished" for row in result.rows)
        note(f"tspslam: {result.lost}: {left} recordings are not finished; the same command goes on with them")
    code = _code_of(result.rows) or (DEGRADED if result.unmeasured else COMPLETE)
    if code != COMPLETE:
        raise typer.Exit(code)


def _code_of(rows: list[Row]) -> int:
    """The exit code of a batch: the worst that needs a hand, but recordings that failed beside others degrade it."""
    states = {row.state for row in rows}
    if "not written" in states:
        return NOT_WRITTEN
    if states == {"complete"}:
        return COMPLETE
    return {frozenset({"refused"}): BAD_INPUT, frozenset({"failed"}): INTERNAL}.get(frozenset(states), DEGRADED)


def _tabulate(result: BatchResult) -> list[str]:
    """Lines for what has become of all recordings, and where to look."""
    counts = ", ".join(f"{count} {state}" for state, count in result.described["states"].items())
    lines = [f"{len(result.rows)} recording{'' if len(result.rows) == 1 else 's'}: {counts}"]
    measured = [row for row in result.rows if row.evaluation]
    if measured:
        lines += ["", *_table([_errors(row) for row in measured])]
        others = [row.name for row in result.rows if row.state in ("complete", "degraded") and not row.evaluation]
        lines += [f"without true poses that fit: {', '.join(others)}"] if others else []
    return [*lines, "", f"page:     {result.folder / 'batch.html'}", f"summary:  {result.folder / 'batch.json'}"]


def _errors(row: Row) -> dict[str, str]:
    found = row.evaluation or {}
    numbers = {
        "ATE m": found.get("ate_rmse_m"), "RPE % of 10 m": found.get("rpe_translation_percent_10m"),
        "RPE deg/frame": found.get("rpe_rotation_deg_frame"),
    }  # fmt: skip
    shown = {name: "-" if value is None else f"{value:.3g}" for name, value in numbers.items()}
    return {"recording": row.name, **shown, "poses": f"{found.get('matched')} of {found.get('total')}"}


def _table(rows: list[dict[str, str]]) -> list[str]:
    """Rows in columns, under their names."""
    all_rows = [{name: name for name in rows[0]}, *rows]
    widths = {name: max(len(row[name]) for row in all_rows) for name in rows[0]}
    return ["  ".join(f"{row[name]:<{width}}" for name, width in widths.items()).rstrip() for row in all_rows]
