"""The user's own mesh and posed image to a run folder: the topology wing alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import require, require_path
from .._files import PathLike, one_line
from ..datasets.maps import read_levelled
from ..errors import InputError
from ..frame import Frame
from ..interop.meshes import doubts_of_mesh, from_arrays
from ..io import RunFolder, read_polygons, triangulate_polygons, write_frame
from ..io._polygons import rows_of_triangles
from ..io.mesh import merge_corners_of, repeated_corners
from ..topology.cells import CellComplex
from ..topology.complex import Complex
from ..topology.harmonic import Tmahf
from ..types import FloatArray
from ..vision.calibration.formats import read_rectified
from ..vision.rig import doubts
from ._filtered_cells import POLYGONS, answer_on_cells
from .pipeline import RunResult, write_results
from .record import array_hash, hash_of, machine, versions
from .summary import no_response, pixel_warnings

Triangles = tuple[FloatArray, NDArray[np.int32], NDArray[np.int64]]


def filter_mesh(
    mesh: PathLike,
    image: PathLike,
    calibration: PathLike,
    out: PathLike,
    stage: Tmahf,
    *,
    merge: bool = False,
    polygons: str = "fan",
    bits: int | None = None,
) -> RunResult:
    """The topology wing alone: signals of a posed image on the user's own mesh, and their response.

    Parameters
    ----------
    mesh : path
        What `tspslam.io.read_mesh` takes; vertices in the camera's frame, m.
    image : path
        What the left camera saw.
    calibration : path
        Our calibration file.
    out : path
        The run folder to fill.
    stage : Tmahf
        The filter.
    merge : bool
        Make one vertex of those with equal coordinates first, as `tspslam.io.merge_corners`. A mesh whose faces share
        no edge is filtered as it is, and the run is degraded.
    polygons : {"fan", "cells"}
        What becomes of faces of more than three corners: they are cut into fans of triangles; or they are cells, whose
        diagonals no value goes along. What is stored and drawn are the triangles in both cases.
    bits : int, optional
        How many bits the image's pixels use if they have 16; found by default.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError
        If an argument is of another kind, a file cannot be used, a mesh has no faces, or the camera sees no vertex.
    OutputError
        If something cannot be written.
    """
    for path, what in ((mesh, "mesh"), (image, "image"), (calibration, "calibration"), (out, "out")):
        require_path(path, what)
    require(stage, Tmahf, "stage")
    if polygons not in POLYGONS:
        raise InputError(f"polygons is {polygons!r:.40}, expected {' or '.join(POLYGONS)}")
    mesh = Path(mesh)
    pixels, used = read_levelled(image, bits)
    rig = read_rectified(calibration, (pixels.shape[1], pixels.shape[0]))
    xyz, faces, face_of = _triangles(mesh)
    if merge:
        xyz, faces, face_of = _merged(mesh, xyz, faces, face_of)
    try:
        seen = from_arrays(xyz, faces, pixels, rig, name=one_line(mesh.stem))
        frame, of = _answer(seen, face_of, stage, polygons)
    except InputError as error:
        raise InputError(f"{mesh}: {error}") from error
    given = [array_hash(values) for values in (pixels, xyz, faces)]
    settings = {"command": "filter", "filter": vars(stage), "input": hash_of([given, vars(rig)])}
    if isinstance(of, CellComplex):
        settings |= {"polygons": polygons, "cells": array_hash(face_of)}
    record = filter_record(frame, used, _warnings(frame, face_of, of), of)
    return write_filtered(out, settings, frame, record)


def _answer(frame: Frame, face_of: NDArray[np.int64], stage: Tmahf, polygons: str) -> tuple[Frame, Complex]:
    """The frame with its response, and the complex that this is of."""
    if polygons == "cells":
        return answer_on_cells(frame, face_of, stage)
    return replace(frame, response=stage(frame.complex_, frame.cloud.uv, frame.signals)), frame.complex_


def write_filtered(out: PathLike, settings: Mapping[str, Any], frame: Frame, record: dict[str, Any]) -> RunResult:
    """Write the run folder of a single frame that no pair was read for.

    Parameters
    ----------
    out : path
        The run folder to fill.
    settings : dict
        What it was made with: the same again goes on with the folder.
    frame : Frame
        The frame.
    record : dict
        As `filter_record`.

    Returns
    -------
    RunResult

    Raises
    ------
    InputError, OutputError
        If the folder holds something else, or cannot be written.
    """
    with RunFolder.create(out, dict(settings)) as folder:
        path = folder.frame_path(0)
        write_frame(path, frame)
        write_results(folder, [path], frame, record, folder.config_hash)
        folder.keep(name for name, unit in folder.units.items() if unit.input == folder.config_hash)
        folder.write_timings({"machine": machine()})
    return RunResult(Path(out), record)


def _merged(mesh: Path, xyz: FloatArray, faces: NDArray[np.int32], face_of: NDArray[np.int64]) -> Triangles:
    xyz, faces, kept = merge_corners_of(xyz, faces)
    if not kept.any():
        raise InputError(f"{mesh}: has no face whose corners are at three places, expected a mesh")
    return xyz, faces[kept], face_of[kept]


def _triangles(mesh: Path) -> Triangles:
    """Positions, triangles, and the face of the file that each is of."""
    xyz, polygons = read_polygons(mesh)
    try:
        return xyz, triangulate_polygons(xyz, polygons), rows_of_triangles(polygons)
    except InputError as error:
        raise InputError(f"{mesh}: {error}") from error


def filter_record(
    frame: Frame, bits: int | None, warnings: Iterable[tuple[str, str]], of: Complex | None = None
) -> dict[str, Any]:
    """Summarize a frame that no pair was read for, as ``run.json`` has it.

    Parameters
    ----------
    frame : Frame
        The frame.
    bits : int or None
        How many bits the image's pixels use if they have 16.
    warnings : iterable of (code, message)
        What is doubtful.
    of : Complex, optional
        What the response is of, where that is not the frame's own.

    Returns
    -------
    dict
    """
    of = of or frame.complex_
    sizes = {"n": len(frame.cloud), "edges": len(of.edges), "faces": len(of.faces)}
    return {
        "status": "degraded" if _is_soup(of) or not frame.response.defined.any() else "complete",
        "source": frame.name,
        "frames": 1,
        "complex": sizes | {"euler": of.euler},
        "defined": int(frame.response.defined.sum()),
        **({"bits": bits} if bits else {}),
        "warnings": [
            *({"code": code, "message": message} for code, message in warnings),
            *no_response(int(frame.response.defined.sum())),
            *pixel_warnings(bits),
        ],
        "versions": versions(),
    }


def _is_soup(complex_: Complex) -> bool:
    """Whether no two of several faces share an edge, so that nothing goes from one to the other."""
    return len(complex_.faces) > 1 and len(complex_.edges) == len(complex_.boundary[1])


def _warnings(frame: Frame, face_of: NDArray[np.int64], of: Complex) -> Iterator[tuple[str, str]]:
    polygons = int((np.bincount(face_of) > 1).sum())
    if polygons:
        way = "they are cells, and cut into triangles where they are stored" if of is not frame.complex_ else ""
        said = f"{polygons} faces of the mesh have more than three corners"
        yield "polygons", f"{said}: {way or 'they are cut into triangles'}"
    hidden = int((~frame.signals.vertex_ok).sum())
    if hidden:
        where = "hidden, outside the image or behind the camera"
        yield "unseen_vertices", f"{hidden} of {len(frame.cloud)} vertices are {where} and have no signal"
    corners = frame.cloud.xyz[np.unique(frame.complex_.faces)]
    repeated = repeated_corners(corners)
    way_on = "merge corners with --merge-corners" if repeated else "they touch nowhere"
    if _is_soup(of):
        yield "no_shared_edge", f"no edge is shared by two of the {len(of.faces)} faces: {way_on}"
    elif repeated:
        said = f"{repeated} of {len(corners)} corners of faces are where another is: edges there are not shared"
        yield "repeated_corners", f"{said}; {way_on}"
    for line in doubts_of_mesh(frame):
        yield "mesh", line
    for line in doubts(frame.rig):
        yield "calibration", line
