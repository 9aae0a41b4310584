"""What a stored mesh is: edges, boundary, parts, Euler characteristic, summed chunk by chunk and exact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .mesh import StoredMesh

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class StoreCounts:
    """What `count_store` found; each as in `tspslam.topology.diagnosis.SurfaceDiagnosis`.

    Attributes
    ----------
    vertices, used : int
        All vertices, and those that have a face.
    edges, faces : int
        Distinct sides of the faces; faces, each as often as it was given.
    boundary_edges, nonmanifold_edges : int
        Edges of one face, and of more than two.
    components : int
        Parts that share no vertex; vertices without a face do not count.
    euler : int
        ``used - edges + faces``.
    """

    vertices: int
    used: int
    edges: int
    faces: int
    boundary_edges: int
    nonmanifold_edges: int
    components: int
    euler: int


def count_store(mesh: StoredMesh) -> StoreCounts:
    """Count a stored mesh: an edge in the chunk of its lower row, whose faces are all there.

    Memory grows with the vertices by 4 bytes each, for the parts (8 from 2^31 vertices on); the rest is of one chunk.

    Parameters
    ----------
    mesh : StoredMesh
        The store's mesh.

    Returns
    -------
    StoreCounts

    Raises
    ------
    InputError
        If a chunk is damaged.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.scale import write_store
    >>> from tspslam.scale.stores.sources import of_arrays
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = write_store(f"{folder}/a.zarr", of_arrays(np.eye(4)[:, :3], [[0, 1, 2], [1, 2, 3]]))
    ...     counts = count_store(store.mesh)
    >>> counts.edges, counts.boundary_edges, counts.components, counts.euler
    (5, 4, 1, 1)
    """
    from . import _kernels

    parent = np.arange(mesh.n, dtype=mesh.arrays["face_rows"].dtype)
    is_used = np.zeros(mesh.n, bool)
    edges = boundary = nonmanifold = begin = 0
    for chunk, end in enumerate(mesh.face_end.tolist()):
        faces = mesh.read("face_rows", begin, end)
        begin = end
        is_used[faces] = True
        _kernels.join_parts(faces, parent)
        counts = _faces_at_edges(faces, chunk * mesh.chunk, (chunk + 1) * mesh.chunk)
        edges += len(counts)
        boundary += int((counts == 1).sum())
        nonmanifold += int((counts > 2).sum())
    used = int(is_used.sum())
    components = int((is_used & (parent == np.arange(mesh.n))).sum())
    euler = used - edges + mesh.n_faces
    return StoreCounts(mesh.n, used, edges, mesh.n_faces, boundary, nonmanifold, components, euler)


def _faces_at_edges(faces: NDArray[np.integer], first: int, last: int) -> Rows:
    """How many faces each edge has whose lower row is in a chunk."""
    sides = np.concatenate([faces[:, pair] for pair in ([0, 1], [1, 2], [0, 2])]).astype(np.int64)
    low, high = sides.min(axis=1), sides.max(axis=1)
    mine = (low >= first) & (low < last)
    order = np.lexsort((high[mine], low[mine]))
    ordered = np.stack([low[mine][order], high[mine][order]], axis=1)
    is_new = np.ones(len(ordered), bool)
    is_new[1:] = (ordered[1:] != ordered[:-1]).any(axis=1)
    return np.diff(np.append(np.flatnonzero(is_new), len(ordered)))
