"""Compiled loops of carving: rays walk through tetrahedra and leave what they say of free and full space."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

CORNERS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
"""Corners of the facet opposite to each vertex of a tetrahedron."""


@kernel
def facet_planes(points, tetrahedra, planes):  # type: ignore[no-untyped-def]
    """Plane (n, d) of each facet, ``n·x + d`` positive outside; n has length one, or is 0 for a facet without area."""
    for t in range(tetrahedra.shape[0]):
        for k in range(4):
            corners = CORNERS[k]
            o, p = points[tetrahedra[t, corners[0]]], points[tetrahedra[t, corners[1]]]
            q, r = points[tetrahedra[t, corners[2]]], points[tetrahedra[t, k]]
            ux, uy, uz = p[0] - o[0], p[1] - o[1], p[2] - o[2]
            vx, vy, vz = q[0] - o[0], q[1] - o[1], q[2] - o[2]
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            length = np.sqrt(x * x + y * y + z * z)
            scale = 1.0 / length if length > 0.0 else 0.0
            if x * (r[0] - o[0]) + y * (r[1] - o[1]) + z * (r[2] - o[2]) > 0.0:
                scale = -scale
            x, y, z = x * scale, y * scale, z * scale
            planes[t, k, 0], planes[t, k, 1], planes[t, k, 2] = x, y, z
            planes[t, k, 3] = -(x * o[0] + y * o[1] + z * o[2])


@kernel
def sphere_angles(points, tetrahedra, planes, cosines):  # type: ignore[no-untyped-def]
    """Cosine of the angle between each facet and the sphere around its tetrahedron; negative: its middle is beyond."""
    a, b, c = np.empty(3), np.empty(3), np.empty(3)
    for t in range(tetrahedra.shape[0]):
        o = points[tetrahedra[t, 0]]
        for j in range(3):
            a[j] = points[tetrahedra[t, 1], j] - o[j]
            b[j] = points[tetrahedra[t, 2], j] - o[j]
            c[j] = points[tetrahedra[t, 3], j] - o[j]
        bcx, bcy, bcz = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        cax, cay, caz = c[1] * a[2] - c[2] * a[1], c[2] * a[0] - c[0] * a[2], c[0] * a[1] - c[1] * a[0]
        abx, aby, abz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        volume = 2.0 * (a[0] * bcx + a[1] * bcy + a[2] * bcz)
        if volume == 0.0:  # flat: no sphere, and no good facet
            cosines[t] = -1.0
            continue
        aa = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        bb = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
        cc = c[0] * c[0] + c[1] * c[1] + c[2] * c[2]
        x = (aa * bcx + bb * cax + cc * abx) / volume
        y = (aa * bcy + bb * cay + cc * aby) / volume
        z = (aa * bcz + bb * caz + cc * abz) / volume
        radius = np.sqrt(x * x + y * y + z * z)
        x, y, z = x + o[0], y + o[1], z + o[2]
        for k in range(4):
            n = planes[t, k]
            cosines[t, k] = -(n[0] * x + n[1] * y + n[2] * z + n[3]) / radius


@inlined
def _begin(i, dx, dy, dz, start, around, tetrahedra, planes):  # type: ignore[no-untyped-def]
    """Tetrahedron at vertex i into which a direction points: the one whose least sign is largest."""
    best, found = -np.inf, np.int64(-1)  # a literal would be one more type to compile `_walk` for
    for r in range(start[i], start[i + 1]):
        t = around[r]
        least = np.inf
        for k in range(4):
            if tetrahedra[t, k] != i:
                n = planes[t, k]
                least = min(least, -(n[0] * dx + n[1] * dy + n[2] * dz))
        if least > best:
            best, found = least, t
    return found


@inlined
def _leave(t, entered, o, dx, dy, dz, planes):  # type: ignore[no-untyped-def]
    """Facet by which a ray from o leaves a tetrahedron, -1 if by none, and how far along the ray."""
    at, facet = np.inf, -1
    for k in range(4):
        n = planes[t, k]
        along = n[0] * dx + n[1] * dy + n[2] * dz
        if k != entered and along > 0.0:
            s = -(n[0] * o[0] + n[1] * o[1] + n[2] * o[2] + n[3]) / along
            if s < at:
                at, facet = s, k
    return facet, at


@kernel
def _walk(t, o, d, length, sigma, steps, sign, neighbours, planes, crossed):  # type: ignore[no-untyped-def]
    """Walk from o along d, and return the tetrahedron in which `length` ends, and after how many steps.

    -1 if the walk goes in a circle, as it may among flat tetrahedra (seen as Brent 1980 does: against a place that is
    renewed after 1, 2, 4, ... steps). With a positive `sigma`, each facet crossed s from o takes
    ``sign (1 - exp(-s² / 2σ²))``, from the side where o is not.
    """
    entered, before, renewed = -1, t, 1
    for step in range(steps):
        facet, at = _leave(t, entered, o, d[0], d[1], d[2], planes)
        if facet < 0 or at >= length or neighbours[t, facet] < 0:
            return t, step
        beyond, entered = neighbours[t, facet], 0
        while neighbours[beyond, entered] != t:
            entered += 1
        if sigma > 0.0:
            share = max(at, 0.0) / sigma
            crossed[beyond, entered] += sign * (1.0 - np.exp(-0.5 * share * share))
        t = beyond
        if t == before:
            return -1, step + 1
        if step + 1 == renewed:
            before, renewed = t, 2 * renewed
    return -1, steps


@kernel
def carve(points, tetrahedra, neighbours, planes, start, around, origin, vertex, sigma, behind, out):  # type: ignore[no-untyped-def]
    """Walk each ray from its landmark to the camera, and `behind` standard deviations on behind the landmark.

    What is crossed before the landmark should be free; the camera's tetrahedron is, the one behind is full. Landmarks
    without a tetrahedron (another is in their place) say nothing, nor does a ray that goes astray.
    """
    crossed, free, full = out
    d = np.empty(3)
    for r in range(vertex.shape[0]):
        i = vertex[r]
        o = points[i]
        for k in range(3):
            d[k] = origin[r, k] - o[k]
        length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
        if length == 0.0 or start[i] == start[i + 1]:
            continue
        for k in range(3):
            d[k] /= length
        t = _begin(i, d[0], d[1], d[2], start, around, tetrahedra, planes)
        most = 4 * neighbours.shape[0]
        begin = t
        t, steps = _walk(begin, o, d, length, sigma[r], most, 1.0, neighbours, planes, crossed)
        if t >= 0:
            free[t] += 1.0
        else:  # take back what it left
            _walk(begin, o, d, length, sigma[r], steps, -1.0, neighbours, planes, crossed)
        for k in range(3):
            d[k] = -d[k]
        t = _begin(i, d[0], d[1], d[2], start, around, tetrahedra, planes)
        t, _ = _walk(t, o, d, behind * sigma[r], 0.0, most, 1.0, neighbours, planes, crossed)
        if t >= 0:
            full[t] += 1.0


@kernel
def shared_cosines(faces, start, keyframe, centres, points, normals):  # type: ignore[no-untyped-def]
    """Largest cosine of the viewing angle of each face in the keyframes that see all three corners; -1 without one.

    Rows ``start[i]`` on are keyframes of vertex i; `centres` (K, 3) where they stood, `normals` (F, 3) any length.
    """
    best = np.full(faces.shape[0], -1.0)
    for f in range(faces.shape[0]):
        n, size = normals[f], np.sqrt(normals[f, 0] ** 2 + normals[f, 1] ** 2 + normals[f, 2] ** 2)
        a, b, c = start[faces[f, 0]], start[faces[f, 1]], start[faces[f, 2]]
        while a < start[faces[f, 0] + 1] and b < start[faces[f, 1] + 1] and c < start[faces[f, 2] + 1]:
            most = max(keyframe[a], keyframe[b], keyframe[c])
            if keyframe[a] == most and keyframe[b] == most and keyframe[c] == most:
                x = centres[most, 0] - points[f, 0]
                y = centres[most, 1] - points[f, 1]
                z = centres[most, 2] - points[f, 2]
                length = np.sqrt(x * x + y * y + z * z) * size
                if length > 0.0:
                    best[f] = max(best[f], (n[0] * x + n[1] * y + n[2] * z) / length)
                a, b, c = a + 1, b + 1, c + 1
            elif keyframe[a] < most:
                a += 1
            elif keyframe[b] < most:
                b += 1
            else:
                c += 1
    return best
