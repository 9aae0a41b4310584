"""What is done with a finished run: ``tspslam export``, ``map`` and ``eval``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import typer

from ..errors import InputError
from ..printing import note, say
from ._shared import DEGRADED, ForceOption, JsonOption, SetOption, app, check_suffix

if TYPE_CHECKING:
    from ..vision.evaluate import Align


@app.command("export")
def export_command(
    run: Annotated[Path, typer.Argument(help="A run folder.")],
    to: Annotated[
        str, typer.Option("--to", help="vtu, ply, npz, glb, pvd, las, laz, tensors, colmap, nerfstudio, rrd, bag.")
    ] = "vtu",
    frame: Annotated[int | None, typer.Option(min=0, help="Index of a keyframe [default: the map].")] = None,
    layer: Annotated[str | None, typer.Option(help="What gives the colours of glb, las and laz.")] = None,
    output: Annotated[
        Path | None, typer.Option(help="File or folder [default: RUN-map or -FRAME.FORMAT, or RUN-FORMAT, here].")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the map of a finished run, or one of its frames, in another format, without running again."""
    from ..run.export import FORMATS, export

    if to not in FORMATS:
        raise typer.BadParameter(f"{to!r}, expected one of {', '.join(FORMATS)}", param_hint="--to")
    chosen = FORMATS[to]
    if frame is not None and not chosen.has_frames:
        raise typer.BadParameter(f"{to} is of the whole run, expected no frame", param_hint="--frame")
    if layer is not None and not chosen.has_layers:
        named = [each.name for each in FORMATS.values() if each.has_layers]
        raise typer.BadParameter(
            f"{to} has all layers or none, expected it for {', '.join(named)}", param_hint="--layer"
        )
    if chosen.suffix:
        check_suffix(output or Path(f"map{chosen.suffix}"), [chosen.suffix[1:]], "--output")
    target = export(run, to, output, frame=frame, layer=layer, is_forced=force)
    say(json.dumps({"written": str(target)}) if as_json else f"wrote {target}")


@app.command("map")
def map_command(
    run: Annotated[Path, typer.Argument(help="A run folder.")],
    output: Annotated[Path | None, typer.Option(help="File: .npz, .vtu or .ply [default: RUN-map.npz].")] = None,
    assignments: SetOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make the map of a finished run anew, with other settings of it, such as --set mapping.surface.longest=0.3."""
    from ..run.export import OURS, export_map_anew

    check_suffix(output or Path("map.npz"), list(OURS), "--output")
    made = export_map_anew(run, output, assignments or (), is_forced=force)
    said = ", ".join(f"{count} {name}" for name, count in made.items() if name != "written")
    say(json.dumps(made) if as_json else f"wrote {made['written']}: {said}")


@app.command("eval")
def eval_command(
    run: Annotated[Path, typer.Argument(help="A run folder, or a trajectory file (TUM, KITTI, EuRoC).")],
    truth: Annotated[
        list[Path],
        typer.Option(help="True poses: such a file, or a sequence folder that has them; again for each recording."),
    ],
    stamps: Annotated[Path | None, typer.Option(help="Stamps of the lines of KITTI's form, s (times.txt).")] = None,
    max_difference: Annotated[
        float, typer.Option("--max-difference", "--max-diff", min=0, help="Between two matched stamps, s.")
    ] = 0.01,
    offset: Annotated[str, typer.Option(help="Added to the path's stamps, s; or auto: found from the motions.")] = "0",
    align: Annotated[str, typer.Option(help="How the path is laid on the truth: none, origin, se3, sim3.")] = "se3",
    delta: Annotated[str, typer.Option(help="Lengths over which motions are compared: 1f,10m,1s.")] = "",
    kitti: Annotated[bool, typer.Option("--kitti", help="KITTI's table: errors over 100 to 800 m.")] = False,
    plot: Annotated[Path | None, typer.Option(help="PNG, PDF or SVG of both paths and the error along them.")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure a camera path against the true one: ATE after alignment, RPE a frame and over any length."""
    from ..run.evaluate import describe_errors, evaluated, tabulate
    from ..run.evaluate_recordings import evaluated_recordings

    if len(truth) > 1 and stamps:
        raise typer.BadParameter("goes with one --truth", param_hint="--stamps")
    if plot:
        from ..run.guard import PICTURES, check_output

        inputs = [path for path in (run, *truth, stamps) if path]
        check_suffix(plot, list(PICTURES), "--plot")
        check_output(plot, PICTURES[plot.suffix.lower()[1:]], inputs, is_forced=force)
    how: dict[str, Any] = {"max_stamp_difference": max_difference, "align": _alignment(align)}
    how |= {"offset": _offset(offset), "deltas": _deltas(delta)}
    found = evaluated_recordings(run, truth, **how) if len(truth) > 1 else None
    errors = found.joint if found else evaluated(run, truth[0], stamps=stamps, **how)
    if plot:
        from ..view import write_path_picture

        write_path_picture(errors, plot)
    for line in errors.warnings:
        note(f"warning: {line}")
    each = found.each if found else {}
    if as_json:
        parts = {"recordings": {name: describe_errors(one, kitti=kitti) for name, one in each.items()}} if each else {}
        say(json.dumps(describe_errors(errors, kitti=kitti) | parts))
    else:
        said = [line for name, one in each.items() for line in (f"{name}:", *tabulate(one, kitti=kitti), "")]
        said += ["all that was joined, if the true paths are of one frame:"] if each else []
        say(*said, *tabulate(errors, kitti=kitti))
    if plot and not as_json:
        say(f"wrote {plot}")
    if errors.is_mostly_unknown:
        raise typer.Exit(DEGRADED)


def _alignment(text: str) -> Align:
    from ..vision.evaluate import Align

    if text not in get_args(Align):
        expected = ", ".join(get_args(Align))
        raise typer.BadParameter(f"{text!r}, expected one of {expected}", param_hint="--align")
    return cast("Align", text)


def _offset(text: str) -> float | Literal["auto"]:
    from .._text import is_plain

    if text == "auto":
        return "auto"
    try:
        if not is_plain(text) or not abs(float(text)) < math.inf:
            raise ValueError
    except ValueError as error:
        raise typer.BadParameter(f"{text!r}, expected seconds or auto", param_hint="--offset") from error
    return float(text)


def _deltas(text: str) -> list[str]:
    from ..vision.evaluate import parse_delta

    deltas = list(dict.fromkeys(part.strip() for part in text.split(","))) if text else []
    for delta in deltas:
        try:
            parse_delta(delta)
        except InputError as error:
            raise typer.BadParameter(str(error), param_hint="--delta") from error
    return deltas
