"""Which face a picture shows at each of its pixels: a buffer of nearness."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import kernel
from ..types import FloatArray

Owners = NDArray[np.int32]
EDGE = 1e-9  # of a triangle: a pixel between two that meet is in one of them, however its place is rounded


def find_owners(corners: FloatArray, rows: NDArray[np.int64], shape: tuple[int, int]) -> Owners:
    """Find the nearest face at each pixel.

    Parameters
    ----------
    corners : (T, 3, 3) float64
        Triangles on the picture: column, row, px, and nearness, which grows toward the viewer and is affine over the
        picture: 1 / depth in perspective, minus the depth without.
    rows : (T,) int64
        Which face each is (a part) of.
    shape : (int, int)
        Height and width, px.

    Returns
    -------
    (H, W) int32
        -1 where there is none; of equally near ones the first.

    Examples
    --------
    >>> far = np.array([[0.0, 0, 1], [4, 0, 1], [0, 4, 1]])
    >>> near = np.array([[0.0, 0, 2], [1, 0, 2], [0, 1, 2]])
    >>> find_owners(np.stack([far, near]), np.array([5, 7]), (3, 4)).tolist()
    [[7, 7, 5, 5], [7, 5, 5, 5], [5, 5, 5, -1]]
    """
    owner = np.full(shape, -1, np.int32)
    _fill(np.ascontiguousarray(corners), rows, np.full(shape, -np.inf), owner)
    return owner


def cut_near(corners: FloatArray, near: float) -> tuple[FloatArray, NDArray[np.int64]]:
    """Cut off what lies nearer than `near` along z.

    Parameters
    ----------
    corners : (F, 3, 3) float64
        Triangles in the viewer's frame, m.
    near : float
        Smallest depth that stays, m.

    Returns
    -------
    corners : (T, 3, 3) float64
        What is left, in triangles.
    rows : (T,) int64
        Of which face each is.

    Examples
    --------
    >>> corners, rows = cut_near(np.array([[[0.0, 0, 2], [2, 0, 2], [0, 0, 0]]]), 1.0)
    >>> corners[..., 2].tolist(), rows.tolist()
    ([[1.0, 2.0, 2.0], [1.0, 2.0, 1.0]], [0, 0])
    """
    is_far = corners[..., 2] > near
    count = is_far.sum(axis=1)
    lone = np.where(count == 1, is_far.argmax(axis=1), (~is_far).argmax(axis=1))
    turned = np.take_along_axis(corners, ((lone[:, None] + (0, 1, 2)) % 3)[..., None], axis=1)
    whole, tip, rest = (np.flatnonzero(count == k) for k in (3, 1, 2))
    a, b, c = (turned[tip, k] for k in range(3))
    first = np.stack([a, _at_depth(a, b, near), _at_depth(a, c, near)], axis=1)
    a, b, c = (turned[rest, k] for k in range(3))
    ab, ac = _at_depth(a, b, near), _at_depth(a, c, near)
    parts = [corners[whole], first, np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(parts), np.concatenate([whole, tip, rest, rest])


def _at_depth(a: FloatArray, b: FloatArray, depth: float) -> FloatArray:
    """Where segments from (n, 3) `a` to `b` have the depth."""
    share = (depth - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    return a + share * (b - a)


@kernel
def _fill(corners, rows, buffer, owner):  # type: ignore[no-untyped-def]
    height, width = owner.shape
    for t in range(corners.shape[0]):
        x0, y0, n0 = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
        x1, y1, n1 = corners[t, 1, 0] - x0, corners[t, 1, 1] - y0, corners[t, 1, 2] - n0
        x2, y2, n2 = corners[t, 2, 0] - x0, corners[t, 2, 1] - y0, corners[t, 2, 2] - n0
        area = x1 * y2 - x2 * y1
        left, right = x0 + min(0.0, x1, x2), x0 + max(0.0, x1, x2)
        top, bottom = y0 + min(0.0, y1, y2), y0 + max(0.0, y1, y2)
        if not abs(area) > 0.0 or not (right >= 0.0 and left < width and bottom >= 0.0 and top < height):
            continue
        for row in range(int(np.ceil(max(0.0, top))), int(np.floor(min(height - 1.0, bottom))) + 1):
            for column in range(int(np.ceil(max(0.0, left))), int(np.floor(min(width - 1.0, right))) + 1):
                b1 = ((column - x0) * y2 - x2 * (row - y0)) / area
                b2 = (x1 * (row - y0) - (column - x0) * y1) / area
                if b1 < -EDGE or b2 < -EDGE or b1 + b2 > 1.0 + EDGE:
                    continue
                near = n0 + b1 * n1 + b2 * n2
                if near > buffer[row, column]:
                    buffer[row, column] = near
                    owner[row, column] = rows[t]
