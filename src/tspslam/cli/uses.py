"""What a map is good for: ``tspslam denoise``, ``segment``, ``quality``, ``recognise`` and ``scans``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..printing import note, say
from ._shared import DEGRADED, BitsOption, ForceOption, JsonOption, app, check_suffix

if TYPE_CHECKING:
    from ..run.given import Given

SourceArgument = Annotated[
    Path, typer.Argument(help="Run folder, map or frame (.npz), or mesh (.vtu, .ply, .obj, ...).")
]
FrameOption = Annotated[int | None, typer.Option(min=0, help="Index of a keyframe of the run [default: the map].")]
ImageOption = Annotated[Path | None, typer.Option(help="Photo for a mesh in the camera's frame, m.")]
CalibOption = Annotated[Path | None, typer.Option(help="Calibration file of that photo.")]
OutputOption = Annotated[
    Path | None, typer.Option("--output", help="File: .vtu, .ply or .npz [default: SOURCE-USE.vtu here].")
]
RegionsOption = Annotated[
    Path | None, typer.Option("--output", help="File: .vtu or .ply [default: SOURCE-segmented.vtu here].")
]
NoiseOption = Annotated[
    float | None, typer.Option(help="Standard deviation of the luminance's noise, in [0, 1] [default: found].")
]
PlotOption = Annotated[Path | None, typer.Option(help="PNG picture as well.")]
ReportOption = Annotated[Path | None, typer.Option(help="HTML page as well, with the map to turn.")]
_MESHES = ["vtu", "ply"]


@app.command("denoise")
def denoise_command(
    source: SourceArgument,
    image: ImageOption = None,
    calib: CalibOption = None,
    bits: BitsOption = None,
    frame: FrameOption = None,
    noise: NoiseOption = None,
    only: Annotated[str | None, typer.Option(help="places, or signals [default: both].")] = None,
    output: OutputOption = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Take noise out of the places and the signals of a map, a frame or a mesh; no parameter is asked for."""
    from ..run.denoise import denoise, describe_change, has_three_levels, name_of_result
    from ..run.given import count_of, draw_use, write_shown

    if only not in (None, "places", "signals"):
        raise typer.BadParameter(f"{only!r}, expected places or signals", param_hint="--only")
    target = output or name_of_result(source)
    check_suffix(target, [*_MESHES, "npz"], "--output")
    given = _open(source, image, calib, bits, frame, plot, report)
    _check(given, target, plot, report, force)
    if only != "places" and given.signals.vertex_ok.any() and not has_three_levels(given):
        note("signals stand on vertices alone, with nothing to tell noise by: they are left as they are")
    after = denoise(given, places=only != "signals", signals=only != "places", noise=noise)
    sizes, change = count_of(given), describe_change(given, after)
    write_shown(after.shown, target, _kind(target), given.inputs, is_forced=force)
    numbers = [*sizes.items(), *((f"{which} move, m", f"{m:.3g}") for which, m in change["moved_m"].items())]
    numbers += [(f"change of {level} signals, rms", f"{value:.1g}") for level, value in change["changed"].items()]
    draw_use(given, plot, report, f"Denoised: {source.name}", numbers, after=after)
    _tell(sizes | change, _say_change(sizes, change), target, plot, report, as_json)


