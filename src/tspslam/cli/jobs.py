"""The main job, and the topology wing alone: ``tspslam run`` and ``filter``."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..errors import InputError
from ..printing import note, remarks_as_json
from ._filter_store import Options, filter_a_store, refuse_options
from ._live import until_interrupt
from ._progress import progress
from ._shared import (
    BitsOption,
    CameraOption,
    ConfigOption,
    FpsOption,
    JsonOption,
    LayoutOption,
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
from ._sources import Given, open_source

if TYPE_CHECKING:
    from ..datasets.joined import Source


@app.command("run")
def run_command(
    source: Annotated[
        list[Path] | None,
        typer.Argument(
            help="LEFT RIGHT images, folders or videos; or folders, bags or videos of one or more recordings."
        ),
    ] = None,
    calib: Annotated[Path | None, typer.Option(help="Calibration file [default: the folder's own].")] = None,
    topics: TopicsOption = None,
    layout: LayoutOption = None,
    fps: FpsOption = None,
    camera: CameraOption = None,
    depth: Annotated[Path | None, typer.Option(help="Depth map of a single image (PNG, TIFF, PFM, .npy).")] = None,
    disparity: Annotated[Path | None, typer.Option(help="Disparity map of a single image.")] = None,
    unit: Annotated[float | None, typer.Option(help="Metres, or px, in one step of depths: 0.001 for mm.")] = None,
    sensor: Annotated[
        str | None, typer.Option(help="Of depths in a folder or bag: structured_light, time_of_flight, stereo.")
    ] = None,
    unknown: Annotated[
        float | None, typer.Option(help="Value in the map that is not known [default: found; nan for none].")
    ] = None,
    bits: BitsOption = None,
    out: OutOption = None,
    into: Annotated[Path | None, typer.Option(help="A finished run to go on with: SOURCE comes into its map.")] = None,
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Which frames of a folder.")] = None,
    detector: Annotated[str | None, typer.Option(help="Keypoint detector: orb, sift, brisk, grid, onnx.")] = None,
    preset: PresetOption = "default",
    config: ConfigOption = None,
    assignments: SetOption = None,
    threads: ThreadsOption = None,
    fix_offset: Annotated[
        bool, typer.Option("--fix-offset", help="Take an offset of all disparities off points and responses too.")
    ] = False,
    view: Annotated[bool, typer.Option("--view", help="Show it in the browser while it goes on.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Run the main job: stereo pairs to points, complex, signals and response. No SOURCE: the real Motorcycle pair."""
    from .._threads import set_threads
    from ..run import config as configuration
    from ..run import pipeline
    from ..run._compiling import compiling
    from ..run.continuing import excerpts, run_into
    from ..run.viewing import viewing
    from ..settings import KINDS

    if detector not in (None, *KINDS["detector"]):
        expected = ", ".join(KINDS["detector"])
        raise typer.BadParameter(f"{detector!r}, expected one of {expected}", param_hint="--detector")
    chosen = [f"detector.kind={detector}"] if detector else []
    chosen += ["mapping.fix_offset=true"] if fix_offset else []
    resolved = configuration.resolve(preset, config, [*chosen, *(assignments or [])])
    given = Given(
        source or [], calib, camera, depth, disparity, unit, unknown, sensor, topics, layout, fps, bits, frames, out,
        into,
    )  # fmt: skip
    if into:
        given.refuse("out")
    with contextlib.ExitStack() as stack:
        on_step = stack.enter_context(progress(as_json))
        pairs = open_source(given, on_step)
        wanted = range(0) if camera else _frame_range(frames, len(pairs))
        target = into or out or Path("runs") / pairs.name
        check_folder(target, *(source or []), calib, depth, disparity)
        set_threads(threads)
        with viewing(target if view else None) as viewer:
            with until_interrupt(pairs):
                announce_compilation(is_sequence=len(wanted) != 1)
                chosen_frames = wanted if frames else None
                with compiling(is_sequence=len(wanted) != 1):
                    if into:
                        added = excerpts(pairs, chosen_frames)
                        result = run_into(into, added, resolved, on_frame=viewer, on_step=on_step)
                    else:
                        result = pipeline.run(
                            pairs, target, resolved, frames=chosen_frames, on_frame=viewer, on_step=on_step
                        )
            stack.close()  # the line of progress ends before the results
            try:
                _say_remarks(pairs, as_json)
                finish(result, as_json)
            finally:
                viewer.stay()


