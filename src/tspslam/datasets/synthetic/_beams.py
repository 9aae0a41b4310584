"""Compiled loop of the scanner: beams cast from one place at triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..._jit import kernel

Float64 = NDArray[np.float64]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]

_PARALLEL = 1e-12  # of a beam's cosine with a triangle's plane, times areas


@kernel
def cast_beams(corners: Float64, beams: Float64, boxes: Int64, nearest: Float64, owner: Int32) -> None:
    """Find the nearest triangle on each beam (rows, columns, 3): its number in `owner`, the distance in `nearest`.

    Triangle t lies within rows ``boxes[t, 0]`` to ``boxes[t, 1]`` and columns ``boxes[t, 2]`` to ``boxes[t, 3]``, the
    last ones not included; columns go on around the turn.
    """
    columns = beams.shape[1]
    for t in range(corners.shape[0]):
        a = corners[t, 0]
        p0, p1, p2 = corners[t, 1, 0] - a[0], corners[t, 1, 1] - a[1], corners[t, 1, 2] - a[2]
        q0, q1, q2 = corners[t, 2, 0] - a[0], corners[t, 2, 1] - a[1], corners[t, 2, 2] - a[2]
        n0, n1, n2 = p1 * q2 - p2 * q1, p2 * q0 - p0 * q2, p0 * q1 - p1 * q0
        off = n0 * a[0] + n1 * a[1] + n2 * a[2]
        for row in range(boxes[t, 0], boxes[t, 1]):
            for place in range(boxes[t, 2], boxes[t, 3]):
                column = place % columns
                d = beams[row, column]
                along = n0 * d[0] + n1 * d[1] + n2 * d[2]
                if abs(along) <= _PARALLEL:
                    continue
                distance = off / along
                if not 0 < distance < nearest[row, column]:
                    continue
                # d x a, against both sides: the beam's barycentric coordinates (Moller and Trumbore 1997)
                m0, m1, m2 = d[1] * a[2] - d[2] * a[1], d[2] * a[0] - d[0] * a[2], d[0] * a[1] - d[1] * a[0]
                u = -(m0 * q0 + m1 * q1 + m2 * q2) / along
                v = (m0 * p0 + m1 * p1 + m2 * p2) / along
                if u >= 0 and v >= 0 and u + v <= 1:
                    nearest[row, column] = distance
                    owner[row, column] = t
