"""Finished runs to one map: ``tspslam join``."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from ..printing import note
from ._progress import progress
from ._shared import DEGRADED, JsonOption, ThreadsOption, announce_compilation, app, finish
from ._workers import MemoryOption, SchedulerOption, find_workers


@app.command("join")
def join_command(
    runs: Annotated[
        list[Path], typer.Argument(metavar="RUN...", help="Folders of finished runs.", show_default=False)
    ],
    *,
    out: Annotated[Path, typer.Option("--out", help="Run folder of the joined map.")],
    workers: Annotated[
        int, typer.Option(min=0, max=1024, help="Processes of Dask [default: this one alone].", show_default=False)
    ] = 0,
    scheduler: SchedulerOption = None,
    memory: MemoryOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:  # fmt: skip
    """Join the maps of finished runs of one place, without tracking anew. The same command again goes on."""
    from .._threads import set_threads
    from ..run._compiling import compiling
    from ..scale.dispatching import SchedulerLostError
    from ..scale.maps.joining import join_runs

    if memory is not None and not (workers or scheduler):
        raise typer.BadParameter("is for --workers: there are none", param_hint="--memory")
    where = find_workers(workers or None, scheduler, threads, memory) if workers or scheduler else None
    with contextlib.ExitStack() as stack:
        on_step = stack.enter_context(progress(as_json))
        set_threads(threads)
        announce_compilation(is_sequence=True)
        try:
            with compiling(is_sequence=True, has_frames=False):
                result = join_runs(runs, out, workers=where, on_note=note, on_step=on_step)
        except SchedulerLostError as error:
            note(f"tspslam: {error}; the same command goes on")
            raise typer.Exit(DEGRADED) from error
        stack.close()  # the line of progress ends before the results
        finish(result.run, as_json)
    if result.left_out:
        raise typer.Exit(DEGRADED)
