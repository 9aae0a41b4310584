"""A source of pairs to a run folder: frame by frame, each noted when it is finished, resumed where it stopped."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from . import __version__
from .config import Resolved
from .errors import InputError
from .io import RunFolder, StoredFrame, read_frame, read_image, read_mesh, write_bytes, write_frame
from .io.maps import write_maps
from .session import Frame, Session
from .topology.complex import Complex, build_complex
from .topology.harmonic import Tmahf
from .topology.surface import pinched_vertices
from .topology.texture import sample_signals
from .types import Cloud, Image, Response, Rig, Signals, StereoPair, Surface
from .vision.rig import load_rig, project

Progress = Callable[[int, int, str], None]


class Source(Protocol):
    """Pairs of one rig, by index."""

    @property
    def name(self) -> str:
        """What to call it."""

    @property
    def rig(self) -> Rig:
        """The cameras of all pairs."""

    def __len__(self) -> int:
        """How many pairs there are."""

    def __getitem__(self, index: int) -> StereoPair:
        """Read one pair."""


@dataclass(frozen=True)
class OnePair:
    """A source of a single pair."""

    pair: StereoPair

    @property
    def name(self) -> str:
        """The pair's name."""
        return self.pair.name

    @property
    def rig(self) -> Rig:
        """The pair's cameras."""
        return self.pair.rig

    def __len__(self) -> int:
        return 1

    def __getitem__(self, index: int) -> StereoPair:
        return self.pair


@dataclass(frozen=True)
class RunResult:
    """What a run left: its folder, and the content of its ``run.json``."""

    folder: Path
    run: dict[str, Any]

    @property
    def is_degraded(self) -> bool:
        """Whether frames were skipped."""
        return bool(self.run["status"] != "complete")


def run(
    source: Source, out: Path, resolved: Resolved, *, frames: range | None = None, progress: Progress | None = None
) -> RunResult:
    """Process each pair of `source` on its own and fill the run folder `out`.

    A pair that cannot be used is skipped with a warning, and the run is degraded; if none can, its error is raised.

    Parameters
    ----------
    source : Source
        The pairs.
    out : path
        The run folder; new, empty, or of the same settings (then finished frames are kept).
    resolved : Resolved
        The settings.
    frames : range, optional
        Which pairs; all by default.
    progress : callable, optional
        Called with (frames done, frames in all, name) after each.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If no pair can be used, or `out` is not ours or has other settings.
    OutputError
        If something cannot be written.
    """
    started = time.perf_counter()
    wanted = frames if frames is not None else range(len(source))
    with RunFolder.create(out, resolved.nested) as folder:
        done, skipped = _process_all(source, wanted, Session(source.rig, resolved.settings), folder, progress)
        shown = source[done[0]["index"]]
        record = _run_record(source, done, skipped, resolved, shown.name)
        folder.write_run(record)
        _write_results(folder, shown, record, done)
        seconds = {unit["name"]: unit["seconds"] for unit in done if unit["seconds"]}
        folder.write_timings({"frames": seconds, "total_s": time.perf_counter() - started, "machine": _machine()})
    return RunResult(out, record)


def _process_all(
    source: Source, wanted: range, session: Session, folder: RunFolder, progress: Progress | None
) -> tuple[list[dict[str, Any]], list[dict[str, str]]]:
    done: list[dict[str, Any]] = []
    skipped: list[dict[str, str]] = []
    last: InputError | None = None
    for count, index in enumerate(wanted, 1):
        try:
            done.append(_process_one(source[index], session, folder))
        except InputError as error:
            last = error
            skipped.append({"code": "frame_skipped", "message": f"frame {index}: {error}"})
        if progress:
            progress(count, len(wanted), f"frame {index}")
    if not done:
        if last and len(wanted) == 1:
            raise last
        raise InputError(f"{source.name}: none of {len(wanted)} pairs can be used; the last: {last}")
    return done, skipped


def _process_one(pair: StereoPair, session: Session, folder: RunFolder) -> dict[str, Any]:
    """Summary of one frame; computed anew only if the folder does not hold it."""
    key, path = _pair_hash(pair), folder.frame_path(pair.index)
    summary_path = path.with_suffix(".json")
    if folder.is_done(path, input_hash=key) and folder.is_done(summary_path, input_hash=key):
        stored: dict[str, Any] = json.loads(summary_path.read_text(encoding="utf-8"))
        return stored | {"seconds": {}}
    frame = session.process(pair)
    summary = _summary(frame)
    write_frame(path, frame)
    write_bytes(summary_path, (json.dumps(summary, indent=1, allow_nan=False) + "\n").encode())
    folder.record(path, input_hash=key)
    folder.record(summary_path, input_hash=key)
    return summary | {"seconds": frame.seconds}


