"""Regions of a stored mesh, chunk by chunk: a region ends where its chunk does, or its image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...apps.segment import segment
from ...io._folders import new_folder
from ...topology.complex import build_complex
from ...types import Signals
from . import _zarr
from .mesh import StoredMesh
from .tiled_filter import image_parts, signals_of

Labels = NDArray[np.int64]


def segment_store(mesh: StoredMesh, scale: float = 1.0) -> Labels:
    """Group the faces of a store into regions by luminance and shape, those of each chunk by themselves.

    A face belongs to the chunk of its lowest row, and to the image of that row. The labels stay in the store's array
    ``segments/SCALE``; a second call gives them as they are.

    Parameters
    ----------
    mesh : StoredMesh
        The store's mesh.
    scale : float
        As `tspslam.segment`.

    Returns
    -------
    (M,) int64
        A label for each row of ``face_rows``, 0 to k - 1 over all chunks; -1 for copies of faces in other chunks.

    Raises
    ------
    InputError
        As `tspslam.segment`, or if a chunk or an image is damaged.
    OutputError
        If the system refuses.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam.scale import write_store
    >>> from tspslam.scale.stores.sources import of_arrays
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     store = write_store(f"{folder}/a.zarr", of_arrays(np.eye(3), [[0, 1, 2]], luminance=[1, 1, 1]))
    ...     segment_store(store.mesh).tolist()
    [0]
    """
    _zarr.zarr().open_group(str(mesh.path), mode="r+", zarr_format=3).require_group("segments")
    target, total = mesh.path / "segments" / repr(float(scale)), mesh.arrays["face_id"].shape[0]
    if not target.exists():
        with new_folder(target) as folder:
            group = _zarr.zarr().open_group(str(folder), mode="a", zarr_format=3)
            array = _zarr.create(group, "labels", (total,), np.int64, 2 * mesh.chunk)
            begin = count = 0
            for chunk, end in enumerate(mesh.face_end.tolist()):
                labels = _labels_of(mesh, chunk, mesh.read("face_rows", begin, end), scale, count)
                count = max(count, int(labels.max(initial=-1)) + 1)
                if len(labels):
                    _zarr.write(array, begin, labels)
                begin = end
    array = _zarr.opened(target, "labels", "r")
    _zarr.check_whole(array)
    return _zarr.read(array, 0, total)


def _labels_of(mesh: StoredMesh, chunk: int, faces: NDArray[Any], scale: float, count: int) -> Labels:
    """Labels of a chunk's faces, from `count` on; -1 for those of other chunks."""
    labels = np.full(len(faces), -1, np.int64)
    first, last = chunk * mesh.chunk, min((chunk + 1) * mesh.chunk, mesh.n)
    lowest = faces.min(axis=1, initial=mesh.n)
    for low, high, image in image_parts(mesh, first, last, mesh.chunk):
        mine = np.flatnonzero((lowest >= low) & (lowest < high))
        if len(mine):
            labels[mine] = count + _regions(mesh, faces[mine], low, high, image, scale)
            count = int(labels[mine].max()) + 1
    return labels


def _regions(mesh: StoredMesh, faces: NDArray[Any], first: int, last: int, image: int, scale: float) -> Labels:
    outside = np.unique(faces[faces >= last]).astype(np.int64)
    local = np.where(faces < last, faces - first, last - first + np.searchsorted(outside, faces))
    columns = {
        name: _zarr.read_around(mesh.arrays[name], first, last, outside)
        for name in ("xyz", "uv", "luminance")
        if name in mesh.arrays
    }
    complex_ = build_complex(local, last - first + len(outside))
    signals: Signals | None = signals_of(mesh, complex_, image, columns)
    found = segment(complex_, signals, scale=scale, xyz=columns["xyz"]).astype(np.int64)
    if len(found) == len(local):
        return found
    _, place = np.unique(np.sort(local, axis=1), axis=0, return_inverse=True)  # faces that were given twice
    order = np.unique(np.sort(complex_.faces, axis=1), axis=0, return_index=True)[1]
    return found[order][place.ravel()]
