"""Heat over a stored mesh: the Chebyshev polynomial of the vertices' Laplacian, term by term over all chunks.

Each term needs the one before on a chunk and on the ring around it, the halo, which is read from the vectors' files.
"""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..._files import bad_input
from ...io._folders import new_folder
from ...topology.spectral import checked_number, heat_series
from ...types import FloatArray
from . import _zarr
from .mesh import StoredMesh

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_ERROR = 1e-12  # of the polynomial, as a share of the signal: what is left for rounding of the 1e-10 that are promised


def smooth_store(mesh: StoredMesh, t: float, column: str = "luminance") -> FloatArray:
    """Let the values of a store's vertices diffuse, ``exp(-t (D - A)) s``, and keep them in it.

    Vertices without a value (NaN) stand alone and stay so. To 1e-10 what `tspslam.heat_filter` gives of the whole with
    `tspslam.unsigned_laplacian`; on disk 24 bytes a vertex and 12 a neighbour are taken while it works. The values
    stay in the store's array ``heat/COLUMN-T`` by rows; a second call gives them as they are.

    Parameters
    ----------
    mesh : StoredMesh
        The store's mesh.
    t : float
        Time, >= 0.
    column : str
        ``luminance``.

    Returns
    -------
    (N,) float64
        By rows, all in memory: `StoredMesh.read` of ``id`` tells whose they are.

    Raises
    ------
    InputError
        If there are no such values, t is no time, or a chunk is damaged.
    OutputError
        If the system refuses.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.scale import write_store
    >>> from tspslam.scale.stores.sources import of_arrays
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = write_store(f"{folder}/a.zarr", of_arrays(np.eye(3), [[0, 1, 2]], luminance=[3, 0, 0]))
    ...     smooth_store(store.mesh, 1e3).round(9).tolist()
    [1.0, 1.0, 1.0]
    """
    time = checked_number(t, "t")
    if column != "luminance" or column not in mesh.arrays:
        raise bad_input(mesh.path, f"has no values {column!r:.40}", "luminance of the vertices")
    name = f"{column}-{time!r}"
    _zarr.zarr().open_group(str(mesh.path), mode="r+", zarr_format=3).require_group("heat")
    target = mesh.path / "heat" / name
    if not target.exists():
        with new_folder(target) as folder:
            _fill(folder, mesh, time, column)
    array = _zarr.opened(target, "values", "r")
    _zarr.check_whole(array)
    return _zarr.read(array, 0, mesh.n)


def _fill(folder: Path, mesh: StoredMesh, time: float, column: str) -> None:
    work = folder / "unsorted"
    work.mkdir()
    values = _vector(work / "out", mesh.n)
    degree = 0
    for first, last in _chunks(mesh):
        values[first:last] = mesh.read(column, first, last)
    for k, (first, last) in enumerate(_chunks(mesh)):
        degree = max(degree, _keep_neighbours(work, mesh, k, first, last, values))
    half = float(max(degree, 1))  # no eigenvalue of D - A exceeds twice the largest degree
    _diffuse(work, mesh, half, heat_series(half, time, _ERROR), values)
    array = _zarr.create(
        _zarr.zarr().open_group(str(folder), mode="a", zarr_format=3), "values", (mesh.n,), np.float64, mesh.chunk
    )
    for first, last in _chunks(mesh):
        _zarr.write(array, first, np.asarray(values[first:last]))
    shutil.rmtree(work)


def _chunks(mesh: StoredMesh) -> list[tuple[int, int]]:
    return [(first, min(first + mesh.chunk, mesh.n)) for first in range(0, mesh.n, mesh.chunk)]


def _vector(path: Path, n: int) -> Any:
    return np.memmap(path, np.float64, "w+", shape=(n,))


def _keep_neighbours(work: Path, mesh: StoredMesh, k: int, first: int, last: int, values: Any) -> int:
    """Write who the neighbours of a chunk's vertices are, by rows; the largest degree."""
    begin = int(mesh.face_end[k - 1]) if k else 0
    faces = mesh.read("face_rows", begin, int(mesh.face_end[k])).astype(np.int64)
    ends = np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 0], [1, 2], [2, 1], [0, 2], [2, 0])])
    ends = ends[(ends[:, 0] >= first) & (ends[:, 0] < last)]
    ends = ends[np.isfinite(values[ends]).all(axis=1)]
    ends = np.unique(ends, axis=0)
    np.save(work / f"{k}-start.npy", np.searchsorted(ends[:, 0], np.arange(first, last + 1)))
    np.save(work / f"{k}-rows.npy", ends[:, 1])
    return int(np.bincount(ends[:, 0] - first).max(initial=0))


def _diffuse(work: Path, mesh: StoredMesh, half: float, series: FloatArray, out: Any) -> None:
    """``Σ c_k T_k(L / half - 1) s``, in the place of s."""
    now, before = _vector(work / "now", mesh.n), _vector(work / "before", mesh.n)
    for first, last in _chunks(mesh):
        now[first:last] = out[first:last]
        out[first:last] *= series[0]
    for k in range(1, len(series)):
        factor = (1 if k == 1 else 2) / half
        for c, (first, last) in enumerate(_chunks(mesh)):
            L, rows = _laplacian(work, c, first, last)
            around = np.concatenate([now[first:last], now[rows]])
            term = factor * (_times(L, around) - half * now[first:last]) - before[first:last]
            before[first:last] = term
            out[first:last] += series[k] * term
        now, before = before, now


def _times(L: csr_array, values: FloatArray) -> FloatArray:
    return np.asarray(L @ values, np.float64)


def _laplacian(work: Path, chunk: int, first: int, last: int) -> tuple[csr_array, NDArray[np.int64]]:
    """Rows of D - A over a chunk's vertices, then those around it; and who these are."""
    from scipy.sparse import csr_array, diags_array, hstack

    start, rows = np.load(work / f"{chunk}-start.npy"), np.load(work / f"{chunk}-rows.npy")
    is_outside = (rows < first) | (rows >= last)
    outside = np.unique(rows[is_outside])
    column = rows - first
    column[is_outside] = last - first + np.searchsorted(outside, rows[is_outside])
    n = last - first
    A = csr_array((np.ones(len(rows)), column, start), shape=(n, n + len(outside)))
    D = hstack([diags_array(np.diff(start).astype(np.float64)), csr_array((n, len(outside)))])
    return csr_array(D - A), outside