@app.command("segment")
def segment_command(
    source: SourceArgument,
    image: ImageOption = None,
    calib: CalibOption = None,
    bits: BitsOption = None,
    frame: FrameOption = None,
    scale: Annotated[float, typer.Option(help="Larger: fewer regions.")] = 1.0,
    output: RegionsOption = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find the regions of a map, a frame or a mesh by luminance, texture and shape; each face gets a label."""
    import numpy as np

    from ..run.given import count_of, draw_use, name_beside, write_shown
    from ..run.segment import columns_of, find_regions

    target = output or name_beside(source, "segmented", ".vtu")
    check_suffix(target, _MESHES, "--output")
    given = _open(source, image, calib, bits, frame, plot, report)
    _check(given, target, plot, report, force)
    labels = find_regions(given, scale)
    columns = columns_of(labels, target)
    write_shown(given.shown, target, _kind(target), given.inputs, face=columns, is_forced=force)
    sizes = np.bincount(labels)
    counts = count_of(given) | {"regions": len(sizes), "largest_faces": int(sizes.max()), "scale": scale}
    numbers = [(name.replace("_", " region, "), value) for name, value in counts.items()]
    draw_use(given, plot, report, f"Regions: {source.name}", numbers, labels=labels)
    words = f"{len(sizes)} regions of {len(labels)} faces at scale {scale:g}; the largest has {sizes.max()}"
    _tell(counts, words, target, plot, report, as_json)


@app.command("quality")
def quality_command(
    reference: Annotated[Path, typer.Argument(help="The original: run folder, .npz, .vtu or .ply with luminance.")],
    distorted: Annotated[Path, typer.Argument(help="What was made of it.")],
    as_json: JsonOption = False,
) -> None:
    """Score a distorted textured complex against its original, by places, signals and responses of all orders."""
    from ..run.given import open_given
    from ..run.quality import compare_given, describe_quality

    found = compare_given(open_given(reference), open_given(distorted))
    if as_json:
        say(json.dumps(describe_quality(found)))
        return
    width = max(map(len, (*found.parts, "score")))
    say(f"{'score':<{width}}  {found.score:.6g}", *(f"{name:<{width}}  {v:.6g}" for name, v in found.parts.items()))


@app.command("recognise")
def recognise_command(
    run: Annotated[Path, typer.Argument(help="A run folder.")],
    other: Annotated[Path | None, typer.Argument(help="Another run; default: the same, later and earlier.")] = None,
    apart: Annotated[int, typer.Option(min=1, help="Least keyframes from one to the other, in one run.")] = 10,
    most: Annotated[int, typer.Option(min=1, help="Pairs that are told, best first.")] = 20,
    as_json: JsonOption = False,
) -> None:
    """Find pairs of keyframes that show the same place, by the responses of their complexes."""
    from ..run.recognise import find_pairs

    pairs = find_pairs(run, other, apart=apart, most=most)
    if as_json:
        say(json.dumps([pair._asdict() for pair in pairs]))
        return
    if not pairs:
        note(f"no two keyframes are alike at all, of those that are {apart} or more apart")
        return
    say(f"{'frame':>8} {'other':>8}  alike", *(f"{pair.frame:>8} {pair.other:>8}  {pair.score:.3f}" for pair in pairs))


@app.command("scans")
def scans_command(
    run: Annotated[Path, typer.Argument(help="A run folder.")],
    scans: Annotated[list[Path], typer.Argument(help="Scans of a LiDAR taken along it: .bin, .pcd, .las, ...")],
    extrinsics: Annotated[Path, typer.Option(help="Where the scanner stands in the left camera's frame.")],
    stamps: Annotated[Path | None, typer.Option(help="Times of the scans, s [default: names are frames].")] = None,
    voxel: Annotated[float, typer.Option(help="Where an earlier scan is so near, m, a later one adds nothing.")] = 0.2,
    output: OutputOption = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Join scans along a run to one complex, with signals and responses from the keyframes that see it."""
    from ..run.given import name_beside, write_shown
    from ..run.guard import MAPS, check_place
    from ..run.scans import map_scans

    target = output or name_beside(run, "scans", ".vtu")
    check_suffix(target, [*_MESHES, "npz"], "--output")
    kind = "map" if _kind(target) == "npz" else _kind(target)
    inputs = [run, *scans, extrinsics, *([stamps] if stamps else [])]
    check_place(target, MAPS[kind], inputs, is_forced=force)
    found = map_scans(run, scans, extrinsics, stamps=stamps, voxel=voxel)
    lacking = "the run has no pose for it, of its frame or within 0.1 s on both sides of its time"
    note(*(f"warning: {each}: {lacking}" for each in found.unplaced))
    note(*(f"warning: {each}" for each in found.doubts))
    write_shown(found.map_, target, _kind(target), inputs, is_forced=force)
    map_, seen = found.map_, int(found.map_.signals.vertex_ok.sum())
    counts = {"scans": len(scans) - len(found.unplaced), "points": found.points, "vertices": len(map_)}
    counts |= {"edges": len(map_.complex_.edges), "faces": len(map_.complex_.faces), "seen": seen}
    words = ", ".join(f"{count} {name}" for name, count in counts.items())
    _tell(counts, words, target, None, None, as_json)
    if found.unplaced:
        raise typer.Exit(DEGRADED)


def _open(
    source: Path, image: Path | None, calib: Path | None, bits: int | None, frame: int | None,
    plot: Path | None, report: Path | None,
) -> Given:  # fmt: skip
    """Read the source, after the options have been found to go together."""
    from ..run.given import open_given

    if bits is not None and image is None:
        raise typer.BadParameter("goes with --image", param_hint="--bits")
    if (image is None) != (calib is None):
        raise typer.BadParameter("goes with --calib" if calib is None else "goes with --image", param_hint="--image")
    for path, suffix, option in ((plot, "png", "--plot"), (report, "html", "--report")):
        if path:
            check_suffix(path, [suffix], option)
    given = open_given(source, image, calib, frame=frame, bits=bits)
    if (plot or report) and not given.has_camera:
        which = "--plot" if plot else "--report"
        raise typer.BadParameter("goes with a run, a map or a frame, or a mesh with --image", param_hint=which)
    return given


def _check(given: Given, target: Path, plot: Path | None, report: Path | None, is_forced: bool) -> None:
    """Refuse places that cannot be written to, before the work."""
    from ..run.given import file_kind
    from ..run.guard import PAGE, PICTURES, check_place

    check_place(target, file_kind(given.shown, target, _kind(target)), given.inputs, is_forced=is_forced)
    for path, kind in ((plot, PICTURES["png"]), (report, PAGE)):
        if path:
            check_place(path, kind, given.inputs, is_forced=is_forced)


def _kind(path: Path) -> str:
    return path.suffix[1:].lower()


def _tell(
    found: dict[str, Any], words: str, target: Path, plot: Path | None, report: Path | None, as_json: bool
) -> None:
    written = [str(path) for path in (target, plot, report) if path]
    if as_json:
        say(json.dumps({"written": written} | found))
    else:
        say(*(f"wrote {each}" for each in written), words)


def _say_change(sizes: dict[str, int], change: dict[str, Any]) -> str:
    """Words for what denoising did, lengths in the unit of the places: m, unless a mesh has another."""
    said = ", ".join(f"{count} {name}" for name, count in sizes.items())
    if change["moved_m"]:
        said += "; moved by {median:.3g} (median) to {largest:.3g} m".format(**change["moved_m"])
    signals = ", ".join(f"{value:.2g} ({level})" for level, value in change["changed"].items())
    return said + (f"; signals changed, rms, by {signals}" if signals else "")
