"""Compiled loops of the depth buffer, which holds 1 / z: it is linear over the image of a plane."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .._jit import inlined, kernel

Float32 = NDArray[np.float32]
Float64 = NDArray[np.float64]
Int64 = NDArray[np.int64]


@inlined
def _is_inside(uv: Float64, height: int, width: int) -> bool:
    return 0 <= uv[0] <= width - 1 and 0 <= uv[1] <= height - 1


@kernel
def draw_points(uv: Float64, z: Float64, radius: int, buffer: Float32) -> None:
    """Draw each point of the image as a square."""
    height, width = buffer.shape
    for i in range(uv.shape[0]):
        if not _is_inside(uv[i], height, width):
            continue
        x, y, inverse = int(uv[i, 0] + 0.5), int(uv[i, 1] + 0.5), np.float32(1 / z[i])
        for row in range(max(0, y - radius), min(height, y + radius + 1)):
            for column in range(max(0, x - radius), min(width, x + radius + 1)):
                buffer[row, column] = max(buffer[row, column], inverse)


@kernel
def draw_faces(uv: Float64, z: Float64, faces: Int64, buffer: Float32) -> None:
    """Draw each triangle whose corners all lie in front of the camera: at each pixel centre in it, its depth there."""
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        if np.isfinite(uv[a, 0]) and np.isfinite(uv[b, 0]) and np.isfinite(uv[c, 0]):
            _draw_face(uv[a], uv[b], uv[c], 1 / z[a], 1 / z[b], 1 / z[c], buffer)


@inlined
def _span(a: float, b: float, c: float, size: int) -> tuple[int, int]:
    """First pixel centre between the least and the largest of three, and the one after the last, within the image."""
    first = min(max(0.0, np.ceil(min(a, b, c))), size)
    return int(first), int(max(first, min(size - 1.0, np.floor(max(a, b, c))) + 1))


@inlined
def _draw_face(a: Float64, b: Float64, c: Float64, at_a: float, at_b: float, at_c: float, buffer: Float32) -> None:
    height, width = buffer.shape
    area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    top, bottom = _span(a[1], b[1], c[1], height)
    left, right = _span(a[0], b[0], c[0], width)
    if area != 0:
        for row in range(top, bottom):
            for column in range(left, right):
                p = ((column - a[0]) * (c[1] - a[1]) - (row - a[1]) * (c[0] - a[0])) / area
                q = ((b[0] - a[0]) * (row - a[1]) - (b[1] - a[1]) * (column - a[0])) / area
                if p >= 0 and q >= 0 and p + q <= 1:
                    inverse = np.float32(at_a + p * (at_b - at_a) + q * (at_c - at_a))
                    buffer[row, column] = max(buffer[row, column], inverse)


@kernel
def hide(uv: Float64, z: Float64, margin: float, buffer: Float32) -> None:
    """Make NaN of each point that is farther than `margin` times the depth in the buffer."""
    height, width = buffer.shape
    for i in range(uv.shape[0]):
        if _is_inside(uv[i], height, width) and z[i] * buffer[int(uv[i, 1] + 0.5), int(uv[i, 0] + 0.5)] > margin:
            uv[i, 0], uv[i, 1] = np.nan, np.nan
