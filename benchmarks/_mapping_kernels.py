"""Compiled loops behind the measures of a map: rays of a camera against its triangles.

A triangle has corners ``v`` in the camera's frame. Its edge functions are ``e_k = v_{k+1} × v_{k+2}``, turned so that
the direction r meets the triangle's plane in front of the camera where ``Σ e_k · r > 0``, and inside of it where all
``e_k · r >= 0``: at ``t r`` with ``t = det(v) / Σ e_k · r``. That holds too for triangles that reach behind the camera.
"""

from __future__ import annotations

import numpy as np

from tspslam._jit import inlined, kernel

_NEAR = 1e-3  # m; what is nearer does not widen a triangle's box
_SAME = 1e-6  # of depth; faces that touch one another meet a ray there within rounding


@inlined
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@inlined
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _edge_functions(a, b, c, e):
    """Fill e (3, 3), and return six times the volume below the triangle, not negative."""
    _cross(b, c, e[0])
    _cross(c, a, e[1])
    _cross(a, b, e[2])
    volume = _dot(a, e[0])
    if volume < 0:
        e[:] = -e
        volume = -volume
    return volume


@inlined
def _box(corners, lens, box):
    """Fill in the least and largest column and row of the part of a triangle before the camera; False without one."""
    box[0], box[1], box[2], box[3] = 1e9, -1e9, 1e9, -1e9
    for k in range(3):
        here, there = corners[k], corners[(k + 1) % 3]
        for end in range(2):
            x, y, z = here[0], here[1], here[2]
            if end == 1:  # where the side crosses the near plane
                if (here[2] > _NEAR) == (there[2] > _NEAR):
                    continue
                share = (_NEAR - here[2]) / (there[2] - here[2])
                x, y, z = x + share * (there[0] - x), y + share * (there[1] - y), _NEAR
            elif z <= _NEAR:
                continue
            u = min(max(lens[2] + (lens[0] * x + lens[4] * y) / z, -1e9), 1e9)
            v = min(max(lens[3] + lens[1] * y / z, -1e9), 1e9)
            box[0], box[1] = min(box[0], u), max(box[1], u)
            box[2], box[3] = min(box[2], v), max(box[3], v)
    return box[0] <= box[1]


@inlined
def _touch(a, b):
    """Whether two triples share one vertex or two; the same triangle twice does not touch, it lies on itself."""
    shared = 0
    for i in range(3):
        for j in range(3):
            shared += a[i] == b[j]
    return 0 < shared < 3


@kernel
def draw_two_layers(points, faces, lens, near, owner):
    """The two nearest layers at each pixel: 1 / z in `near` (H, W, 2), the face in `owner`, -1 where there is none.

    Faces that touch one another and meet the ray at one depth are one layer.
    """
    height, width = owner.shape[:2]
    e, corners, box = np.empty((3, 3)), np.empty((3, 3)), np.empty(4)
    for f in range(faces.shape[0]):
        for k in range(3):
            corners[k] = points[faces[f, k]]
        if not _box(corners, lens, box):
            continue
        volume = _edge_functions(corners[0], corners[1], corners[2], e)
        if volume == 0:
            continue
        left, right = max(int(np.floor(box[0])), 0), min(int(np.ceil(box[1])), width - 1)
        top, bottom = max(int(np.floor(box[2])), 0), min(int(np.ceil(box[3])), height - 1)
        for row in range(top, bottom + 1):
            y = (row - lens[3]) / lens[1]
            for column in range(left, right + 1):
                x = (column - lens[2] - lens[4] * y) / lens[0]
                e0 = e[0, 0] * x + (e[0, 1] * y + e[0, 2])
                e1 = e[1, 0] * x + (e[1, 1] * y + e[1, 2])
                e2 = e[2, 0] * x + (e[2, 1] * y + e[2, 2])
                if e0 < 0 or e1 < 0 or e2 < 0:
                    continue
                w = (e0 + e1 + e2) / volume
                at, of = near[row, column], owner[row, column]
                if w <= at[1]:
                    continue
                known = False
                for k in range(2):
                    if of[k] >= 0 and abs(w - at[k]) <= _SAME * w and _touch(faces[f], faces[of[k]]):
                        known = True
                if known:
                    continue
                if w > at[0]:
                    at[1], of[1] = at[0], of[0]
                    at[0], of[0] = w, f
                else:
                    at[1], of[1] = w, f


@kernel
def find_blocked(points, faces, lens, vertex, limit, cell, columns, start, member, blocked):
    """Mark the rays to points that meet a face without that vertex before `limit`, a share of the way.

    Ray j goes to ``points[vertex[j]]``; ``member[start[c]:start[c + 1]]`` are the rays in cell c of the image, which
    are squares of side `cell` in rows of `columns`; what is outside of the image is in the cells at its border.
    """
    rows = (start.shape[0] - 1) // columns
    e, corners, box = np.empty((3, 3)), np.empty((3, 3)), np.empty(4)
    for f in range(faces.shape[0]):
        for k in range(3):
            corners[k] = points[faces[f, k]]
        if not _box(corners, lens, box):
            continue
        volume = _edge_functions(corners[0], corners[1], corners[2], e)
        if volume == 0:
            continue
        left, right = _clamped(box[0], cell, columns), _clamped(box[1], cell, columns)
        top, bottom = _clamped(box[2], cell, rows), _clamped(box[3], cell, rows)
        for row in range(top, bottom + 1):
            for i in range(start[row * columns + left], start[row * columns + right + 1]):
                j = member[i]
                v = vertex[j]
                if blocked[j] or v == faces[f, 0] or v == faces[f, 1] or v == faces[f, 2]:
                    continue
                e0, e1, e2 = _dot(e[0], points[v]), _dot(e[1], points[v]), _dot(e[2], points[v])
                if e0 >= 0 and e1 >= 0 and e2 >= 0 and volume < limit[j] * (e0 + e1 + e2):
                    blocked[j] = True


