"""What hides a vertex from the camera of its image: the depth buffer of all faces of a store, drawn chunk by chunk."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray
from ...vision.rig import project
from . import _zarr
from ._last import LastMade
from .halo import faces_of
from .images import ImageReference
from .mesh import StoredMesh

_BESIDE = 1.0  # px around an image in which a chunk is drawn all the same: far more than rounding
_BOXES = "_boxes"  # among what an opened store keeps


def seen_places(store: StoredMesh, image: int, xyz: FloatArray, tolerance: float) -> FloatArray:
    """Where vertices fall in an image with a camera; NaN also for those that a face of the store hides.

    The same bits as `tspslam.visible_uv` over the whole mesh: the nearest of all faces does not depend on their order.

    Parameters
    ----------
    store : StoredMesh
        The store.
    image : int
        Its image, which has a camera.
    xyz : (N, 3) float64
        Vertices, m.
    tolerance : float
        Share of its depth by which a seen vertex may lie behind the nearest face.

    Returns
    -------
    (N, 2) float64
        px.

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    from ...vision._visibility import hide

    buffer = _kept_depths(store, image)
    points = store.images[image].in_camera(xyz)
    uv = project(store.images[image].camera, points)
    hide(uv, points[:, 2], 1 + tolerance, buffer)
    return uv


def _kept_depths(store: StoredMesh, image: int) -> NDArray[np.float32]:
    """The buffer of an image; a thread keeps its last one, since the tiles of an image follow each other."""
    # With the store: as long as that is kept, no other one has its id.
    return _kept.get((store.path, image, id(store)), lambda: (store, draw_depths(store, image)))[1]


_kept: LastMade[tuple[StoredMesh, NDArray[np.float32]]] = LastMade()


def draw_depths(store: StoredMesh, image: int) -> NDArray[np.float32]:
    """Draw the nearest face at each pixel of an image, of those chunks that may be in it.

    Parameters
    ----------
    store : StoredMesh
        The store.
    image : int
        Its image, which has a camera.

    Returns
    -------
    (H, W) float32
        1 / z, 1/m; 0 where there is no face.

    Raises
    ------
    InputError
        If a chunk is damaged.
    """
    from ...vision._visibility import draw_faces

    reference = store.images[image]
    rig = reference.camera
    buffer = np.zeros((rig.height, rig.width), np.float32)
    for chunk in np.flatnonzero(_may_be_in(reference, _boxes(store))).tolist():
        xyz, faces = _load(store, chunk)
        points = reference.in_camera(xyz)
        draw_faces(project(rig, points), points[:, 2], faces, buffer)
    return buffer


def _load(store: StoredMesh, chunk: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """The faces that touch a chunk, and the places of their corners."""
    from . import _kernels

    first, last = chunk * store.chunk, min((chunk + 1) * store.chunk, store.n)
    faces = faces_of(store, np.arange(first, last))[0]
    outside = np.unique(_kernels.rows_outside(faces, first, last))
    place = np.arange(last - first + len(outside), dtype=np.int32)
    local = _kernels.local_faces(faces, np.arange(len(faces)), first, last, outside, place)
    return _zarr.read_around(store.arrays["xyz"], first, last, outside), local.astype(np.int64)


def _boxes(store: StoredMesh) -> FloatArray:
    """Boxes around the faces that touch each chunk, (chunks, 2, 3), m; found once for each store that is opened."""
    kept = vars(store)
    if _BOXES not in kept:
        corners = (_load(store, chunk)[0] for chunk in range(len(store.face_end)))
        kept[_BOXES] = np.array([(xyz.min(axis=0), xyz.max(axis=0)) for xyz in corners])
    boxes: FloatArray = kept[_BOXES]
    return boxes


def _may_be_in(reference: ImageReference, boxes: FloatArray) -> NDArray[np.bool_]:
    """Whether something in each box may be drawn: not if all of it is behind the camera, or beside one border.

    A box whose corners are all before the camera projects into the hull of theirs.
    """
    corner = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    points = np.stack([boxes[:, corner[:, axis], axis] for axis in range(3)], axis=-1)  # (chunks, 8, 3)
    turned = reference.in_camera(points.reshape(-1, 3))
    rig, is_before = reference.camera, (turned[:, 2] > 0).reshape(-1, 8)
    u, v = project(rig, turned).T.reshape(2, -1, 8)
    sides = (u < -_BESIDE, u > rig.width - 1 + _BESIDE, v < -_BESIDE, v > rig.height - 1 + _BESIDE)
    is_beside = np.logical_or.reduce([side.all(axis=1) for side in sides])
    return is_before.any(axis=1) & ~(is_before.all(axis=1) & is_beside)
