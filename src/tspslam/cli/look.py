"""Looking at a run: ``tspslam report``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..printing import note, say
from ._shared import DEGRADED, ForceOption, JsonOption, app, check_suffix


@app.command("report")
def report_command(
    run: Annotated[Path, typer.Argument(help="A run folder, finished or not.")],
    output: Annotated[Path | None, typer.Option(help="HTML file [default: RUN-report.html here].")] = None,
    truth: Annotated[Path | None, typer.Option(help="True poses, as eval takes them.")] = None,
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
