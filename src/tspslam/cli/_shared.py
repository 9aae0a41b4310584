"""What the commands share: the parser they hang on, options, exit codes, checks of what was typed."""

from __future__ import annotations

import contextlib
import json
import shlex
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..printing import note, remarks_as_json, say

if TYPE_CHECKING:
    from ..run.pipeline import RunResult

_STAGES = 3  # of a run that its time is told of: more do not fit the line
COMPLETE, INTERNAL, USAGE, BAD_INPUT, DEGRADED, NOT_WRITTEN, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130

app = typer.Typer(
    help="Topological signal processing on what a stereo camera sees.",
    no_args_is_help=True, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False,
)  # fmt: skip

SetOption = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one setting.")]
PresetOption = Annotated[str, typer.Option(help="Where settings start: default, or paper.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="YAML file of settings.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="Run folder [default: runs/NAME].")]
SizeOption = Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images, where the file has none.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite a file of another kind; never an input.")]
TopicsOption = Annotated[
    tuple[str, str] | None, typer.Option(metavar="LEFT RIGHT", help="Topics of a bag with the images.")
]
LayoutOption = Annotated[
    str | None, typer.Option(help="Both images in one video: side-by-side, over-under or alternate.")
]
CameraOption = Annotated[
    list[str] | None, typer.Option(help="A live camera, by number or device; twice for a left and a right one.")
]
FpsOption = Annotated[
    float | None, typer.Option("--fps", min=0.01, help="Frames a second, where names and files tell no times.")
]
BitsOption = Annotated[int | None, typer.Option(min=1, max=16, help="Bits that 16-bit pixels use [default: found].")]
ThreadsOption = Annotated[int | None, typer.Option(min=1, max=1024, help="Threads at a time [default: one a core].")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


def check_suffix(path: Path, allowed: list[str], option: str) -> None:
    """Refuse a file to write whose suffix is none of those allowed."""
    if path.suffix.lower()[1:] not in allowed:
        expected = " or ".join(f".{each}" for each in allowed)
        raise typer.BadParameter(
            f"{str(path)!r} has the suffix {path.suffix!r}, expected {expected}", param_hint=option
        )


def check_folder(out: Path, *inputs: Path | None) -> None:
    """Refuse a run folder that is an input, or holds one."""
    from ..run import guard

    guard.check_folder(out, [path for path in inputs if path])


def announce_compilation(*, is_sequence: bool = False) -> None:
    """Say that kernels are being compiled, if they are; a sequence has some for its path and its map."""
    from ..run._compiling import are_compiled

    if not are_compiled(is_sequence=is_sequence):
        note("compiling kernels (once on this machine, up to a minute) ...")


def finish(result: RunResult, as_json: bool) -> None:
    """Say what a run folder holds, and end with the code of a degraded run if it is one."""
    with remarks_as_json() if as_json else contextlib.nullcontext():
        note(*(f"warning: {warning['message']}" for warning in result.run["warnings"]))
    if as_json:
        say(json.dumps(result.run | {"folder": str(result.folder)}, sort_keys=True))
    else:
        say(*tabulate_run(result.run, result.times), "", *_where_to_look(result.folder, result.run))
    if result.is_degraded:
        raise typer.Exit(DEGRADED)


def tabulate_run(run: dict[str, Any], times: dict[str, Any]) -> list[str]:
    """Lines, none wider than 80 columns, for what a run found and how long it took."""
    sizes = run["complex"]
    rows = {
        "complex": f"{sizes['n']} vertices, {sizes['edges']} edges, {sizes['faces']} faces",
        "response": f"at {run['defined']} vertices",
    }
    if "per_frame" in run:  # a run of pairs, not of a mesh
        lost = sum(row["is_lost"] for row in run["per_frame"])
        skipped = run["frames"] - len(run["per_frame"])
        rows = {
            "frames": f"{run['tracked']} tracked, {lost} lost, {skipped} skipped",
            "keyframes": f"{run['keyframes']}, loops closed: {run['loops']}",
            "landmarks": str(run["landmarks"]),
        } | rows
    if "evaluation" in run:
        measured = run["evaluation"]
        rows["error"] = f"{measured['ate_rmse_m']:.3g} m (ATE, {measured['matched']} of {measured['total']} poses)"
    if times:
        rows |= {"time": _say_times(times, run["frames"]), "spent on": _say_stages(times["stages_s"])}
    count = f"{run['frames']} frame{'s' if run['frames'] > 1 else ''} of " if times else ""
    recordings = [line for one in run.get("recordings", ()) for line in _say_recording(one)]
    lines = [f"  {name:<9}  {said}" for name, said in rows.items()]
    return [f"{run['status']}: {count}{run['source']}", *recordings, *lines]


def _say_recording(one: dict[str, Any]) -> list[str]:
    """Lines on one recording of a run of several: where its frames begin, how many are tracked, what joined it."""
    said = f"{one['name']}: from frame {one['first']} on, {one['tracked']} of {one['frames']} tracked"
    if one["first"] and not one["joined_by"]:
        said += ", joined to none"
    elif one["first"]:
        by, loops = one["joined_by"], one["loops_to_others"]
        said += f", joined to {by['recording']} at frame {by['frame']}"
        said += f" by {by['landmarks']} landmarks" + (f" and {loops} loop{'s' if loops > 1 else ''}" if loops else "")
    return textwrap.wrap(said, 80, initial_indent="  recording  ", subsequent_indent=13 * " ")


def _say_times(times: dict[str, Any], frames: int) -> str:
    """Words for how long a run took; frames that an earlier one has left count for nothing."""
    anew, rate = times["frames_anew"], times["frames_per_s"]
    said = f"{times['total_s']:.1f} s"
    if anew < frames:
        said += f", {anew or 'none'} of the frames anew"
    return f"{said}, {rate:.3g} frames/s" if rate else said


def _say_stages(seconds: dict[str, float]) -> str:
    """Words for the stages that took longest, the first the longest, and what is left."""
    stages = sorted(seconds.items(), key=lambda each: -each[1])
    said = [f"{stage} {spent:.1f} s" for stage, spent in stages[:_STAGES]]
    rest = sum(spent for _, spent in stages[_STAGES:])
    return ", ".join([*said, f"others {rest:.1f} s"] if len(stages) > _STAGES else said)


def _where_to_look(folder: Path, run: dict[str, Any]) -> list[str]:
    """Lines with the files that a run has left, and the commands that go on from it."""
    name = shlex.quote(str(folder))
    is_unmeasured = run["frames"] > 2 and "evaluation" not in run  # it takes three poses
    truths = " --truth POSES" * max(1, len(run.get("recordings", ())))
    return [
        f"pictures: {folder / 'pictures'}",
        f"report:   {folder / 'report.html'}",
        f"map:      {folder / 'map.vtu'}",
        "",
        f"look:     tspslam view {name}",
        *([f"measure:  tspslam eval {name}{truths}"] if is_unmeasured else []),
        f"hand on:  tspslam report {name}",
        f"          tspslam export {name} --to glb",
    ]
