"""One frame as VTU and PLY: every vertex, edge and face with its signals, and the response at the vertices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..frame import Frame
from ..types import FloatArray, Response, one_channel
from .ply import write_ply
from .vtu import write_vtu

Columns = dict[str, NDArray[Any]]


def write_maps(vtu: Path, ply: Path, frame: Frame) -> None:
    """Write a frame's map as VTU and as PLY; see `write_map_vtu` and `write_map_ply`.

    Parameters
    ----------
    vtu, ply : path
        The files.
    frame : Frame
        Where the map is from.
    """
    write_map_vtu(vtu, frame)
    write_map_ply(ply, frame)


def write_map_vtu(path: Path, frame: Frame) -> None:
    """Write a frame as VTU: lines and triangles, told apart by the integer cell array ``dim``.

    Parameters
    ----------
    path : path
        Where to.
    frame : Frame
        Cells carry ``luminance``, ``pixels`` and ``ok``; points also depth and the response (real, imaginary part,
        magnitude, phase, defined).

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    signals = frame.signals
    edge = _level(signals.edge, signals.edge_ok) | {"pixels": signals.edge_pixels}
    face = _level(signals.face, signals.face_ok) | {"pixels": signals.face_pixels}
    write_vtu(path, frame.complex_, frame.cloud.xyz, vertex=_vertex(frame), edge=edge, face=face)


def write_map_ply(path: Path, frame: Frame) -> None:
    """Write a frame as PLY: vertices and faces with their signals (edge signals break common readers: see VTU).

    Parameters
    ----------
    path : path
        Where to.
    frame : Frame
        Vertices also carry their luminance as grey ``red green blue``.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    grey = np.round(255 * np.clip(one_channel(frame.signals.vertex), 0, 1)).astype(np.uint8)
    vertex = dict.fromkeys(("red", "green", "blue"), grey) | _vertex(frame)
    face = _level(frame.signals.face, frame.signals.face_ok)
    write_ply(path, frame.cloud.xyz, frame.surface.faces, vertex=vertex, face=face)


def _vertex(frame: Frame) -> Columns:
    z = one_channel(frame.response.z)
    response = Response(z, frame.response.order, frame.response.defined)
    return _level(frame.signals.vertex, frame.signals.vertex_ok) | {
        "depth": frame.cloud.xyz[:, 2],
        "response_real": np.ascontiguousarray(z.real),
        "response_imaginary": np.ascontiguousarray(z.imag),
        "magnitude": response.magnitude,
        "phase": response.phase,
        "defined": frame.response.defined.astype(np.uint8),
    }


def _level(values: FloatArray, ok: NDArray[np.bool_]) -> Columns:
    return {"luminance": one_channel(values), "ok": ok.astype(np.uint8)}
