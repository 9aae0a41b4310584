"""The source of a run, from what was typed: images, folders, bags, videos, a live camera, one image with a map."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

from ._live import open_cameras

if TYPE_CHECKING:
    from ..datasets.joined import Source
    from ..run.sequence import Step

_PARTNERS = {
    "topics": "goes with a bag alone",
    "layout": "goes with one video, or with --camera",
    "fps": "goes with a folder of images or a video",
    "unit": "goes with depths: one folder, --depth or --disparity",
    "sensor": "goes with depths: one folder or bag",
    "unknown": "goes with --depth or --disparity",
    "bits": "goes with images",
    "calib": "goes with a pair of files or a folder",
    "frames": "goes with one recording",
    "into": "goes with recordings: folders, bags or videos",
    "out": "does not go with --into: the run itself is gone on with",
}
"""What each option goes with."""


@dataclass(frozen=True)
class Given:
    """Options of ``tspslam run`` that say what is read; None where one was not given."""

    paths: list[Path]
    calib: Path | None = None
    camera: list[str] | None = None
    depth: Path | None = None
    disparity: Path | None = None
    unit: float | None = None
    unknown: float | None = None
    sensor: str | None = None
    topics: tuple[str, str] | None = None
    layout: str | None = None
    fps: float | None = None
    bits: int | None = None
    frames: str | None = None
    out: Path | None = None
    into: Path | None = None

    def refuse(self, *names: str) -> None:
        """Refuse options that do not go with what is read."""
        for name in names:
            if getattr(self, name) is not None:
                raise typer.BadParameter(_PARTNERS[name], param_hint=f"--{name}")


def open_source(given: Given, on_step: Callable[[Step], object] | None = None) -> Source:
    """Open what is to be read; `on_step` is told how far a video has been gone through."""
    if given.camera:
        given.refuse("into")
        return _open_cameras(given)
    if given.depth or given.disparity:
        given.refuse("topics", "layout", "fps", "sensor", "into")
        return _open_map(given)
    given.refuse("unknown")
    return _open_images(given, index_steps(on_step))


def index_steps(on_step: Callable[[Step], object] | None) -> Callable[[int, int], object] | None:
    """What takes frames done and in all, while a video is gone through, and tells them as steps."""
    from ..run.sequence import Step

    return None if on_step is None else lambda done, total: on_step(Step("indexing", done, total))


def _open_cameras(given: Given) -> Source:
    others = {"SOURCE": given.paths} | {
        f"--{name}": getattr(given, name) for name in ("depth", "disparity", "frames", "fps", "topics", "unit")
    }
    given.refuse("unknown", "sensor", "bits")
    return open_cameras(given.camera or [], given.layout, given.calib, given.out, others)


def _open_images(given: Given, on_index: Callable[[int, int], object] | None) -> Source:
    from .. import datasets
    from ..datasets.folder import read_pair_with_remarks
    from ..datasets.layouts import are_parts, are_recordings
    from ..run.pipeline import OnePair

    paths = given.paths
    if are_recordings(paths):
        given.refuse("frames")
        places = [os.path.realpath(path) for path in paths]
        again = next((path for k, path in enumerate(paths) if places[k] in places[:k]), None)
        if again is not None:
            raise typer.BadParameter(f"{again} is named twice, expected each recording once", param_hint="SOURCE")
        recordings = [_open_sequence(replace(given, paths=[path]), on_index) for path in paths]
        return datasets.JoinedSequence(recordings)
    if len(paths) == 1 or are_parts(paths):
        return _open_sequence(given, on_index)
    given.refuse("topics", "layout", "fps", "unit", "sensor", "into")
    if not paths:
        given.refuse("calib", "bits")
        return OnePair(datasets.motorcycle())
    if len(paths) > 2:
        said = f"{len(paths)} paths, expected a pair of images, folders or videos, one of these, or files of one bag"
        raise typer.BadParameter(said, param_hint="SOURCE")
    if given.calib is None:
        raise typer.BadParameter("a pair of files needs a calibration file", param_hint="--calib")
    return OnePair(*read_pair_with_remarks(paths[0], paths[1], given.calib, bits=given.bits))


def _open_sequence(given: Given, on_index: Callable[[int, int], object] | None) -> Source:
    from .. import datasets
    from ..datasets._kinds import is_video
    from ..vision.depth.sensor import SENSORS

    if given.sensor not in (None, *SENSORS):
        raise typer.BadParameter(f"{given.sensor!r}, expected one of {', '.join(SENSORS)}", param_hint="--sensor")
    if len(given.paths) > 1:
        given.refuse("layout", "unit", "sensor")
        if given.calib is None and all(map(is_video, given.paths)):
            raise typer.BadParameter("two videos need a calibration file", param_hint="--calib")
    path: Any = given.paths if len(given.paths) > 1 else given.paths[0]
    return datasets.open_sequence(
        path, calib=given.calib, topics=given.topics, bits=given.bits, layout=given.layout, fps=given.fps,
        unit=given.unit, sensor=SENSORS[given.sensor] if given.sensor else None, on_index=on_index,
    )  # fmt: skip


def _open_map(given: Given) -> Source:
    from .. import datasets
    from ..run.pipeline import OnePair

    kinds: tuple[tuple[Literal["depth", "disparity"], Path | None], ...]
    kinds = (("depth", given.depth), ("disparity", given.disparity))
    maps = [(kind, path) for kind, path in kinds if path]
    if len(given.paths) != 1 or given.calib is None or len(maps) != 1:
        wanted = "one image, --calib, and either --depth or --disparity"
        raise typer.BadParameter(f"a map goes with {wanted}", param_hint="--depth/--disparity")
    kind, path = maps[0]
    said: dict[str, Any] = {"unit": given.unit, "unknown": given.unknown, "bits": given.bits}
    return OnePair(datasets.pair_from_map(given.paths[0], path, given.calib, kind=kind, **said))
