"""Looking at a run: ``tspslam report`` and ``view``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..printing import note, say
from ._shared import DEGRADED, ForceOption, JsonOption, app, check_suffix

HostOption = Annotated[str, typer.Option(help="Address to listen at; another than this machine's needs a token.")]
PortOption = Annotated[int, typer.Option(min=0, max=65535, help="First port to try; 0 is any.")]


@app.command("report")
def report_command(
    run: Annotated[Path, typer.Argument(help="A run folder, finished or not.")],
    output: Annotated[Path | None, typer.Option(help="HTML file [default: RUN-report.html here].")] = None,
    truth: Annotated[
        list[Path] | None, typer.Option(help="True poses, as eval takes them; again for each recording.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the report of a run as one page for handing on: all is in it, and it opens without network."""
    from ..run.report import write_page

    check_suffix(output or Path("report.html"), ["html"], "--output")
    page = write_page(run, output, truth=truth, is_forced=force)
    for line in page.missing:
        note(f"not shown: {line}")
    say(json.dumps({"written": str(page.path), "missing": page.missing}) if as_json else f"wrote {page.path}")
    if page.missing:
        raise typer.Exit(DEGRADED)


@app.command("view")
def view_command(
    run: Annotated[Path, typer.Argument(help="A run folder, finished or being written.")],
    frame: Annotated[int | None, typer.Option(min=0, help="Index of a keyframe [default: the map].")] = None,
    host: HostOption = "127.0.0.1",
    port: PortOption = 8080,
    beside_run: Annotated[bool, typer.Option("--beside-run", hidden=True, help="Frames come on stdin.")] = False,
) -> None:
    """Show a run in the browser, and follow it while it is being written, until ctrl-C."""
    from ..run.viewing import serve, shots_from_stdin, until_interrupted

    with until_interrupted():
        shots = shots_from_stdin() if beside_run else None
        serve(run, host=host, port=port, frame=frame, say=note, shots=shots)