def _summary(frame: Frame) -> dict[str, Any]:
    quality = frame.quality
    return {
        "index": frame.index,
        "name": frame.name,
        "stamp": frame.stamp,
        "points": len(frame.cloud),
        "edges": len(frame.complex_.edges),
        "faces": len(frame.complex_.faces),
        "euler": frame.complex_.euler,
        "pinched_vertices": pinched_vertices(frame.surface.faces, len(frame.cloud)).tolist(),
        "defined": int(frame.response.defined.sum()),
        "keypoints_left": quality.keypoints_left,
        "keypoints_right": quality.keypoints_right,
        "matched": quality.matched,
        "by_row_search": quality.by_row_search,
        "vertical_offset_px": quality.vertical_offset_px,
        "vertical_offset_std_px": quality.vertical_offset_std_px,
    }


def _run_record(
    source: Source, done: list[dict[str, Any]], skipped: list[dict[str, str]], resolved: Resolved, shown: str
) -> dict[str, Any]:
    first = done[0]
    offsets = [unit["vertical_offset_px"] for unit in done]
    return {
        "status": "degraded" if skipped else "complete",
        "source": source.name,
        "frames": len(done) + len(skipped),
        "tracked": len(done),
        "keyframes": len(done),
        "landmarks": first["points"],
        "complex": {"n": first["points"], **{key: first[key] for key in ("edges", "faces", "euler")}},
        "calibration": {
            "vertical_offset_px": float(np.median(offsets)),
            "vertical_offset_std_px": first["vertical_offset_std_px"],
            "disparity_offset_px": None,
            "disparity_offset_std_px": None,
        },
        "warnings": [*skipped, *_warnings(source, done, shown)],
        "per_frame": [_row(unit) for unit in done],
        "versions": _versions(),
        "seeds": {},
        "input_hash": _hash_of([_rig_record(source.rig), [unit["name"] for unit in done]]),
        "settings_hash": _hash_of(resolved.nested),
    }


def _row(unit: dict[str, Any]) -> dict[str, Any]:
    row = {key: value for key, value in unit.items() if key != "seconds"}
    return row | {"pinched_vertices": len(unit["pinched_vertices"])}


def _warnings(source: Source, done: list[dict[str, Any]], shown: str) -> Iterator[dict[str, str]]:
    if len(done) > 1:
        message = f"frames are processed one by one, without a path between them; map and pictures show {shown}"
        yield {"code": "frames_independent", "message": message}
    unpaired = getattr(source, "unpaired", ())
    if unpaired:
        names = ", ".join(map(str, list(unpaired)[:3]))
        yield {"code": "unpaired", "message": f"{len(unpaired)} images have no partner of the same name: {names}"}
    pinched = sum(len(unit["pinched_vertices"]) for unit in done)
    if pinched:
        message = (
            f"the surface is not a manifold at {pinched} vertices (frames/*.json): depth cuts left several fans there"
        )
        yield {"code": "pinched_vertices", "message": message}


def _write_results(folder: RunFolder, pair: StereoPair, record: dict[str, Any], done: list[dict[str, Any]]) -> None:
    """Trajectory, map, pictures and report of the first frame; the report comes last, so its line says all is there."""
    stored = read_frame(folder.frame_path(pair.index))
    key = _hash_of([record, folder.units[f"frames/{pair.index:06d}.npz"].sha256])
    if _is_finished(folder, key):
        return
    folder.write_trajectory([done[0]["stamp"]], np.eye(4)[None])
    write_maps(folder.map_vtu_path, folder.map_ply_path, stored)
    _draw(folder, _shown(pair.left, stored), record, key)


def _is_finished(folder: RunFolder, key: str) -> bool:
    names = [name for name, unit in folder.units.items() if unit.input == key]
    return "report.html" in names and all(folder.is_done(folder.path / name, input_hash=key) for name in names)


def _draw(folder: RunFolder, shown: Shown, record: dict[str, Any], key: str) -> None:
    from .view import pictures, report

    drawn = pictures.write_pictures(shown, folder.path / "pictures")
    report.write_report(shown, record, drawn, folder.report_path)
    for path in (folder.map_vtu_path, folder.map_ply_path, *drawn, folder.report_path):
        folder.record(path, input_hash=key)


@dataclass(frozen=True)
class Shown:
    """A frame with its image, as pictures and report need it."""

    name: str
    image: Image
    cloud: Cloud
    surface: Surface
    complex_: Complex
    signals: Signals
    response: Response


