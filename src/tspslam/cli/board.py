"""Calibration by a board: ``tspslam calib board`` and ``calib sheet``."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..printing import note, say
from ._progress import progress
from ._shared import ForceOption, JsonOption, ThreadsOption, TopicsOption, check_suffix
from ._sources import index_steps
from .show import calib_app

if TYPE_CHECKING:
    from ..vision.calibration.board import Board

BoardOption = Annotated[str | None, typer.Option("--board", metavar="CxR", help="Chessboard: inner corners, as 9x6.")]
CharucoOption = Annotated[str | None, typer.Option("--charuco", metavar="CxR", help="ChArUco: squares, as 5x7.")]
SquareOption = Annotated[float, typer.Option(help="Side of a square, m.")]
MarkerOption = Annotated[float | None, typer.Option(help="Side of a ChArUco board's marker, m.")]
DictionaryOption = Annotated[str, typer.Option(help="Of its markers.")]
_LENSES = ("brown", "rational", "equidistant")


@calib_app.command("board")
def calib_board_command(
    source: Annotated[
        list[Path], typer.Argument(metavar="LEFT [RIGHT]", help="Folders, a folder with both, video(s), or a bag.")
    ],
    square: SquareOption,
    board: BoardOption = None,
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
    dictionary: DictionaryOption = "4X4_50",
    lens: Annotated[str, typer.Option(help="brown, rational, or equidistant (fisheye).")] = "brown",
    layout: Annotated[str | None, typer.Option(help="Of a video: side-by-side, over-under, alternate.")] = None,
    topics: TopicsOption = None,
    output: Annotated[Path, typer.Option("--output", help="Calibration file to write.")] = Path("calib.yaml"),
    picture: Annotated[Path | None, typer.Option(help="PNG to write [default: OUTPUT-board.png].")] = None,
    threads: ThreadsOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Calibrate two cameras from views of a chessboard or a ChArUco board."""
    from .._threads import set_threads
    from ..datasets.views import open_views
    from ..run.board import calibrate_from, describe_board, tabulate_board, write_calibration
    from ..run.guard import CALIBRATION, PICTURES, check_output

    seen = _board(board, charuco, square, marker, dictionary)
    if lens not in _LENSES:
        raise typer.BadParameter(f"{lens!r}, expected one of {', '.join(_LENSES)}", param_hint="--lens")
    drawn = picture or output.with_name(f"{output.stem}-board.png")
    check_suffix(output, ["yaml", "yml"], "--output")
    check_suffix(drawn, ["png"], "--picture")
    check_output(output, CALIBRATION, source, is_forced=force)
    check_output(drawn, PICTURES["png"], source, is_forced=force)
    set_threads(threads)
    with progress(as_json) as on_step:
        images = open_views(source, layout, topics, on_index=index_steps(on_step))
        found = calibrate_from(seen, images, lens, on_step)
        write_calibration(found, output, drawn)
    if as_json:
        say(json.dumps(describe_board(found) | {"written": str(output), "picture": str(drawn)}, sort_keys=True))
        return
    note(*(f"warning: {message}" for message in found.warnings.values()))
    say(*tabulate_board(found), "", f"wrote {output} and {drawn}")
    say(f"next: tspslam run PAIRS --calib {shlex.quote(str(output))}")


@calib_app.command("sheet")
def calib_sheet_command(
    square: SquareOption,
    board: BoardOption = None,
    charuco: CharucoOption = None,
    marker: MarkerOption = None,
    dictionary: DictionaryOption = "4X4_50",
    output: Annotated[Path, typer.Option("--output", help="File: .pdf, .svg or .png.")] = Path("board.pdf"),
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a board to print at its true size, with a ruler to check the printer by."""
    from ..run.board import write_sheet
    from ..run.guard import PICTURES, check_output

    printed = _board(board, charuco, square, marker, dictionary)
    check_suffix(output, list(PICTURES), "--output")
    check_output(output, PICTURES[output.suffix.lower()[1:]], [], is_forced=force)
    width, height = write_sheet(printed, output)
    if as_json:
        say(json.dumps({"written": str(output), "page_mm": [width, height]}))
        return
    say(f"wrote {output}, {width:g} x {height:g} mm: print it at 100 %, and measure its ruler")


def _board(board: str | None, charuco: str | None, square: float, marker: float | None, dictionary: str) -> Board:
    from ..vision.calibration.board import Charuco, Chessboard

    if (board is None) == (charuco is None):
        raise typer.BadParameter("either this or --charuco is needed, and not both", param_hint="--board")
    if board is not None:
        if marker is not None:
            raise typer.BadParameter("goes with --charuco", param_hint="--marker")
        return Chessboard(*_count(board, "--board"), square)
    if marker is None:
        raise typer.BadParameter("is needed with --charuco: the side of a marker, m", param_hint="--marker")
    return Charuco(*_count(str(charuco), "--charuco"), square, marker, dictionary)


def _count(text: str, option: str) -> tuple[int, int]:
    columns, x, rows = text.lower().partition("x")
    if not (x and text.isascii() and columns.isdecimal() and rows.isdecimal() and len(text) < 12):
        raise typer.BadParameter(f"{text!r}, expected COLUMNSxROWS, such as 9x6", param_hint=option)
    return int(columns), int(rows)
