"""The main job, and the topology wing alone: ``tspslam run`` and ``filter``."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ..errors import InputError
from ..printing import note, remarks_as_json
from ._progress import progress
from ._shared import (
    BitsOption,
    ConfigOption,
    FpsOption,
    JsonOption,
    OutOption,
    PresetOption,
    SetOption,
    ThreadsOption,
    TopicsOption,
    announce_compilation,
    app,
    check_folder,
    finish,
)  # fmt: skip

if TYPE_CHECKING:
    from ..run.pipeline import Source


@app.command("run")
def run_command(
    source: Annotated[
        list[Path] | None, typer.Argument(help="LEFT RIGHT images or folders, or a folder or bag of a sequence.")
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
    fps: FpsOption = None,
    out: OutOption = None,
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Which frames of a folder.")] = None,
    detector: Annotated[str | None, typer.Option(help="Keypoint detector: orb, sift, brisk, grid, onnx.")] = None,
    preset: PresetOption = "default",
    config: ConfigOption = None,
    assignments: SetOption = None,
    threads: ThreadsOption = None,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser while it goes on.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the main job: stereo pairs to points, complex, signals and response. No SOURCE: the real Motorcycle pair."""
    from .._threads import set_threads
    from ..run import config as configuration
    from ..run import pipeline
    from ..run.viewing import viewing
    from ..settings import KINDS

    if detector not in (None, *KINDS["detector"]):
        expected = ", ".join(KINDS["detector"])
        raise typer.BadParameter(f"{detector!r}, expected one of {expected}", param_hint="--detector")
    chosen = [f"detector.kind={detector}"] if detector else []
    resolved = configuration.resolve(preset, config, [*chosen, *(assignments or [])])
    if topics and (depth or disparity or not source):
        raise typer.BadParameter("goes with a bag alone", param_hint="--topics")
    if fps is not None and (depth or disparity or not source):
        raise typer.BadParameter("goes with a folder of images", param_hint="--fps")
    if depth or disparity:
        pairs = _open_map(source or [], calib, depth, disparity, {"unit": unit, "unknown": unknown, "bits": bits})
    elif unit is not None or unknown is not None:
        hint = "--unknown" if unit is None else "--unit"
        raise typer.BadParameter("goes with --depth or --disparity", param_hint=hint)
    else:
        pairs = _open_source(source or [], calib, topics, bits, fps)
    wanted = _frame_range(frames, len(pairs))
    target = out or Path("runs") / pairs.name
    check_folder(target, *(source or []), calib, depth, disparity)
    set_threads(threads)
    with viewing(target if view else None) as viewer:
        with progress(as_json) as on_step:
            announce_compilation(is_sequence=len(wanted) > 1)
            chosen_frames = wanted if frames else None
            result = pipeline.run(pairs, target, resolved, frames=chosen_frames, on_frame=viewer, on_step=on_step)
        try:
            _say_remarks(pairs, as_json)
            finish(result, as_json)
        finally:
            viewer.stay()


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
    from ..run.mesh import filter_mesh
    from ..run.pipeline import Step
    from ..topology.harmonic import Tmahf

    stage = Tmahf(order, centering)  # type: ignore[arg-type]
    target = out or Path("runs") / f"{mesh.stem}-filter{'-merged' if merge else ''}"
    check_folder(target, mesh, image, calib)
    with progress(as_json) as on_step:
        announce_compilation()
        on_step(Step("filter"))
        result = filter_mesh(mesh, image, calib, target, stage, merge=merge, bits=bits)
    finish(result, as_json)


def _say_remarks(pairs: Source, as_json: bool) -> None:
    """Say where stamps are from, and how images were paired, if their reader tells."""
    with remarks_as_json() if as_json else contextlib.nullcontext():
        note(*(f"note: {remark}" for remark in getattr(pairs, "remarks", ())))


def _open_source(
    paths: list[Path], calib: Path | None, topics: tuple[str, str] | None, bits: int | None, fps: float | None
) -> Source:
    from .. import datasets
    from ..datasets.layouts import are_parts
    from ..run.pipeline import OnePair

    if are_parts(paths):
        return datasets.open_sequence(paths, calib=calib, topics=topics, bits=bits, fps=fps)
    if len(paths) == 2:
        if topics or fps is not None:
            hint = "--topics" if topics else "--fps"
            raise typer.BadParameter("does not go with a pair of images", param_hint=hint)
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
        said = f"{len(paths)} paths, expected a pair of images or of folders, one folder, or files of one bag"
        raise typer.BadParameter(said, param_hint="SOURCE")
    return datasets.open_sequence(paths[0], calib=calib, topics=topics, bits=bits, fps=fps)


def _open_map(
    paths: list[Path], calib: Path | None, depth: Path | None, disparity: Path | None, said: dict[str, Any]
) -> Source:
    from .. import datasets
    from ..run.pipeline import OnePair

    kinds: tuple[tuple[Literal["depth", "disparity"], Path | None], ...] = (("depth", depth), ("disparity", disparity))
    maps = [(kind, path) for kind, path in kinds if path]
    if len(paths) != 1 or calib is None or len(maps) != 1:
        wanted = "one image, --calib, and either --depth or --disparity"
        raise typer.BadParameter(f"a map goes with {wanted}", param_hint="--depth/--disparity")
    kind, path = maps[0]
    return OnePair(datasets.pair_from_map(paths[0], path, calib, kind=kind, **said))


def _frame_range(text: str | None, count: int) -> range:
    from .._text import is_plain

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
