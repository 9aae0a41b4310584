"""A map or a frame as one npz under the names of PyTorch Geometric and TopoModelX: loaded by NumPy alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import require
from .._files import PathLike
from .._npz import Arrays, Schema
from ..errors import InputError
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..topology.complex import Complex
from ..types import Response, Signals
from ._form import Form, read_arrays, write_arrays

_LEVELS = ("vertex", "edge", "face")


def write_tensors(path: PathLike, shown: Frame | TopologicalMap) -> None:
    """Write a map or a frame as an npz that needs none of us to be read; equal ones give equal bytes.

    Parameters
    ----------
    path : str or path
        The file to write.
    shown : Frame or TopologicalMap
        What `tensors_of` takes.

    Raises
    ------
    InputError
        If it is neither, or its arrays do not fit each other.
    OutputError
        If the file cannot be written.
    """
    write_arrays(path, _FORM, tensors_of(shown))


def read_tensors(path: PathLike) -> Arrays:
    """Read what `write_tensors` wrote, every array checked; ``numpy.load`` does without the checks.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    dict of str to array
        As `tensors_of` gives them.

    Raises
    ------
    InputError
        If the file is no such npz, of another version or damaged.
    """
    return read_arrays(path, _FORM, lambda arrays: {k: v for k, v in arrays.items() if k not in ("magic", "version")})


def tensors_of(shown: Frame | TopologicalMap) -> Arrays:
    """Give a map or a frame as plain arrays, under the names of PyTorch Geometric where that has one.

    Parameters
    ----------
    shown : Frame or TopologicalMap
        N vertices, E edges, F faces, signals of C channels (C = 1 for signals of shape (n,)).

    Returns
    -------
    dict of str to array
        Those of `arrays_of_complex`, and

        pos : (N, 3) float32
            Places, m: of a map in the world, of a frame in the camera's frame.
        face_wound : (3, F) int64
            ``face`` wound so that normals look at the cameras.
        response : (N, C) complex64, response_ok : (N,) bool
            The filter's answer; 0 where there is none.
        landmark_id : (N,) int64
            Numbers of the landmarks; -1 for none.
        keyframe : (K,) int64, T_world_camera : (K, 4, 4) float64
            Numbers of the frames, and the poses of the left camera, m; of a frame its own.
        intrinsics : (5,) float64
            ``fx, fy, cx, cy``, px, and the baseline, m.
        observation_index : (2, M) int64, observation_uv : (M, 2) float32
            Vertex and row of ``keyframe`` of each observation, and where in that image, px.
        observation_disparity : (M,) float32, observation_disparity_ok : (M,) bool
            Its disparity, px; 0 where none was measured.

        Of a map alone:

        views_0, views_1, views_2 : (N,), (E,), (F,) int32
            How many keyframes each signal is a mean of.
        variance_0, variance_1, variance_2 : (N, C), (E, C), (F, C) float32
            Its variance over them.
        direction : (N, 3) float32
            Unit tangent along which the luminance grows; 0 where ``response_ok`` is False.
        covariance : (N, 3, 3) float32
            Of the places, m².

    Raises
    ------
    InputError
        If it is neither a map nor a frame.

    Examples
    --------
    >>> from tspslam import Session, datasets
    >>> arrays = tensors_of(Session(datasets.motorcycle().rig).process(datasets.motorcycle()))
    >>> E = len(arrays["x_1"])
    >>> arrays["edge_index"].shape == (2, 2 * E), arrays["B1_index"].shape == (2, 2 * E)
    (True, True)
    """
    if not isinstance(shown, TopologicalMap):
        require(shown, Frame, "what is written")
    shared = arrays_of_complex(shown.complex_, shown.signals)
    rig = shown.rig
    shared |= {
        "face_wound": shown.surface.faces.T.astype(np.int64),
        **_answer(shown.response),
        "intrinsics": np.array([rig.fx, rig.fy, rig.cx, rig.cy, rig.baseline]),
    }
    return shared | (_of_map(shown) if isinstance(shown, TopologicalMap) else _of_frame(shown))


def arrays_of_complex(complex_: Complex, signals: Signals) -> Arrays:
    """Give a complex and its signals as plain arrays; `tspslam.interop.to_pyg` has them as tensors.

    Parameters
    ----------
    complex_ : Complex
        N vertices, E edges, F faces; polygons will do.
    signals : Signals
        Its signals, of C channels (C = 1 for signals of shape (n,)).

    Returns
    -------
    dict of str to array
        x : (N, C) float32
            Vertex signals; ``x_0`` is the same.
        edge_index : (2, 2E) int64
            Both directions of every edge: column k is edge k from i to j > i, column E + k the same from j to i.
        edge_attr : (2E, C) float32
            Edge signals of those columns.
        face : (3, F) int64
            Vertices of each triangle, ascending. Absent for polygons.
        x_0, x_1, x_2 : (N, C), (E, C), (F, C) float32
            Signals of vertices, edges and faces; 0 where there is none.
        ok_0, ok_1, ok_2 : (N,), (E,), (F,) bool
            False where there is no signal.
        B1_index : (2, 2E) int64, B1_sign : (2E,) int8, B1_shape : (2,) int64
            Incidence matrix of vertices and edges: rows and columns of its entries, which are ±1; by rows.
        B2_index : (2, 3F) int64, B2_sign : (3F,) int8, B2_shape : (2,) int64
            That of edges and faces.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> disc = build_complex([[0, 1, 2]], 3)
    >>> arrays = arrays_of_complex(disc, sample_signals(np.eye(9), [[1.0, 1], [8, 2], [3, 7]], disc))
    >>> arrays["B2_index"].tolist(), arrays["B2_sign"].tolist()
    ([[0, 1, 2], [0, 0, 0]], [1, -1, 1])
    """
    x_0, x_1, x_2 = (_features(getattr(signals, level)) for level in _LEVELS)
    forward = complex_.edges.T.astype(np.int64)
    made: dict[str, NDArray[Any]] = {
        "x": x_0,
        "edge_index": np.concatenate([forward, forward[::-1]], axis=1),
        "edge_attr": np.concatenate([x_1, x_1]),
        "x_0": x_0, "x_1": x_1, "x_2": x_2,
    }  # fmt: skip
    if isinstance(complex_.faces, np.ndarray):
        made["face"] = complex_.faces.T.astype(np.int64)
    made |= {f"ok_{k}": getattr(signals, f"{level}_ok").copy() for k, level in enumerate(_LEVELS)}
    return made | _entries("B1", complex_.B1) | _entries("B2", complex_.B2)


def _of_map(map_: TopologicalMap) -> Arrays:
    seen = map_.observations
    rows = {f"views_{k}": values for k, values in enumerate(map_.view_count)}
    rows |= {f"variance_{k}": _features(values) for k, values in enumerate(map_.view_variance)}
    return rows | {
        "pos": map_.xyz.astype(np.float32),
        "direction": map_.direction.astype(np.float32),
        "covariance": map_.covariance.astype(np.float32),
        "landmark_id": map_.landmark_id,
        "keyframe": map_.keyframes,
        "T_world_camera": map_.T_world_camera,
        "observation_index": np.stack([seen.vertex, seen.keyframe]),
        **_measured(seen.uv, seen.disparity),
    }


def _of_frame(frame: Frame) -> Arrays:
    """Of a frame each vertex with a place in the image is an observation."""
    cloud, count = frame.cloud, len(frame.cloud)
    seen = np.flatnonzero(np.isfinite(cloud.uv).all(axis=1))
    return {
        "pos": cloud.xyz.astype(np.float32),
        "landmark_id": np.full(count, -1) if frame.landmark is None else frame.landmark.astype(np.int64),
        "keyframe": np.array([frame.index]),
        "T_world_camera": np.asarray(frame.T_world_camera, np.float64)[None],
        "observation_index": np.stack([seen, np.zeros_like(seen)]),
        **_measured(cloud.uv[seen], cloud.disparity[seen]),
    }


def _measured(uv: NDArray[Any], disparity: NDArray[Any]) -> Arrays:
    ok = np.isfinite(disparity)
    return {
        "observation_uv": uv.astype(np.float32),
        "observation_disparity": np.where(ok, disparity, 0.0).astype(np.float32),
        "observation_disparity_ok": ok,
    }


def _answer(response: Response) -> Arrays:
    z = response.z if response.z.ndim == 2 else response.z[:, None]
    return {"response": z.astype(np.complex64), "response_ok": response.defined}


def _features(values: NDArray[Any]) -> NDArray[np.float32]:
    """An (n,) or (n, C) signal as (n, C)."""
    return (values if values.ndim == 2 else values[:, None]).astype(np.float32)


def _entries(name: str, matrix: Any) -> Arrays:
    entries = matrix.tocoo()
    return {
        f"{name}_index": np.stack([entries.row, entries.col]).astype(np.int64),
        f"{name}_sign": entries.data.astype(np.int8),
        f"{name}_shape": np.array(matrix.shape, np.int64),
    }


def _check(arrays: Arrays, lengths: dict[str, tuple[int, ...]]) -> None:
    """Hold sizes against each other that letters cannot: entries of matrices, both directions of edges."""
    (n,), (e,), (f,) = (lengths[letter] for letter in "nef")
    shapes = {"B1_shape": (n, e), "B2_shape": (e, f)}
    wrong = [name for name, shape in shapes.items() if tuple(arrays[name].tolist()) != shape]
    if wrong or lengths["d"] != (2 * e,) or lengths["t"] != (3 * f,):
        raise InputError(f"has {wrong[0] if wrong else 'entries'} that do not fit {n} vertices, {e} edges, {f} faces")


# Letters are sizes that must agree: n vertices, e edges, f faces, d and t twice and three times as many, c channels,
# k keyframes, m observations.
_SCHEMA: Schema = {
    "x": ("<f4", ("n", "c")),
    "pos": ("<f4", ("n", 3)),
    "edge_index": ("<i8", (2, "d")),
    "edge_attr": ("<f4", ("d", "c")),
    "face": ("<i8", (3, "f")),
    "face_wound": ("<i8", (3, "f")),
    **{f"x_{k}": ("<f4", (size, "c")) for k, size in enumerate("nef")},
    **{f"ok_{k}": ("|b1", (size,)) for k, size in enumerate("nef")},
    "B1_index": ("<i8", (2, "d")),
    "B1_sign": ("|i1", ("d",)),
    "B1_shape": ("<i8", (2,)),
    "B2_index": ("<i8", (2, "t")),
    "B2_sign": ("|i1", ("t",)),
    "B2_shape": ("<i8", (2,)),
    "response": ("<c8", ("n", "c")),
    "response_ok": ("|b1", ("n",)),
    "landmark_id": ("<i8", ("n",)),
    "keyframe": ("<i8", ("k",)),
    "T_world_camera": ("<f8", ("k", 4, 4)),
    "intrinsics": ("<f8", (5,)),
    "observation_index": ("<i8", (2, "m")),
    "observation_uv": ("<f4", ("m", 2)),
    "observation_disparity": ("<f4", ("m",)),
    "observation_disparity_ok": ("|b1", ("m",)),
    **{f"views_{k}": ("<i4", (size,)) for k, size in enumerate("nef")},
    **{f"variance_{k}": ("<f4", (size, "c")) for k, size in enumerate("nef")},
    "direction": ("<f4", ("n", 3)),
    "covariance": ("<f4", ("n", 3, 3)),
}
_OF_MAPS = frozenset(name for name in _SCHEMA if name.startswith(("views_", "variance_", "direction", "covariance")))
_FORM = Form("tensors", 1, _SCHEMA, "it is to be exported anew", _check, optional=_OF_MAPS)
