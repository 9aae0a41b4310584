"""What a person types: a thin parser around functions. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import contextlib
import errno
import io
import json
import os
import re
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from . import __version__
from .errors import InputError, OutputError, TspSlamError
from .printing import hold_streams, listen
from .printing import note as _note
from .printing import progress as _progress
from .printing import say as _say

if TYPE_CHECKING:
    from .run.pipeline import RunResult, Source

COMPLETE, INTERNAL, USAGE, BAD_INPUT, DEGRADED, NOT_WRITTEN, INTERRUPTED = 0, 1, 2, 3, 4, 5, 130

_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS}  # also met by compiled kernels on their way to disk
_UsageError = typer.BadParameter.__mro__[1]  # click's, wherever this version of typer keeps it

app = typer.Typer(
    help="Topological signal processing on what a stereo camera sees.",
    no_args_is_help=True, add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False,
)  # fmt: skip
config_app = typer.Typer(help="Settings.", no_args_is_help=True)
app.add_typer(config_app, name="config")
calib_app = typer.Typer(help="Calibration files.", no_args_is_help=True)
app.add_typer(calib_app, name="calib")

SetOption = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one setting.")]
PresetOption = Annotated[str, typer.Option(help="Where settings start: default, or paper.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="YAML file of settings.")]
OutOption = Annotated[Path | None, typer.Option("--out", help="Run folder [default: runs/NAME].")]
SizeOption = Annotated[str | None, typer.Option(metavar="WxH", help="Size of the images, where the file has none.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Overwrite a file of another kind; never an input.")]
TopicsOption = Annotated[
    tuple[str, str] | None, typer.Option(metavar="LEFT RIGHT", help="Topics of a bag with the images.")
]
BitsOption = Annotated[int | None, typer.Option(min=1, max=16, help="Bits that 16-bit pixels use [default: found].")]
ThreadsOption = Annotated[int | None, typer.Option(min=1, max=1024, help="Threads at a time [default: one a core].")]
JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@app.command("run")
def run_command(
    source: Annotated[
        list[Path] | None, typer.Argument(help="LEFT RIGHT images, or a folder or bag of a sequence.")
    ] = None,
    calib: Annotated[Path | None, typer.Option(help="Calibration file [default: the folder's own].")] = None,
    topics: TopicsOption = None,
    depth: Annotated[Path | None, typer.Option(help="Depth map of a single image (PNG, TIFF, PFM, .npy).")] = None,
    disparity: Annotated[Path | None, typer.Option(help="Disparity map of a single image.")] = None,
    unit: Annotated[float | None, typer.Option(help="Metres, or px, in one step of the map: 0.001 for mm.")] = None,
    unknown: Annotated[
        float | None, typer.Option(help="Value in the map that is not known [default: found; nan for none].")
    ] = None,
    bits: BitsOption = None,
    out: OutOption = None,
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Which frames of a folder.")] = None,
    detector: Annotated[str | None, typer.Option(help="Keypoint detector: orb, sift, brisk, grid, onnx.")] = None,
    preset: PresetOption = "default",
    config: ConfigOption = None,
    assignments: SetOption = None,
    threads: ThreadsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Run the main job: stereo pairs to points, complex, signals and response. No SOURCE: the real Motorcycle pair."""
    from ._threads import set_threads
    from .run import config as configuration
    from .run import pipeline
    from .settings import KINDS

    if detector not in (None, *KINDS["detector"]):
        expected = ", ".join(KINDS["detector"])
        raise typer.BadParameter(f"{detector!r}, expected one of {expected}", param_hint="--detector")
    chosen = [f"detector.kind={detector}"] if detector else []
    resolved = configuration.resolve(preset, config, [*chosen, *(assignments or [])])
    if topics and (depth or disparity or len(source or []) != 1):
        raise typer.BadParameter("goes with a bag alone", param_hint="--topics")
    if depth or disparity:
        pairs = _open_map(source or [], calib, depth, disparity, {"unit": unit, "unknown": unknown, "bits": bits})
    elif unit is not None or unknown is not None:
        hint = "--unknown" if unit is None else "--unit"
        raise typer.BadParameter("goes with --depth or --disparity", param_hint=hint)
    else:
        pairs = _open_source(source or [], calib, topics, bits)
    wanted = _frame_range(frames, len(pairs))
    target = out or Path("runs") / pairs.name
    _check_folder(target, *(source or []), calib, depth, disparity)
    _announce_compilation()
    set_threads(threads)
    with _progress(len(wanted)) as progress:
        result = pipeline.run(pairs, target, resolved, frames=wanted if frames else None, progress=progress)
    _finish(result, as_json)


