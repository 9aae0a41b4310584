"""``tspslam export`` and ``tspslam map``: a finished run's map, or one of its frames, in another format."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ..errors import InputError
from ..io import RunFolder
from ..io._export_folder import fill_folder
from ._export_rrd import export_rrd
from ._export_runs import export_bag, export_colmap, export_nerfstudio
from ._exported import Exported, write_cloud, write_numbers, write_scene, write_series
from .config import resolve
from .given import file_kind, has_map, shown_of_run, write_shown
from .guard import EXPORTS, MAPS, Kind, check_new_folder, check_place
from .map import join_keyframes, stored_keyframes

OURS = ("vtu", "ply", "npz")
"""Formats that `write_shown` knows, and `export_map_anew` writes."""


@dataclass(frozen=True)
class Format:
    """One format of ``tspslam export``.

    Attributes
    ----------
    name : str
        What ``--to`` takes.
    write : callable, (Exported, Path) -> None
        Writes a file, or fills a folder that is there and empty.
    suffix : str
        Of the file, with its dot; none of a folder.
    kind : Kind or None
        How such a file begins, so that no other is overwritten; None of a folder.
    has_frames : bool
        Whether one keyframe can be written.
    has_layers : bool
        Whether a layer can be chosen for the colours.
    """

    name: str
    write: Callable[[Exported, Path], None]
    suffix: str = ""
    kind: Kind | None = None
    has_frames: bool = False
    has_layers: bool = False


def _write_ours(kind: str, given: Exported, target: Path) -> None:
    write_shown(given.shown, target, kind, [given.path], is_forced=True)


def _write_whole(write: Callable[[Path, Path], None], given: Exported, target: Path) -> None:
    write(given.path, target)


FORMATS = {
    each.name: each
    for each in (
        *(Format(kind, partial(_write_ours, kind), f".{kind}", MAPS[kind], has_frames=True) for kind in OURS),
        Format("glb", write_scene, ".glb", EXPORTS["glb"], has_frames=True, has_layers=True),
        Format("pvd", write_series),
        Format("las", write_cloud, ".las", EXPORTS["las"], has_frames=True, has_layers=True),
        Format("laz", write_cloud, ".laz", EXPORTS["laz"], has_frames=True, has_layers=True),
        Format("tensors", write_numbers, ".npz", EXPORTS["tensors"], has_frames=True),
        Format("colmap", partial(_write_whole, export_colmap)),
        Format("nerfstudio", partial(_write_whole, export_nerfstudio)),
        Format("rrd", partial(_write_whole, export_rrd), ".rrd", EXPORTS["rrd"]),
        Format("bag", partial(_write_whole, export_bag)),
    )
}
"""Formats by name: one row each."""


def export(
    run: Path, to: str, output: Path | None = None, *, frame: int | None = None, layer: str | None = None,
    is_forced: bool = False,
) -> Path:  # fmt: skip
    """Write the map of a run, or one of its frames, in another format.

    Parameters
    ----------
    run : path
        The run folder.
    to : str
        One of `FORMATS`.
    output : path, optional
        The file or the folder; by default here: RUN-map or RUN-FRAME with the format's suffix, RUN with that of a
        whole run, RUN-FORMAT of a folder.
    frame : int, optional
        Index of a keyframe; by default the map, of a run of one frame that frame.
    layer : str, optional
        Name of the layer that gives the colours, where the format has some.
    is_forced : bool
        Whether a file of another kind may be overwritten, or a folder of an earlier export be replaced.

    Returns
    -------
    Path
        The file or the folder.

    Raises
    ------
    InputError
        If the run has no such frame or layer, or of several frames no map; if the file lies in the run, is of another
        kind, or a package that the format needs is not installed.
    OutputError
        If it cannot be written.
    """
    chosen = FORMATS[to]
    name, shown = shown_of_run(run, frame if chosen.has_frames else _first_without_map(run))
    target = output or Path(_default_name(chosen, run.resolve().name, name))
    given = Exported(run, shown, layer)
    if chosen.kind is None:
        check_new_folder(target, to, [run], is_forced=is_forced)
        with fill_folder(target, to, is_forced=is_forced) as folder:
            chosen.write(given, folder)
        return target
    check_place(target, file_kind(shown, target, to) if to in OURS else chosen.kind, [run], is_forced=is_forced)
    chosen.write(given, target)
    return target


def _first_without_map(run: Path) -> int | None:
    """Index of the frame that stands for the map of a run without one, as in its own map.vtu; None where it has one."""
    folder = RunFolder.open(run)
    return None if has_map(folder) or not folder.stored_frames else folder.stored_frames[0]


def _default_name(chosen: Format, run: str, part: str) -> str:
    if chosen.kind is None:
        return f"{run}-{chosen.name}"
    word = "" if chosen.suffix[1:] == chosen.name else f"-{chosen.name}"
    return f"{run}-{part}{word}{chosen.suffix}" if chosen.has_frames else f"{run}{chosen.suffix}"


def export_map_anew(
    run: Path, output: Path | None = None, assignments: Iterable[str] = (), *, is_forced: bool = False
) -> dict[str, Any]:
    """Make the map of a run anew, and write it.

    Parameters
    ----------
    run : path
        The run folder.
    output : path, optional
        The file, of one of `OURS` by its suffix; RUN-map.npz here by default.
    assignments : iterable of str
        Settings that differ from the run's, such as ``"mapping.surface.longest=0.3"``.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    dict
        ``written``, and how many ``vertices``, ``edges``, ``faces`` and ``keyframes`` it has.

    Raises
    ------
    InputError
        As `export`; if a setting is not one of the map, or the run has no landmarks.
    GeometryError
        If the landmarks span no surface.
    OutputError
        If the file cannot be written.
    """
    wrong = [each for each in assignments if not each.strip().startswith("mapping.")]
    if wrong:
        raise InputError(f"--set {wrong[0]!r:.80}: is no setting of the map, expected one that begins with mapping.")
    folder, target = RunFolder.open(run), output or Path(f"{run.resolve().name}-map.npz")
    kind = target.suffix[1:].lower()
    settings = resolve(file=folder.path / "config.yaml", assignments=assignments).settings
    check_place(target, MAPS["map" if kind == "npz" else kind], [run], is_forced=is_forced)
    made = join_keyframes(stored_keyframes(folder), settings)
    sizes = {"vertices": len(made), "edges": len(made.complex_.edges), "faces": len(made.surface.faces)}
    return (
        {"written": str(write_shown(made, target, kind, [run], is_forced=is_forced))}
        | sizes
        | {"keyframes": len(made.keyframes)}
    )
