"""Compiled loops of the depth buffer: which face of the map a camera sees at each pixel, and which vertices."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

NEAREST = 1e-3  # m: faces are drawn from there on


@inlined
def _cross(a, b, out):  # type: ignore[no-untyped-def]
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inlined
def _extend(a, b, box):  # type: ignore[no-untyped-def]
    """Extend (left, right, top, bottom) by the part of a side that lies before the camera."""
    for share in (0.0, 1.0):
        z = a[2] + share * (b[2] - a[2])
        if z < NEAREST:
            if max(a[2], b[2]) <= NEAREST:
                continue
            share = (NEAREST - a[2]) / (b[2] - a[2])
            z = NEAREST
        u, v = (a[0] + share * (b[0] - a[0])) / z, (a[1] + share * (b[1] - a[1])) / z
        box[0], box[1], box[2], box[3] = min(box[0], u), max(box[1], u), min(box[2], v), max(box[3], v)


@inlined
def _narrow(e, row, span):  # type: ignore[no-untyped-def]
    """Narrow the columns of a row to those where an edge function is not negative."""
    at, slope = e[1] * row + e[2], e[0]
    if slope > 0.0:
        span[0] = max(span[0], np.ceil(-at / slope))
    elif slope < 0.0:
        span[1] = min(span[1], np.floor(-at / slope))
    elif at < 0.0:
        span[1] = -1.0


@kernel
def draw(points, faces, buffer, owner):  # type: ignore[no-untyped-def]
    """Draw faces into a depth buffer of 1 / z, and note which face each pixel shows; -1 where none.

    `points` (N, 3) are ``K X`` of each vertex: (u z, v z, z). A pixel's ray is within a face where the three edge
    functions have one sign (Olano and Greer 1997), so that faces may reach behind the camera.
    """
    height, width = buffer.shape
    e0, e1, e2, box, span = np.empty(3), np.empty(3), np.empty(3), np.empty(4), np.empty(2)
    for f in range(faces.shape[0]):
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        box[0], box[1], box[2], box[3] = np.inf, -np.inf, np.inf, -np.inf
        _extend(a, b, box)
        _extend(b, c, box)
        _extend(c, a, box)
        if not (box[0] <= width - 1 and box[1] >= 0.0 and box[2] <= height - 1 and box[3] >= 0.0):
            continue
        _cross(b, c, e0)
        _cross(c, a, e1)
        _cross(a, b, e2)
        det = a[0] * e0[0] + a[1] * e0[1] + a[2] * e0[2]
        if det == 0.0:
            continue
        for k in range(3):
            e0[k], e1[k], e2[k] = e0[k] / det, e1[k] / det, e2[k] / det
        along, down, start = e0[0] + e1[0] + e2[0], e0[1] + e1[1] + e2[1], e0[2] + e1[2] + e2[2]
        for row in range(int(max(0.0, np.ceil(box[2]))), int(min(height - 1.0, np.floor(box[3]))) + 1):
            span[0], span[1] = max(0.0, np.ceil(box[0])), min(width - 1.0, np.floor(box[1]))
            _narrow(e0, row, span)
            _narrow(e1, row, span)
            _narrow(e2, row, span)
            if not span[0] <= span[1]:
                continue
            for column in range(int(span[0]), int(span[1]) + 1):
                near = along * column + down * row + start
                if near > buffer[row, column]:
                    buffer[row, column] = near
                    owner[row, column] = f


@kernel
def count_front(points, faces, owner, front, counts):  # type: ignore[no-untyped-def]
    """Add to `counts` the pixels that show a face whose front the camera sees.

    A face narrower than a pixel may have no pixel centre: it counts once where its middle's pixel shows nothing, or a
    face that shares a corner with it.
    """
    height, width = owner.shape
    for row in range(height):
        for column in range(width):
            f = owner[row, column]
            if f >= 0 and front[f]:
                counts[f] += 1
    for f in range(faces.shape[0]):
        if counts[f] > 0 or not front[f]:
            continue
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        if not (a[2] > NEAREST and b[2] > NEAREST and c[2] > NEAREST):
            continue
        ua, va, ub, vb = a[0] / a[2], a[1] / a[2], b[0] / b[2], b[1] / b[2]
        uc, vc = c[0] / c[2], c[1] / c[2]
        u, v = (ua + ub + uc) / 3.0, (va + vb + vc) / 3.0
        area = abs((ub - ua) * (vc - va) - (vb - va) * (uc - ua))  # twice that of the face
        longest = max(np.hypot(ub - ua, vb - va), np.hypot(uc - ub, vc - vb), np.hypot(ua - uc, va - vc))
        if area >= max(longest, 2.0) or not (0.0 <= u <= width - 1 and 0.0 <= v <= height - 1):
            continue
        g = owner[int(v + 0.5), int(u + 0.5)]
        for k in range(3):
            corner = faces[f, k]
            if g < 0 or faces[g, 0] == corner or faces[g, 1] == corner or faces[g, 2] == corner:
                counts[f] = 1


@kernel
def hide(points, faces, owner, margin, rows, hidden_by):  # type: ignore[no-untyped-def]
    """Face that hides each vertex of `rows`, nearer by more than `margin` m; -1 if none does, -2 out of view."""
    height, width = owner.shape
    e0, e1, e2 = np.empty(3), np.empty(3), np.empty(3)
    for r in range(rows.shape[0]):
        i = rows[r]
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        hidden_by[r] = -2
        if not z > 0.0:
            continue
        u, v = x / z, y / z
        if not (-0.5 <= u < width and -0.5 <= v < height):
            continue
        f = owner[min(int(v + 0.5), height - 1), min(int(u + 0.5), width - 1)]
        hidden_by[r] = -1
        if f < 0 or faces[f, 0] == i or faces[f, 1] == i or faces[f, 2] == i:
            continue
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        _cross(b, c, e0)
        _cross(c, a, e1)
        _cross(a, b, e2)
        det = a[0] * e0[0] + a[1] * e0[1] + a[2] * e0[2]
        near = ((e0[0] + e1[0] + e2[0]) * u + (e0[1] + e1[1] + e2[1]) * v + e0[2] + e1[2] + e2[2]) / det
        if near > 0.0 and 1.0 / near < z - margin[r]:
            hidden_by[r] = f
