"""The user's own mesh and posed image to a run folder: the topology wing alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ._files import one_line
from .datasets.maps import read_levelled
from .doors.meshes import from_arrays
from .errors import InputError
from .io import RunFolder, StoredFrame, read_mesh, write_frame
from .pipeline import RunResult, finish
from .records import array_hash, hash_of, machine, pixel_warnings, versions
from .topology.harmonic import Tmahf
from .vision.formats import read_rectified


def filter_mesh(
    mesh: Path, image: Path, calibration: Path, out: Path, stage: Tmahf, *, bits: int | None = None
) -> RunResult:
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
    bits : int, optional
        How many bits the image's pixels use if they have 16; found by default.

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
    pixels, used = read_levelled(image, bits)
    rig = read_rectified(calibration, (pixels.shape[1], pixels.shape[0]))
    xyz, faces = read_mesh(mesh)
    try:
        textured = from_arrays(xyz, faces, pixels, rig)
        response = stage(textured.complex_, textured.cloud.uv, textured.signals)
    except InputError as error:
        raise InputError(f"{mesh}: {error}") from error
    frame = StoredFrame(0, 0.0, one_line(mesh.stem), rig, **vars(textured), response=response)
    given = [array_hash(values) for values in (pixels, xyz, faces)]
    settings = {"command": "filter", "filter": vars(stage), "input": hash_of([given, vars(rig)])}
    with RunFolder.create(out, settings) as folder:
        path = folder.frame_path(0)
        write_frame(path, frame)
        record = _filter_record(frame, used)
        finish(folder, [path], pixels, frame, record, folder.config_hash)
        folder.keep(name for name, unit in folder.units.items() if unit.input == folder.config_hash)
        folder.write_timings({"machine": machine()})
    return RunResult(out, record)


def _filter_record(frame: StoredFrame, bits: int | None) -> dict[str, Any]:
    hidden = int((~frame.signals.vertex_ok).sum())
    where = "hidden, outside the image or behind the camera"
    message = f"{hidden} of {len(frame.cloud)} vertices are {where} and have no signal"
    unseen = [{"code": "unseen_vertices", "message": message}] if hidden else []
    sizes = {"n": len(frame.cloud), "edges": len(frame.complex_.edges), "faces": len(frame.complex_.faces)}
    return {
        "status": "complete",
        "source": frame.name,
        "frames": 1,
        "complex": sizes | {"euler": frame.complex_.euler},
        "defined": int(frame.response.defined.sum()),
        **({"bits": bits} if bits else {}),
        "warnings": [*unseen, *pixel_warnings(bits)],
        "versions": versions(),
    }