@app.command("filter")
def filter_command(
    mesh: Annotated[Path, typer.Argument(help="PLY, OBJ or VTU mesh, in the camera's frame, metres.")],
    image: Annotated[Path, typer.Option(help="Image that the camera took.")],
    calib: Annotated[Path, typer.Option(help="Calibration file.")],
    bits: BitsOption = None,
    out: OutOption = None,
    order: Annotated[int, typer.Option(help="Angular order m.")] = 1,
    centering: Annotated[str | None, typer.Option(help="none, mean, harmonic or plane.")] = None,
    merge: Annotated[bool, typer.Option("--merge-corners", help="Make one vertex of those at the same place.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Filter the signals of a posed image on your own mesh (the topology wing alone)."""
    from .run.mesh import filter_mesh
    from .topology.harmonic import Tmahf

    stage = Tmahf(order, centering)  # type: ignore[arg-type]
    target = out or Path("runs") / f"{mesh.stem}-filter{'-merged' if merge else ''}"
    _check_folder(target, mesh, image, calib)
    _announce_compilation()
    _finish(filter_mesh(mesh, image, calib, target, stage, merge=merge, bits=bits), as_json)


@app.command("export")
def export_command(
    run: Annotated[Path, typer.Argument(help="A run folder.")],
    to: Annotated[str, typer.Option("--to", help="vtu, ply or npz.")] = "vtu",
    frame: Annotated[int | None, typer.Option(min=0, help="Index of a keyframe [default: the map].")] = None,
    output: Annotated[Path | None, typer.Option(help="File [default: RUN-map or -FRAME.FORMAT here].")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write the map of a finished run, or one of its frames, in another format, without running again."""
    from .run.export import FORMATS, export

    if to not in FORMATS:
        raise typer.BadParameter(f"{to!r}, expected one of {', '.join(FORMATS)}", param_hint="--to")
    _check_suffix(output or Path(f"map.{to}"), [to], "--output")
    target = export(run, to, output, frame=frame, is_forced=force)
    _say(json.dumps({"written": str(target)}) if as_json else f"wrote {target}")


@app.command("map")
def map_command(
    run: Annotated[Path, typer.Argument(help="A run folder.")],
    output: Annotated[Path | None, typer.Option(help="File: .npz, .vtu or .ply [default: RUN-map.npz].")] = None,
    assignments: SetOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Make the map of a finished run anew, with other settings of it, such as --set mapping.surface.longest=0.3."""
    from .run.export import FORMATS, export_map_anew

    _check_suffix(output or Path("map.npz"), list(FORMATS), "--output")
    made = export_map_anew(run, output, assignments or (), is_forced=force)
    said = ", ".join(f"{count} {name}" for name, count in made.items() if name != "written")
    _say(json.dumps(made) if as_json else f"wrote {made['written']}: {said}")


@app.command("eval")
def eval_command(
    run: Annotated[Path, typer.Argument(help="A run folder, or a trajectory file (TUM, KITTI).")],
    truth: Annotated[Path, typer.Option(help="True poses: a file (TUM, KITTI) or a sequence folder that has them.")],
    max_difference: Annotated[float, typer.Option(min=0, help="Between two matched stamps, s.")] = 0.01,
    plot: Annotated[Path | None, typer.Option(help="PNG, PDF or SVG of both paths and the error along them.")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Measure a camera path against the true one: ATE after alignment, RPE a frame and over 10 m."""
    from .run.evaluate import describe_errors, evaluated, tabulate

    if plot:
        from .run.guard import PICTURES, check_output

        _check_suffix(plot, list(PICTURES), "--plot")
        check_output(plot, PICTURES[plot.suffix.lower()[1:]], [run, truth], is_forced=force)
    errors = evaluated(run, truth, max_stamp_difference=max_difference)
    if plot:
        from .view import write_path_picture

        write_path_picture(errors, plot)
    for line in errors.warnings:
        _note(f"warning: {line}")
    _say(*([json.dumps(describe_errors(errors))] if as_json else tabulate(errors)))
    if plot and not as_json:
        _say(f"wrote {plot}")


@config_app.command("show")
def config_show_command(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME", help="Of these settings, or stages, all that is known.")
    ] = None,
    preset: PresetOption = "default",
    config: ConfigOption = None,
    assignments: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show every setting: its value, unit and range, and where the value came from."""
    from .run import config as configuration

    rows = configuration.describe(configuration.resolve(preset, config, assignments or []), names or [])
    _say(*([json.dumps(rows, sort_keys=True)] if as_json else configuration.tabulate(rows, has_notes=bool(names))))


@calib_app.command("show")
def calib_show_command(
    file: Annotated[Path, typer.Argument(help="Calibration of ours, KITTI, EuRoC, OpenCV, Kalibr or ORB-SLAM.")],
    size: SizeOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what was understood of a calibration file: every value, and the key of the file that it came from."""
    from .vision.calibration.show import described, unit_of

    found = described(file, _size(size))
    if as_json:
        _say(json.dumps(found, sort_keys=True))
        return
    _say(f"{file}: {found['format']}, {found['kind']}")
    width = max(map(len, found["values"]))
    for name, row in found["values"].items():
        lines = row["value"] if isinstance(row["value"], list) else [row["value"]]
        for line in lines:
            shown = "  ".join(f"{number:.9g}" for number in line) if isinstance(line, list) else str(line)
            _say(f"{name:<{width}}  {f'{shown} {unit_of(name)}':<22}  {row['origin']}")
    for remark in found["remarks"]:
        _say(f"note: {remark}")


@calib_app.command("convert")
def calib_convert_command(
    file: Annotated[Path, typer.Argument(help="Calibration of any kind that `calib show` understands.")],
    output: Annotated[Path, typer.Argument(help="File to write, in our format.")],
    size: SizeOption = None,
    rectify: Annotated[bool, typer.Option("--rectify", help="Of raw cameras: the rectified pair.")] = False,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a calibration file of another program in our format."""
    from .run.guard import CALIBRATION, check_output
    from .vision.calibration.show import converted

    check_output(output, CALIBRATION, [file], is_forced=force)
    remarks = converted(file, output, _size(size), rectify)
    for remark in remarks:
        _note(f"note: {remark}")
    _say(json.dumps({"written": str(output), "remarks": remarks}) if as_json else f"wrote {output}")


def _check_suffix(path: Path, allowed: list[str], option: str) -> None:
    if path.suffix.lower()[1:] not in allowed:
        expected = " or ".join(f".{each}" for each in allowed)
        raise typer.BadParameter(
            f"{str(path)!r} has the suffix {path.suffix!r}, expected {expected}", param_hint=option
        )


def _check_folder(out: Path, *inputs: Path | None) -> None:
    from .run.guard import check_folder

    check_folder(out, [path for path in inputs if path])


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, x, height = text.lower().partition("x")
    if not (x and text.isascii() and width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise typer.BadParameter(f"{text!r}, expected WIDTHxHEIGHT in px, such as 1242x375", param_hint="--size")
    return int(width), int(height)


@app.callback(invoke_without_command=True)
def root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Print the version, if asked; `main` reads --debug itself."""
    if version:
        _say(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; every error becomes one line and its exit code."""
    hold_streams()
    listen()
    os.environ["MPLBACKEND"] = "agg"  # no window is opened; a name that Matplotlib no longer knows would end the run
    code = _exit_code(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is said and written
    sys.exit(code)


def _exit_code(arguments: list[str]) -> int:
    try:
        code = _run(arguments)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        if not _is_interrupt(error):
            if "--debug" in arguments:
                raise
            return _complain(_line(error), _code_of(error))
        code = INTERRUPTED
    if code == INTERRUPTED:
        return _complain("interrupted; the same command goes on where this one stopped", INTERRUPTED)
    return code


def _run(arguments: list[str]) -> int:
    words = [word for word in arguments if word != "--debug"]
    _refuse_empty(words)
    _say()  # nothing, but a closed stdout is seen before the work
    page = io.StringIO()  # help, which click prints: as all else, it goes through `_say`
    is_page = "--help" in words or set(words) <= {"config", "calib"}
    try:
        with contextlib.redirect_stdout(page) if is_page else contextlib.nullcontext():
            outcome = typer.main.get_command(app).main(words, prog_name="tspslam", standalone_mode=False)
    except typer.Exit as stop:
        outcome = stop.exit_code
    _say(*page.getvalue().splitlines())
    return outcome if isinstance(outcome, int) else COMPLETE


def _refuse_empty(words: list[str]) -> None:
    """Refuse empty words, as a shell's unset variables give: as paths they would be the folder one is in."""
    for before, word in zip(["tspslam", *words], words, strict=False):
        if not word or re.fullmatch("--[a-z-]+=", word):
            raise typer.BadParameter(f"nothing follows {word or before}; is a variable of the shell unset?")


def _code_of(error: Exception) -> int:
    if isinstance(error, _UsageError):
        return USAGE
    if isinstance(error, OutputError) or (isinstance(error, OSError) and error.errno in _NO_ROOM):
        return NOT_WRITTEN
    return BAD_INPUT if isinstance(error, InputError) else INTERNAL


def _line(error: Exception) -> str:
    if isinstance(error, _UsageError):
        said: str = error.format_message()  # type: ignore[attr-defined]
        return said if said.startswith("Usage:") else f"{' '.join(said.split())} (see tspslam --help)"
    text = " ".join(str(error).split())
    if isinstance(error, TspSlamError):
        return text
    if isinstance(error, OSError) and _code_of(error) == NOT_WRITTEN:
        return f"{error.filename or 'output'}: cannot be written ({error.strerror}); expected a place with space"
    return f"internal error: {type(error).__name__}: {text} (--debug shows where)"


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt came while a compiled loop was entered or left: Python then calls it an error of its own."""
    while isinstance(error, SystemError):
        error = error.__cause__ or error.__context__
    return isinstance(error, KeyboardInterrupt)


def _complain(line: str, code: int) -> int:
    _note(*f"tspslam: {line}".split("\n"))
    return code


def _open_source(paths: list[Path], calib: Path | None, topics: tuple[str, str] | None, bits: int | None) -> Source:
    from . import datasets
    from .run.pipeline import OnePair

    if len(paths) == 2:
        if calib is None:
            raise typer.BadParameter("a pair of files needs a calibration file", param_hint="--calib")
        return OnePair(datasets.read_pair(paths[0], paths[1], calib, bits=bits))
    if not paths and calib is not None:
        raise typer.BadParameter("goes with a pair of files or a folder", param_hint="--calib")
    if not paths and bits is not None:
        raise typer.BadParameter("goes with images", param_hint="--bits")
    if not paths:
        return OnePair(datasets.motorcycle())
    if len(paths) > 2:
        raise typer.BadParameter(f"{len(paths)} paths, expected a pair of images or one folder", param_hint="SOURCE")
    return datasets.open_sequence(paths[0], calib=calib, topics=topics, bits=bits)


def _open_map(
    paths: list[Path], calib: Path | None, depth: Path | None, disparity: Path | None, said: dict[str, Any]
) -> Source:
    from . import datasets
    from .run.pipeline import OnePair

    kinds: tuple[tuple[Literal["depth", "disparity"], Path | None], ...] = (("depth", depth), ("disparity", disparity))
    maps = [(kind, path) for kind, path in kinds if path]
    if len(paths) != 1 or calib is None or len(maps) != 1:
        wanted = "one image, --calib, and either --depth or --disparity"
        raise typer.BadParameter(f"a map goes with {wanted}", param_hint="--depth/--disparity")
    kind, path = maps[0]
    return OnePair(datasets.pair_from_map(paths[0], path, calib, kind=kind, **said))


def _frame_range(text: str | None, count: int) -> range:
    from ._text import is_plain

    if text is None:
        return range(count)
    first, colon, last = text.partition(":")
    try:
        if not is_plain(text):  # int takes 1_0 and other digits too
            raise ValueError
        chosen = range(count)[slice(int(first) if first else None, int(last) if last else None)]
    except ValueError:
        colon = ""
    if not colon:
        raise typer.BadParameter(f"{text!r}, expected A:B with integers", param_hint="--frames")
    if not chosen:
        raise InputError(f"--frames {text}: selects none of the {count} frames")
    return chosen


def _announce_compilation() -> None:
    from ._jit import is_cached
    from .topology._harmonics import filter_one_ring

    if not is_cached(filter_one_ring):
        _note("compiling kernels (once on this machine, up to a minute) ...")


def _finish(result: RunResult, as_json: bool) -> None:
    run, folder = result.run, result.folder
    for warning in run["warnings"]:
        _note(f"warning: {warning['message']}")
    if as_json:
        _say(json.dumps(run | {"folder": str(folder)}, sort_keys=True))
    else:
        sizes = run["complex"]
        _say(f"{run['status']}: {run['frames']} frame(s), {run.get('keyframes', 1)} keyframe(s); {sizes['n']} points, "
             f"{sizes['edges']} edges, {sizes['faces']} faces, {run['defined']} responses")  # fmt: skip
        _say(
            f"pictures: {folder / 'pictures'}", f"report:   {folder / 'report.html'}", f"map:      {folder / 'map.vtu'}"
        )
    if result.is_degraded:
        raise typer.Exit(DEGRADED)