@inlined
def _clamped(at, cell, count):
    return int(min(max(np.floor(at / cell), 0), count - 1))


@kernel
def nearest_view(centre, faces, start, keyframe, rotation, place, depth, view):
    """For each face, of the keyframes that observe one of its vertices, that in which its centre has the least depth.

    `keyframe[start[v]:start[v + 1]]` observe vertex v; `view` is -1 and `depth` inf where none has it before it.
    """
    for f in range(faces.shape[0]):
        depth[f], view[f] = np.inf, -1
        for k in range(3):
            v = faces[f, k]
            for i in range(start[v], start[v + 1]):
                q = keyframe[i]
                z = 0.0
                for d in range(3):
                    z += rotation[q, d, 2] * (centre[f, d] - place[q, d])
                if z > _NEAR and (z < depth[f] or (z == depth[f] and q < view[f])):
                    depth[f], view[f] = z, q


@kernel
def find_seen(points, own, T_camera_world, depth, lens, tolerance, seen):
    """Mark points that another keyframe than their own sees: its depth at the pixel is theirs, to a share."""
    count, height, width = depth.shape
    for i in range(points.shape[0]):
        for step in range(1, 2 * count):
            q = own[i] + ((step + 1) // 2) * (1 if step % 2 else -1)  # the nearest in the sequence first
            if q < 0 or q >= count:
                continue
            T, p = T_camera_world[q], points[i]
            z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
            if z <= _NEAR:
                continue
            x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
            y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
            u = np.floor(lens[2] + (lens[0] * x + lens[4] * y) / z + 0.5)
            v = np.floor(lens[3] + lens[1] * y / z + 0.5)
            if 0 <= u < width and 0 <= v < height and abs(depth[q, int(v), int(u)] - z) <= tolerance * z:
                seen[i] = True
                break


@inlined
def _squared_distance(p, a, b, c):
    """Of a point from a triangle: its plane where the foot is inside, else the nearest side."""
    ab0, ab1, ab2 = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    ac0, ac1, ac2 = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    ap0, ap1, ap2 = p[0] - a[0], p[1] - a[1], p[2] - a[2]
    bb, cc = ab0 * ab0 + ab1 * ab1 + ab2 * ab2, ac0 * ac0 + ac1 * ac1 + ac2 * ac2
    bc = ab0 * ac0 + ab1 * ac1 + ab2 * ac2
    pb, pc = ap0 * ab0 + ap1 * ab1 + ap2 * ab2, ap0 * ac0 + ap1 * ac1 + ap2 * ac2
    pp = ap0 * ap0 + ap1 * ap1 + ap2 * ap2
    area = bb * cc - bc * bc
    s, t = pb * cc - pc * bc, pc * bb - pb * bc
    if area > 0 and s >= 0 and t >= 0 and s + t <= area:
        s, t = s / area, t / area
        return max(pp - 2 * (s * pb + t * pc) + s * s * bb + 2 * s * t * bc + t * t * cc, 0.0)
    s = min(max(pb / bb, 0.0), 1.0) if bb > 0 else 0.0
    least = pp - 2 * s * pb + s * s * bb
    t = min(max(pc / cc, 0.0), 1.0) if cc > 0 else 0.0
    least = min(least, pp - 2 * t * pc + t * t * cc)
    dd, pd = bb + cc - 2 * bc, pc - pb - bc + bb  # side b to c
    s = min(max(pd / dd, 0.0), 1.0) if dd > 0 else 0.0
    return max(min(least, pp - 2 * pb + bb - 2 * s * pd + s * s * dd), 0.0)


@kernel
def find_near(points, reach, key, size, low, side, xyz, faces, near):
    """Mark points within their reach of a triangle.

    Points are in the order of `key`, the number of their cell in a grid of `size` cells of `side` from `low`.
    """
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    widest = reach.max()
    for f in range(faces.shape[0]):
        a, b, c = xyz[faces[f, 0]], xyz[faces[f, 1]], xyz[faces[f, 2]]
        outside = False
        for d in range(3):
            least, most = min(a[d], b[d], c[d]) - widest, max(a[d], b[d], c[d]) + widest
            first[d] = max(int(np.floor((least - low[d]) / side)), 0)
            last[d] = min(int(np.floor((most - low[d]) / side)), size[d] - 1)
            outside |= first[d] > last[d]
        if outside:
            continue
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                row = (i * size[1] + j) * size[2]
                m = np.searchsorted(key, row + first[2])
                while m < key.shape[0] and key[m] <= row + last[2]:
                    if not near[m] and _squared_distance(points[m], a, b, c) <= reach[m] * reach[m]:
                        near[m] = True
                    m += 1
