"""A frame or a map as VTU and PLY: every vertex, edge and face with its signals, and the response at the vertices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import brief
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..topology.complex import Complex
from ..types import FloatArray, Response, Signals, one_channel
from .ply import write_ply
from .textured import TexturedMesh
from .vtu import write_vtu

Columns = dict[str, NDArray[Any]]
_BEYOND_PLY = ("landmark_id", "direction", "pixels")  # too large, a vector, and known from the VTU


class Layers(NamedTuple):
    """What is written: a complex, its triangles as they are wound, and columns by name."""

    complex_: Complex
    xyz: FloatArray
    faces: NDArray[np.int32]
    vertex: Columns
    edge: Columns
    face: Columns

    def __repr__(self) -> str:
        return brief(self)


def write_maps(vtu: Path, ply: Path, shown: Frame | TopologicalMap) -> None:
    """Write a frame or a map as VTU and as PLY; see `write_map_vtu` and `write_map_ply`.

    Parameters
    ----------
    vtu, ply : path
        The files.
    shown : Frame or TopologicalMap
        What is written.
    """
    write_map_vtu(vtu, shown)
    write_map_ply(ply, shown)


def write_map_vtu(
    path: Path, shown: Frame | TopologicalMap | TexturedMesh, *, face: Mapping[str, ArrayLike] | None = None,
    T_world_camera: FloatArray | None = None,
) -> None:  # fmt: skip
    """Write a frame or a map as VTU: lines and triangles, told apart by the integer cell array ``dim``.

    Parameters
    ----------
    path : path
        Where to.
    shown : Frame, TopologicalMap or TexturedMesh
        Cells carry ``luminance``, ``pixels`` and ``ok``; points also the response (real, imaginary part, magnitude,
        phase, defined). Points of a frame have their depth; elements of a map ``views`` and ``variance``, its points
        ``landmark_id``, ``direction`` and ``direction_spread``, and its triangles are wound as the surface's.
    face : dict of (F,) arrays, optional
        More columns of the triangles.
    T_world_camera : (4, 4) float64, optional
        Pose that moves the points of a frame into the world; its depths stay those in the camera's frame.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    layers, T = _layers(shown), T_world_camera
    xyz = layers.xyz if T is None else layers.xyz @ T[:3, :3].T + T[:3, 3]
    own = {**layers.face, **(face or {})}
    write_vtu(path, layers.complex_, xyz, vertex=layers.vertex, edge=layers.edge, face=own)


def write_map_ply(
    path: Path, shown: Frame | TopologicalMap | TexturedMesh, *, face: Mapping[str, ArrayLike] | None = None
) -> None:
    """Write a frame or a map as PLY: vertices and faces with their signals; those of edges, in VTU, break many readers.

    Parameters
    ----------
    path : path
        Where to.
    shown : Frame, TopologicalMap or TexturedMesh
        Vertices also carry their luminance as grey ``red green blue``; those of a map their normals.
    face : dict of (F,) arrays, optional
        More columns of the triangles.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    layers = _layers(shown)
    vertex: Columns = {}
    if "luminance" in layers.vertex:
        grey = np.round(255 * np.clip(layers.vertex["luminance"], 0, 1)).astype(np.uint8)
        vertex = dict.fromkeys(("red", "green", "blue"), grey)
    if isinstance(shown, TopologicalMap):
        vertex |= dict(zip(("nx", "ny", "nz"), _normals(layers.xyz, layers.faces).T, strict=True))
    vertex, own = (
        {name: values for name, values in columns.items() if name not in _BEYOND_PLY}
        for columns in (vertex | layers.vertex, layers.face)
    )
    write_ply(path, layers.xyz, layers.faces, vertex=vertex, face={**own, **(face or {})})


def _layers(shown: Frame | TopologicalMap | TexturedMesh) -> Layers:
    if isinstance(shown, TexturedMesh):
        return _of_mesh(shown)
    return _of_map(shown) if isinstance(shown, TopologicalMap) else _of_frame(shown)


def _of_frame(frame: Frame) -> Layers:
    signals, xyz = frame.signals, frame.cloud.xyz
    vertex, edge, face = _signal_columns(signals)
    vertex |= {"depth": xyz[:, 2]} | _answer(frame.response)
    return Layers(frame.complex_, xyz, frame.surface.faces, vertex, edge, face)


def _of_mesh(mesh: TexturedMesh) -> Layers:
    wound = replace(mesh.complex_, faces=mesh.faces)
    signals = mesh.signals
    if not (signals.vertex_ok.any() or signals.edge_ok.any() or signals.face_ok.any()):
        return Layers(wound, mesh.xyz, mesh.faces, {}, {}, {})
    return Layers(wound, mesh.xyz, mesh.faces, *_signal_columns(signals))


def _of_map(map_: TopologicalMap) -> Layers:
    views = zip(_signal_columns(map_.signals), map_.view_count, map_.view_variance, strict=True)
    vertex, edge, face = (columns | {"views": count, "variance": variance} for columns, count, variance in views)
    vertex |= {"landmark_id": map_.landmark_id} | _answer(map_.response)
    vertex |= {"direction": map_.direction, "direction_spread": map_.direction_spread}
    faces = map_.surface.faces
    wound = replace(map_.complex_, faces=faces)  # so that viewers light the side that the cameras saw
    return Layers(wound, map_.xyz, faces, vertex, edge, face)


def _answer(response: Response) -> Columns:
    z = one_channel(response.z)
    shown = Response(z, response.order, response.defined)
    return {
        "response_real": np.ascontiguousarray(z.real),
        "response_imaginary": np.ascontiguousarray(z.imag),
        "magnitude": shown.magnitude,
        "phase": shown.phase,
        "defined": response.defined.astype(np.uint8),
    }


def _signal_columns(signals: Signals) -> tuple[Columns, Columns, Columns]:
    """Columns of vertices, edges and faces: what stands there, whether it is a signal, and its pixels."""
    return (
        _level(signals.vertex, signals.vertex_ok),
        _level(signals.edge, signals.edge_ok) | {"pixels": signals.edge_pixels},
        _level(signals.face, signals.face_ok) | {"pixels": signals.face_pixels},
    )


def _level(values: FloatArray, ok: NDArray[np.bool_]) -> Columns:
    return {"luminance": one_channel(values), "ok": ok.astype(np.uint8)}


def _normals(xyz: FloatArray, faces: NDArray[np.int32]) -> FloatArray:
    """Normals of the vertices, weighted with the area of their triangles; 0 where there is none."""
    a, b, c = (xyz[faces[:, i]] for i in range(3))
    normals, total = np.cross(b - a, c - a), np.zeros_like(xyz)
    for i in range(3):
        np.add.at(total, faces[:, i], normals)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0, length, 1.0))
