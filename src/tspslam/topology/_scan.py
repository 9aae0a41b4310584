"""Compiled loops of a scan's surface: strips between rings, and the cuts where the range steps."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel


@kernel
def zip_rings(azimuth, start, faces, neighbours):  # type: ignore[no-untyped-def]
    """Fill the strip between each ring and the next with triangles; the strip closes around the turn.

    Points stand by ring, from the lowest up, then by azimuth; ring r is ``start[r]`` to ``start[r + 1]``. A strip of m
    and n points has m + n triangles: each stands on a side of one ring, and sides come in the order of their middles.
    `neighbours` (F, 3) is the face across from each corner, -1 where there is none.
    """
    below = np.full(start[-1], -1, np.int64)  # the face that stands on each side of a ring, from the strip below
    turn = 2 * np.pi
    first = 0
    for r in range(start.size - 2):
        a, b, end = start[r], start[r + 1], start[r + 2]
        m, n = b - a, end - b
        i, j = 0, 0
        for k in range(m + n):
            f = first + k
            before, after = first + (k + m + n - 1) % (m + n), first + (k + 1) % (m + n)
            low, high = a + i % m, b + j % n
            next_low, next_high = a + (i + 1) % m, b + (j + 1) % n
            middle_low = azimuth[low] + azimuth[next_low] + (turn if i + 1 == m else 0.0)
            middle_high = azimuth[high] + azimuth[next_high] + (turn if j + 1 == n else 0.0)
            if j == n or (i < m and middle_low <= middle_high):
                faces[f, 0], faces[f, 1], faces[f, 2] = next_low, low, high
                other = below[low]
                neighbours[f, 0], neighbours[f, 1], neighbours[f, 2] = before, after, other
                if other >= 0:
                    neighbours[other, 2] = f
                i += 1
            else:
                faces[f, 0], faces[f, 1], faces[f, 2] = high, next_high, low
                neighbours[f, 0], neighbours[f, 1], neighbours[f, 2] = after, before, -1
                below[high] = f
                j += 1
        first += m + n


@kernel
def within_gaps(azimuth, faces, ring, widest, most_rings, keep):  # type: ignore[no-untyped-def]
    """Whether each face's corners are at most `widest` rad of azimuth apart, and differ; to `keep`."""
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        keep[f] = a != b and b != c and a != c
        for k in range(3):
            p, q = faces[f, k], faces[f, (k + 1) % 3]
            apart = abs(azimuth[p] - azimuth[q])
            keep[f] &= min(apart, 2 * np.pi - apart) <= widest
            keep[f] &= abs(ring[p] - ring[q]) <= most_rings


@inlined
def _plane(xyz, a, b, c, out):  # type: ignore[no-untyped-def]
    """Normal over offset of the plane through three points: times a unit ray, that is the inverse range there."""
    px, py, pz = xyz[b, 0] - xyz[a, 0], xyz[b, 1] - xyz[a, 1], xyz[b, 2] - xyz[a, 2]
    qx, qy, qz = xyz[c, 0] - xyz[a, 0], xyz[c, 1] - xyz[a, 1], xyz[c, 2] - xyz[a, 2]
    out[0], out[1], out[2] = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    off = out[0] * xyz[a, 0] + out[1] * xyz[a, 1] + out[2] * xyz[a, 2]
    out[0], out[1], out[2] = out[0] / off, out[1] / off, out[2] / off  # not finite where the ray lies in the plane


@inlined
def _is_off(xyz, inverse, plane, at, noise):  # type: ignore[no-untyped-def]
    seen = (plane[0] * xyz[at, 0] + plane[1] * xyz[at, 1] + plane[2] * xyz[at, 2]) * inverse[at]
    return not abs(seen - inverse[at]) <= noise * inverse[at] * inverse[at]


@inlined
def _jumps(distance, faces, f, ratio, noise):  # type: ignore[no-untyped-def]
    for k in range(3):
        one, other = distance[faces[f, k]], distance[faces[f, (k + 1) % 3]]
        jump = abs(one - other)
        if jump > ratio * min(one, other) and jump > noise * np.sqrt(2.0):
            return True
    return False


@kernel
def cut_steps(xyz, distance, faces, neighbours, ratio, noise, keep):  # type: ignore[no-untyped-def]
    """Take from `keep` the faces over a step of range: those that jump, unless they continue all their neighbours.

    A face continues another where the point of either beyond their common side lies on the plane of the other's
    corners, to `noise` m of range. Faces that are not in `keep` are no neighbours; there must be two.
    """
    inverse, given = 1 / distance, keep.copy()
    here, there = np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        if not given[f] or not _jumps(distance, faces, f, ratio, noise):
            continue
        _plane(xyz, faces[f, 0], faces[f, 1], faces[f, 2], here)
        count, fits = 0, True
        for k in range(3):
            g = neighbours[f, k]
            if g < 0 or not given[g]:
                continue
            count += 1
            apex = faces[g, 0]
            for c in range(3):
                if neighbours[g, c] == f:
                    apex = faces[g, c]
            _plane(xyz, faces[g, 0], faces[g, 1], faces[g, 2], there)
            if _is_off(xyz, inverse, here, apex, noise) and _is_off(xyz, inverse, there, faces[f, k], noise):
                fits = False
        keep[f] = fits and count >= 2
