"""Compiled kernels of mesh denoising: which faces meet, guided filtering of normals, vertices that follow them."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel


@inlined
def _write_unit(x, y, z, out, f):  # type: ignore[no-untyped-def]
    """Write a direction as row f, of length 1; 0 stays. Its length before."""
    length = np.sqrt(x * x + y * y + z * z)
    share = 1 / length if length > 0 else 0.0
    out[f, 0], out[f, 1], out[f, 2] = x * share, y * share, z * share
    return length


@inlined
def _across(faces, start, at, f, k):  # type: ignore[no-untyped-def]
    """The only other face on side k of face f (corners k and k + 1), or -1 on a border, -2 where there are several."""
    a, b, found = faces[f, k], faces[f, (k + 1) % 3], -1
    for p in range(start[a], start[a + 1]):
        g = at[p]
        if g != f and (faces[g, 0] == b or faces[g, 1] == b or faces[g, 2] == b):
            found = g if found == -1 else -2
    return found


@inlined
def _runs_alike(faces, f, k, g):  # type: ignore[no-untyped-def]
    """Whether face g has side k of face f in the same direction: then they are wound differently."""
    a, b = faces[f, k], faces[f, (k + 1) % 3]
    alike = False
    for j in range(3):
        alike |= faces[g, j] == a and faces[g, (j + 1) % 3] == b
    return alike


@kernel
def orient(faces, start, at):  # type: ignore[no-untyped-def]
    """Wind faces in place like the first of their component, from neighbour to neighbour."""
    count = faces.shape[0]
    seen, queue = np.zeros(count, np.bool_), np.empty(count, np.int32)
    for first in range(count):
        if seen[first]:
            continue
        seen[first], queue[0], head, tail = True, first, 0, 1
        while head < tail:
            f = queue[head]
            head += 1
            for k in range(3):
                g = _across(faces, start, at, f, k)
                if g < 0 or seen[g]:
                    continue
                if _runs_alike(faces, f, k, g):
                    faces[g, 1], faces[g, 2] = faces[g, 2], faces[g, 1]
                seen[g], queue[tail] = True, g
                tail += 1


@kernel
def on_border(faces, start, at):  # type: ignore[no-untyped-def]
    """Which vertices lie on a side that has not exactly two faces."""
    found = np.zeros(start.shape[0] - 1, np.bool_)
    for f in range(faces.shape[0]):
        for k in range(3):
            if _across(faces, start, at, f, k) < 0:
                found[faces[f, k]] = found[faces[f, (k + 1) % 3]] = True
    return found


@kernel
def rings(faces, start, at):  # type: ignore[no-untyped-def]
    """Return the faces that share a vertex with each face, itself left out, in CSR form (int32)."""
    count = faces.shape[0]
    bound = 0
    for f in range(count):
        for k in range(3):
            bound += start[faces[f, k] + 1] - start[faces[f, k]]
    begin, near = np.zeros(count + 1, np.int32), np.empty(bound, np.int32)
    last, p = np.full(count, -1, np.int32), 0
    for f in range(count):
        last[f] = f
        for k in range(3):
            for q in range(start[faces[f, k]], start[faces[f, k] + 1]):
                if last[at[q]] != f:
                    last[at[q]] = f
                    near[p] = at[q]
                    p += 1
        begin[f + 1] = p
    return begin, near[:p].copy()


@kernel
def measure_faces(xyz, faces, normals, centres, areas, angles):  # type: ignore[no-untyped-def]
    """Write unit normals, centres, areas and angles at the corners; a face without area has the normal 0."""
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ux, uy, uz = xyz[b, 0] - xyz[a, 0], xyz[b, 1] - xyz[a, 1], xyz[b, 2] - xyz[a, 2]
        wx, wy, wz = xyz[c, 0] - xyz[a, 0], xyz[c, 1] - xyz[a, 1], xyz[c, 2] - xyz[a, 2]
        x, y, z = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        length = _write_unit(x, y, z, normals, f)
        for axis in range(3):
            centres[f, axis] = (xyz[a, axis] + xyz[b, axis] + xyz[c, axis]) / 3
        areas[f] = length / 2
        first = ux * wx + uy * wy + uz * wz  # cosines times lengths; the sine's is twice the area at each corner
        second = ux * ux + uy * uy + uz * uz - first
        third = wx * wx + wy * wy + wz * wz - first
        angles[f, 0], angles[f, 1] = np.arctan2(length, first), np.arctan2(length, second)
        angles[f, 2] = np.arctan2(length, third)


@kernel
def guide_normals(normals, areas, begin, near, out):  # type: ignore[no-untyped-def]
    """Guidance: the mean normals of the patches that hold a face, each weighted by how much one direction it is.

    A patch is a face and those that share a vertex with it. Its spread is 1 less the length of its mean normal; weights
    go with the fourth power of the least spread over the patch's.
    """
    count = normals.shape[0]
    means, spread = np.empty((count, 3)), np.empty(count)
    for f in range(count):
        x, y, z = areas[f] * normals[f, 0], areas[f] * normals[f, 1], areas[f] * normals[f, 2]
        area = areas[f]
        for p in range(begin[f], begin[f + 1]):
            g = near[p]
            x += areas[g] * normals[g, 0]
            y += areas[g] * normals[g, 1]
            z += areas[g] * normals[g, 2]
            area += areas[g]
        length = _write_unit(x, y, z, means, f)
        spread[f] = max(1 - length / area, 0.0) + 1e-6 if area > 0 else 1.0  # 1e-6: a spread of 0.1°
    for f in range(count):
        least = spread[f]
        for p in range(begin[f], begin[f + 1]):
            least = min(least, spread[near[p]])
        weight = (least / spread[f]) ** 4
        x, y, z = weight * means[f, 0], weight * means[f, 1], weight * means[f, 2]
        for p in range(begin[f], begin[f + 1]):
            g = near[p]
            ratio = least / spread[g]
            weight = ratio * ratio * ratio * ratio
            x += weight * means[g, 0]
            y += weight * means[g, 1]
            z += weight * means[g, 2]
        _write_unit(x, y, z, out, f)


@inlined
def _bell(x):  # type: ignore[no-untyped-def]
    """Near exp(-x) for x >= 0, and 0 from 8 on: (1 - x / 8)^8, three squares."""
    y = max(1 - 0.125 * x, 0.0)
    y *= y
    y *= y
    return y * y


@kernel
def average_normals(normals, guide, centres, areas, begin, near, reach, width, out):  # type: ignore[no-untyped-def]
    """Joint bilateral means of normals: bells of the distance (`reach`) and of the guidance's difference (`width`)."""
    far, apart = 0.5 / (reach * reach), 0.5 / (width * width)
    for f in range(normals.shape[0]):
        x, y, z = areas[f] * normals[f, 0], areas[f] * normals[f, 1], areas[f] * normals[f, 2]
        for p in range(begin[f], begin[f + 1]):
            g = near[p]
            a, b, c = centres[g, 0] - centres[f, 0], centres[g, 1] - centres[f, 1], centres[g, 2] - centres[f, 2]
            i, j, k = guide[g, 0] - guide[f, 0], guide[g, 1] - guide[f, 1], guide[g, 2] - guide[f, 2]
            weight = areas[g] * _bell(far * (a * a + b * b + c * c) + apart * (i * i + j * j + k * k))
            x += weight * normals[g, 0]
            y += weight * normals[g, 1]
            z += weight * normals[g, 2]
        _write_unit(x, y, z, out, f)


