"""Compiled loops of carving: rays walk through tetrahedra and leave what they say of free and full space."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

CORNERS = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])  # of the facet opposite to each vertex


@kernel
def facet_planes(points, tetrahedra, planes):  # type: ignore[no-untyped-def]
    """Plane (n, d) of each facet, ``n·x + d`` positive outside; n has length one, or is 0 for a facet without area."""
    for t in range(tetrahedra.shape[0]):
        for k in range(4):
            corners = CORNERS[k]
            o, p, q = (
                points[tetrahedra[t, corners[0]]], points[tetrahedra[t, corners[1]]], points[tetrahedra[t, corners[2]]]
            )
            ux, uy, uz = p[0] - o[0], p[1] - o[1], p[2] - o[2]
            vx, vy, vz = q[0] - o[0], q[1] - o[1], q[2] - o[2]
            x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
            length = np.sqrt(x * x + y * y + z * z)
            scale = 1.0 / length if length > 0.0 else 0.0
            r = points[tetrahedra[t, k]]
            if x * (r[0] - o[0]) + y * (r[1] - o[1]) + z * (r[2] - o[2]) > 0.0:
                scale = -scale
            x, y, z = x * scale, y * scale, z * scale
            planes[t, k, 0], planes[t, k, 1], planes[t, k, 2] = x, y, z
            planes[t, k, 3] = -(x * o[0] + y * o[1] + z * o[2])


@inlined
def _begin(i, dx, dy, dz, start, around, tetrahedra, planes):  # type: ignore[no-untyped-def]
    """Tetrahedron at vertex i into which a direction points: the one whose least sign is largest."""
    best, found = -np.inf, -1
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
def _leave(t, entered, ox, oy, oz, dx, dy, dz, planes):  # type: ignore[no-untyped-def]
    """Facet by which a ray leaves a tetrahedron, and how far along the ray."""
    at, facet = np.inf, -1
    for k in range(4):
        n = planes[t, k]
        along = n[0] * dx + n[1] * dy + n[2] * dz
        if k != entered and along > 0.0:
            s = -(n[0] * ox + n[1] * oy + n[2] * oz + n[3]) / along
            if s < at:
                at, facet = s, k
    return facet, at


@kernel
def carve(points, tetrahedra, neighbours, planes, start, around, origin, vertex, sigma, weight, depth, out):  # type: ignore[no-untyped-def]
    """Walk each ray from its landmark to the camera, and on behind the landmark.

    A facet that is crossed s before the landmark takes ``weight (1 - exp(-s² / 2σ²))`` from the side of the camera; the
    camera's tetrahedron is free, the one `depth` σ behind the landmark full. Returns how many rays lost their way.
    """
    capacity, free, full = out
    lost = 0
    most = 4 * tetrahedra.shape[0]
    for r in range(vertex.shape[0]):
        i = vertex[r]
        o = points[i]
        dx, dy, dz = origin[r, 0] - o[0], origin[r, 1] - o[1], origin[r, 2] - o[2]
        length = np.sqrt(dx * dx + dy * dy + dz * dz)
        if not length > 0.0 or start[i] == start[i + 1]:
            lost += 1
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        t, entered = _begin(i, dx, dy, dz, start, around, tetrahedra, planes), -1
        for k in range(4):
            if tetrahedra[t, k] == i:
                entered = -1
        steps = 0
        while steps < most:
            facet, at = _leave(t, entered, o[0], o[1], o[2], dx, dy, dz, planes)
            if facet < 0 or at >= length:
                break
            beyond = neighbours[t, facet]
            if beyond < 0:
                break
            entered = 0
            while neighbours[beyond, entered] != t:
                entered += 1
            s = max(at, 0.0) / sigma[r]
            capacity[beyond, entered] += weight[r] * (1.0 - np.exp(-0.5 * s * s))
            t = beyond
            steps += 1
        if steps == most:
            lost += 1
            continue
        free[t] += weight[r]
        t, entered = _begin(i, -dx, -dy, -dz, start, around, tetrahedra, planes), -1
        steps = 0
        while steps < most:
            facet, at = _leave(t, entered, o[0], o[1], o[2], -dx, -dy, -dz, planes)
            if facet < 0 or at >= depth * sigma[r]:
                break
            beyond = neighbours[t, facet]
            if beyond < 0:
                break
            entered = 0
            while neighbours[beyond, entered] != t:
                entered += 1
            t = beyond
            steps += 1
        full[t] += weight[r]
    return lost


@kernel
def sphere_angles(points, tetrahedra, planes, cosines):  # type: ignore[no-untyped-def]
    """Cosine of the angle between each facet and the sphere around its tetrahedron; negative: its middle is beyond."""
    for t in range(tetrahedra.shape[0]):
        o = points[tetrahedra[t, 0]]
        a, b, c = np.empty(3), np.empty(3), np.empty(3)
        for j in range(3):
            a[j] = points[tetrahedra[t, 1], j] - o[j]
            b[j] = points[tetrahedra[t, 2], j] - o[j]
            c[j] = points[tetrahedra[t, 3], j] - o[j]
        bcx, bcy, bcz = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
        cax, cay, caz = c[1] * a[2] - c[2] * a[1], c[2] * a[0] - c[0] * a[2], c[0] * a[1] - c[1] * a[0]
        abx, aby, abz = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        volume = 2.0 * (a[0] * bcx + a[1] * bcy + a[2] * bcz)
        aa, bb, cc = a[0] ** 2 + a[1] ** 2 + a[2] ** 2, b[0] ** 2 + b[1] ** 2 + b[2] ** 2, c[0] ** 2 + c[1] ** 2 + c[2] ** 2
        if volume == 0.0:
            for k in range(4):
                cosines[t, k] = -1.0
            continue
        x = (aa * bcx + bb * cax + cc * abx) / volume
        y = (aa * bcy + bb * cay + cc * aby) / volume
        z = (aa * bcz + bb * caz + cc * abz) / volume
        radius = np.sqrt(x * x + y * y + z * z)
        x, y, z = x + o[0], y + o[1], z + o[2]
        for k in range(4):
            n = planes[t, k]
            cosines[t, k] = -(n[0] * x + n[1] * y + n[2] * z + n[3]) / radius