@app.command("filter")
def filter_command(
    mesh: Annotated[
        Path | None,
        typer.Argument(
            help="Mesh (PLY, OBJ, OFF, STL, VTU, glTF), in the camera's frame, metres; or a store (tspslam store).",
            show_default=False,
        ),
    ] = None,
    *,
    cloud: Annotated[Path | None, typer.Option(help="Scan of a LiDAR instead of a mesh: .bin, .pcd, .las, ...")] = None,
    extrinsics: Annotated[
        Path | None, typer.Option(help="Where the scanner stands: KITTI's calib.txt, T_camera_scan, a 4 x 4 matrix.")
    ] = None,
    surface: Annotated[str, typer.Option(help="Surface of a scan: range, or crust.")] = "range",
    image: Annotated[Path | None, typer.Option(help="Image that the camera took.")] = None,
    calib: Annotated[Path | None, typer.Option(help="Calibration file.")] = None,
    bits: BitsOption = None,
    out: OutOption = None,
    order: Annotated[int, typer.Option(help="Angular order m.")] = 1,
    centering: Annotated[str | None, typer.Option(help="none, mean, harmonic or plane.")] = None,
    merge: Annotated[bool, typer.Option("--merge-corners", help="Make one vertex of those at the same place.")] = False,
    polygons: Annotated[str, typer.Option(help="Faces of over three corners: fan (of triangles), or cells.")] = "fan",
    images: Annotated[Path | None, typer.Option(help="Of a store: the folder that its images lie in now.")] = None,
    workers: Annotated[int, typer.Option(help="Of a store: processes of Dask [default: this one alone].")] = 0,
    scheduler: Annotated[str | None, typer.Option(help="Of a store: a scheduler of Dask, by address.")] = None,
    memory: Annotated[str, typer.Option(help="Of a store: what a process may take.")] = "1.5 GB",
    occlusion: Annotated[
        float | None,
        typer.Option(help="Of a store: no signal farther behind the nearest face than this share of the depth."),
    ] = None,
    to: Annotated[
        str | None, typer.Option(help="Of a store: also a file a tile, vtu, ply or 3dtiles, into --out.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Of a store: replace an earlier export in --out.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Filter the signals of a posed image on your own mesh or LiDAR scan (the topology wing alone)."""
    from ..run.mesh import filter_mesh
    from ..run.pipeline import Step
    from ..run.scan import filter_scan
    from ..topology.harmonic import Tmahf

    if mesh is not None and cloud is None and mesh.is_dir():
        refuse_options(
            image=image, calib=calib, extrinsics=extrinsics, bits=bits, merge_corners=merge or None,
            surface=surface if surface != "range" else None, polygons=polygons if polygons != "fan" else None,
        )  # fmt: skip
        options = Options(order, centering, occlusion, workers, scheduler, memory)
        filter_a_store(mesh, options, images=images, out=out, to=to, is_forced=force, as_json=as_json)
        return
    refuse_options(
        images=images, workers=workers or None, scheduler=scheduler, to=to, occlusion=occlusion, force=force or None,
        what="a store",
    )  # fmt: skip
    given = _one_of(mesh, cloud, extrinsics, surface, merge, polygons)
    image, calib = _posed(mesh, image, calib)
    stage = Tmahf(order, centering)  # type: ignore[arg-type]
    parts = ["-merged"] * merge + [f"-{polygons}"] * (polygons != "fan")
    target = out or Path("runs") / f"{given.stem}-filter{''.join(parts)}"
    check_folder(target, given, image, calib, extrinsics)
    with progress(as_json) as on_step:
        announce_compilation()
        on_step(Step("filter"))
        if mesh is not None:
            result = filter_mesh(mesh, image, calib, target, stage, merge=merge, polygons=polygons, bits=bits)
        else:
            kind: Any = surface
            result = filter_scan(given, image, calib, target, stage, extrinsics=extrinsics, surface=kind, bits=bits)
    finish(result, as_json)


def _say_remarks(pairs: Source, as_json: bool) -> None:
    """Say where stamps are from, and how images were paired, if their reader tells."""
    with remarks_as_json() if as_json else contextlib.nullcontext():
        note(*(f"note: {remark}" for remark in getattr(pairs, "remarks", ())))


def _one_of(
    mesh: Path | None, cloud: Path | None, extrinsics: Path | None, surface: str, merge: bool, polygons: str
) -> Path:
    """What is filtered, after the options have been found to go together."""
    if surface not in ("range", "crust"):
        raise typer.BadParameter(f"{surface!r}, expected range or crust", param_hint="--surface")
    if polygons not in ("fan", "cells"):
        raise typer.BadParameter(f"{polygons!r}, expected fan or cells", param_hint="--polygons")
    if cloud is None:
        if extrinsics is not None or surface != "range":
            raise typer.BadParameter("goes with --cloud", param_hint="--extrinsics" if extrinsics else "--surface")
    elif merge or polygons != "fan":
        raise typer.BadParameter("goes with a mesh", param_hint="--merge-corners" if merge else "--polygons")
    given = mesh if cloud is None else cloud
    if given is None or (mesh is not None and cloud is not None):
        raise typer.BadParameter("expected a MESH or --cloud, one of both", param_hint="MESH")
    return given


def _posed(mesh: Path | None, image: Path | None, calib: Path | None) -> tuple[Path, Path]:
    """The image and the calibration that go with what is in memory, if the mesh is there."""
    from .._files import bad_input

    if mesh is not None and not os.path.lexists(mesh):
        raise bad_input(mesh, "is not there", "a mesh, or a store: tspslam store makes one")
    if image is None or calib is None:
        raise typer.BadParameter("goes with a mesh or a scan", param_hint="--image" if image is None else "--calib")
    return image, calib


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