def _shown(image: Image, frame: StoredFrame) -> Shown:
    return Shown(frame.name, image, frame.cloud, frame.surface, frame.complex_, frame.signals, frame.response)


def filter_mesh(mesh: Path, image: Path, calibration: Path, out: Path, stage: Tmahf) -> RunResult:
    """The topology wing alone: signals of a posed image on the user's own mesh, and their response.

    Parameters
    ----------
    mesh : path
        PLY, OBJ, VTU or a stored frame; vertices in the camera's frame, m.
    image : path
        What the left camera saw.
    calibration : path
        Our calibration file.
    out : path
        The run folder to fill.
    stage : Tmahf
        The filter.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If a file cannot be used, or the camera sees no vertex.
    OutputError
        If something cannot be written.
    """
    rig, pixels = load_rig(calibration), read_image(image)
    if pixels.shape[:2] != (rig.height, rig.width):
        seen = f"{pixels.shape[1]}x{pixels.shape[0]}"
        raise InputError(f"{image}: is {seen} px, expected {rig.width}x{rig.height} as {calibration} says")
    frame = _filtered(mesh, pixels, rig, stage)
    settings = {"command": "filter", "filter": vars(stage), "input": _hash_of([_array_hash(pixels), str(mesh)])}
    with RunFolder.create(out, settings) as folder:
        path = folder.frame_path(0)
        write_frame(path, frame)
        folder.record(path, input_hash=folder.config_hash)
        record = _filter_record(frame)
        folder.write_run(record)
        write_maps(folder.map_vtu_path, folder.map_ply_path, frame)
        _draw(folder, _shown(pixels, frame), record, folder.config_hash)
        folder.write_timings({"machine": _machine()})
    return RunResult(out, record)


def _filtered(mesh: Path, pixels: Image, rig: Rig, stage: Tmahf) -> StoredFrame:
    xyz, faces = read_mesh(mesh)
    complex_ = build_complex(faces, len(xyz))
    uv = project(rig, xyz)
    signals = sample_signals(pixels, uv, complex_)
    seen = signals.vertex_ok
    if not seen.any():
        raise InputError(
            f"{mesh}: none of {len(xyz)} vertices falls into the image, expected the camera's frame, metres"
        )
    response = stage(complex_, uv, signals)
    depth = np.where(seen, xyz[:, 2], 1.0)
    disparity = np.where(seen, rig.fx * rig.baseline / depth - rig.doffs, 0.0)
    cloud = Cloud(xyz, np.where(seen[:, None], uv, 0.0), disparity)
    kept = Surface(faces if len(faces) == len(complex_.faces) else complex_.faces)
    return StoredFrame(0, 0.0, mesh.stem, rig, cloud, kept, complex_, signals, response)


def _filter_record(frame: StoredFrame) -> dict[str, Any]:
    hidden = int((~frame.signals.vertex_ok).sum())
    message = f"{hidden} of {len(frame.cloud)} vertices are outside the image or behind the camera and have no signal"
    sizes = {"n": len(frame.cloud), "edges": len(frame.complex_.edges), "faces": len(frame.complex_.faces)}
    return {
        "status": "complete",
        "source": frame.name,
        "frames": 1,
        "complex": sizes | {"euler": frame.complex_.euler},
        "defined": int(frame.response.defined.sum()),
        "warnings": [{"code": "unseen_vertices", "message": message}] if hidden else [],
        "versions": _versions(),
    }


def _pair_hash(pair: StereoPair) -> str:
    digest = hashlib.sha256(_json_bytes(_rig_record(pair.rig)))
    for image in (pair.left, pair.right):
        digest.update(_array_hash(image).encode())
    return digest.hexdigest()


def _array_hash(values: Image) -> str:
    head = f"{values.shape} {values.dtype}".encode()
    return hashlib.sha256(head + np.ascontiguousarray(values).tobytes()).hexdigest()


def _rig_record(rig: Rig) -> dict[str, float]:
    return {key: float(value) for key, value in vars(rig).items()}


def _hash_of(value: Any) -> str:
    return hashlib.sha256(_json_bytes(value)).hexdigest()


def _json_bytes(value: Any) -> bytes:
    return (json.dumps(value, sort_keys=True, allow_nan=False) + "\n").encode()


def _versions() -> dict[str, str]:
    packages = ("numpy", "scipy", "opencv-python-headless", "numba")
    return {"tspslam": __version__, **{name: version(name) for name in packages}}


def _machine() -> dict[str, str]:
    return {"system": platform.platform(), "python": platform.python_version(), "processor": platform.machine()}
