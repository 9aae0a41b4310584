"""The user's own mesh and posed image to a run folder: the topology wing alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._files import one_line
from .errors import InputError
from .io import RunFolder, StoredFrame, read_image, read_mesh, write_frame
from .pipeline import RunResult, finish
from .records import array_hash, hash_of, machine, versions
from .topology.complex import build_complex
from .topology.harmonic import Tmahf
from .topology.texture import sample_signals
from .types import Cloud, FloatArray, Image, Rig, Surface
from .vision.formats import read_rectified
from .vision.visibility import visible_uv

_FARTHEST, _NEAREST = 1e9, 1e-9  # m


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
    pixels = read_image(image)
    rig = read_rectified(calibration, (pixels.shape[1], pixels.shape[0]))
    xyz, faces = read_mesh(mesh)
    try:
        frame = _filtered(xyz, faces, pixels, rig, stage, one_line(mesh.stem))
    except InputError as error:
        raise InputError(f"{mesh}: {error}") from error
    given = [array_hash(values) for values in (pixels, xyz, faces)]
    settings = {"command": "filter", "filter": vars(stage), "input": hash_of([given, vars(rig)])}
    with RunFolder.create(out, settings) as folder:
        path = folder.frame_path(0)
        write_frame(path, frame)
        record = _filter_record(frame)
        finish(folder, [path], pixels, frame, record, folder.config_hash)
        folder.keep(name for name, unit in folder.units.items() if unit.input == folder.config_hash)
        folder.write_timings({"machine": machine()})
    return RunResult(out, record)


def _filtered(
    xyz: FloatArray, faces: NDArray[np.int32], pixels: Image, rig: Rig, stage: Tmahf, name: str
) -> StoredFrame:
    _check_distance(xyz)
    complex_ = build_complex(faces, len(xyz))
    uv = visible_uv(rig, xyz, faces if len(faces) else None)
    signals = sample_signals(pixels, uv, complex_)
    seen = signals.vertex_ok
    if not seen.any():
        raise InputError(f"none of {len(xyz)} vertices falls into the image, expected the camera's frame, metres")
    response = stage(complex_, uv, signals)
    depth = np.where(np.isnan(uv[:, 0]) | (xyz[:, 2] < _NEAREST), np.nan, xyz[:, 2])
    cloud = Cloud(xyz, uv, rig.fx * rig.baseline / depth - rig.doffs)
    kept = Surface(faces if len(faces) == len(complex_.faces) else complex_.faces)
    return StoredFrame(0, 0.0, name, rig, cloud, kept, complex_, signals, response)


def _check_distance(xyz: FloatArray) -> None:
    far = np.flatnonzero(np.abs(xyz).max(axis=1) > _FARTHEST)
    if len(far):
        raise InputError(f"vertex {far[0]} is at {xyz[far[0]].tolist()}, expected metres, at most {_FARTHEST:g}")


def _filter_record(frame: StoredFrame) -> dict[str, Any]:
    hidden = int((~frame.signals.vertex_ok).sum())
    where = "hidden, outside the image or behind the camera"
    message = f"{hidden} of {len(frame.cloud)} vertices are {where} and have no signal"
    sizes = {"n": len(frame.cloud), "edges": len(frame.complex_.edges), "faces": len(frame.complex_.faces)}
    return {
        "status": "complete",
        "source": frame.name,
        "frames": 1,
        "complex": sizes | {"euler": frame.complex_.euler},
        "defined": int(frame.response.defined.sum()),
        "warnings": [{"code": "unseen_vertices", "message": message}] if hidden else [],
        "versions": versions(),
    }