@kernel
def corner_normals(normals, angles, faces, start, at, width, out):  # type: ignore[no-untyped-def]
    """Normals of the surface at the corners of each face: means over the faces there, by angle, of those like it."""
    apart = 0.5 / (width * width)
    for f in range(faces.shape[0]):
        for c in range(3):
            v, x, y, z = faces[f, c], 0.0, 0.0, 0.0
            for p in range(start[v], start[v + 1]):
                g = at[p]
                i, j, k = normals[g, 0] - normals[f, 0], normals[g, 1] - normals[f, 1], normals[g, 2] - normals[f, 2]
                angle = angles[g, 0] if faces[g, 0] == v else (angles[g, 1] if faces[g, 1] == v else angles[g, 2])
                weight = angle * _bell(apart * (i * i + j * j + k * k))
                x += weight * normals[g, 0]
                y += weight * normals[g, 1]
                z += weight * normals[g, 2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0:
                out[f, c, 0], out[f, c, 1], out[f, c, 2] = x / length, y / length, z / length
            else:
                out[f, c, 0], out[f, c, 1], out[f, c, 2] = normals[f, 0], normals[f, 1], normals[f, 2]


@inlined
def _rise(xyz, corners, faces, f, a, b):  # type: ignore[no-untyped-def]
    """What corner b of face f is above corner a, by the normals of both: 0 on planes, spheres and all quadrics."""
    u, v, total = faces[f, a], faces[f, b], 0.0
    for axis in range(3):
        total += (corners[f, a, axis] + corners[f, b, axis]) * (xyz[v, axis] - xyz[u, axis])
    return total / 6


@kernel
def follow_normals(xyz, faces, start, corners, gain, rounds):  # type: ignore[no-untyped-def]
    """Move vertices in place, several rounds, to where the normals at the corners of their faces say: the mean of all.

    `gain` (N, 3, 3), or empty, says how far each vertex goes in which direction.
    """
    for _ in range(rounds):
        step = np.zeros((xyz.shape[0], 3))
        for f in range(faces.shape[0]):
            one, two = _rise(xyz, corners, faces, f, 0, 1), _rise(xyz, corners, faces, f, 1, 2)
            three = _rise(xyz, corners, faces, f, 2, 0)
            for axis in range(3):
                step[faces[f, 0], axis] += (one - three) * corners[f, 0, axis]
                step[faces[f, 1], axis] += (two - one) * corners[f, 1, axis]
                step[faces[f, 2], axis] += (three - two) * corners[f, 2, axis]
        for v in range(xyz.shape[0]):
            share = 1.0 / max(start[v + 1] - start[v], 1)
            a, b, c = share * step[v, 0], share * step[v, 1], share * step[v, 2]
            for axis in range(3):
                if gain.shape[0]:
                    xyz[v, axis] += gain[v, axis, 0] * a + gain[v, axis, 1] * b + gain[v, axis, 2] * c
                else:
                    xyz[v, axis] += share * step[v, axis]


@kernel
def slide_vertices(xyz, centres, normals, start, at, share):  # type: ignore[no-untyped-def]
    """Move vertices in place, within the planes of their faces, a share (N,) of the way to the mean of those' centres.

    So those on a crease go along it and corners stay: the way is taken through ``I - mean of n nᵀ`` 16 times.
    """
    way, left, across = np.empty(3), np.empty(3), np.empty((3, 3))
    for v in range(start.shape[0] - 1):
        count = start[v + 1] - start[v]
        if share[v] == 0 or count == 0:
            continue
        way[:], across[:] = 0.0, 0.0
        for p in range(start[v], start[v + 1]):
            f = at[p]
            for axis in range(3):
                way[axis] += share[v] / count * (centres[f, axis] - xyz[v, axis])
                for other in range(3):
                    across[axis, other] += normals[f, axis] * normals[f, other] / count
        for _ in range(16):
            for axis in range(3):
                left[axis] = way[axis] - (
                    across[axis, 0] * way[0] + across[axis, 1] * way[1] + across[axis, 2] * way[2]
                )
            way[:] = left
        for axis in range(3):
            xyz[v, axis] += way[axis]


@kernel
def walk(x, before, faces, start, at, first, out):  # type: ignore[no-untyped-def]
    """Write ``2 P x - before`` (``P x`` where `first`): P means the other corners of the faces at a vertex."""
    sums = np.empty((faces.shape[0], 3))
    for f in range(faces.shape[0]):
        for axis in range(3):
            sums[f, axis] = x[faces[f, 0], axis] + x[faces[f, 1], axis] + x[faces[f, 2], axis]
    scale = 1.0 if first else 2.0
    for v in range(start.shape[0] - 1):
        count = start[v + 1] - start[v]
        a, b, c = 0.0, 0.0, 0.0
        for p in range(start[v], start[v + 1]):
            a += sums[at[p], 0]
            b += sums[at[p], 1]
            c += sums[at[p], 2]
        share = scale / (2 * count) if count > 0 else 0.0
        own = scale / 2
        out[v, 0] = a * share - own * x[v, 0] - (0.0 if first else before[v, 0])
        out[v, 1] = b * share - own * x[v, 1] - (0.0 if first else before[v, 1])
        out[v, 2] = c * share - own * x[v, 2] - (0.0 if first else before[v, 2])


@kernel
def inner(x, y, start):  # type: ignore[no-untyped-def]
    """Sum of x y over vertices and axes, each vertex with the number of its faces."""
    total = 0.0
    for v in range(x.shape[0]):
        total += (start[v + 1] - start[v]) * (x[v, 0] * y[v, 0] + x[v, 1] * y[v, 1] + x[v, 2] * y[v, 2])
    return total


@kernel
def add_scaled(x, factor, out):  # type: ignore[no-untyped-def]
    """Add `factor` times x."""
    for v in range(x.shape[0]):
        for axis in range(3):
            out[v, axis] += factor * x[v, axis]


@kernel
def second_gain(faces, start, at):  # type: ignore[no-untyped-def]
    """Squared norm of the rows of ``(I - P)²``: what it makes of the variance of white noise, for each vertex."""
    n = start.shape[0] - 1
    row, touched = np.zeros(n), np.empty(n, np.int32)
    out = np.zeros(n)
    for v in range(n):
        top = _spread(faces, start, at, v, 1.0, row, touched, 0)
        first = touched[:top].copy()
        weights = np.empty(top)
        for p in range(top):
            weights[p] = row[first[p]]
            row[first[p]] = 0.0
        top = 0
        for p in range(first.shape[0]):
            top = _spread(faces, start, at, first[p], weights[p], row, touched, top)
        for p in range(top):
            out[v] += row[touched[p]] ** 2
            row[touched[p]] = 0.0
    return out


@inlined
def _spread(faces, start, at, v, weight, row, touched, top):  # type: ignore[no-untyped-def]
    """Add ``weight (e_v - P[v])`` to a sparse row; returns how many entries it has (some may be listed twice)."""
    share = weight / (2 * max(start[v + 1] - start[v], 1))
    if row[v] == 0.0:
        touched[top] = v
        top += 1
    row[v] += weight
    for p in range(start[v], start[v + 1]):
        for k in range(3):
            u = faces[at[p], k]
            if u != v:
                if row[u] == 0.0:
                    touched[top] = u
                    top += 1
                row[u] -= share
    return top
