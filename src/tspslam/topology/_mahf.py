"""Compiled kernels of MAHF: tangent planes, cotangents, heat on a patch that grows until hardly any leaves it."""

from __future__ import annotations

import numpy as np

from .._jit import kernel, reassociated_kernel

BLOCK = 8  # vertices that share a patch: what fits vector registers
LARGEST_COTANGENT = 1e3
LONGEST = 1.5  # of a column of the kernel; 1 without negative eigenvalues
NO_DIRECTION = 1e-9  # share of a distance below which its projection on the tangent plane has no direction


@kernel
def cotangent_weights(xyz, faces, out):  # type: ignore[no-untyped-def]
    """``½ cot`` of the angle opposite each side (i, j), (j, k), (k, i) of a face, each cot clamped; (F, 3)."""
    a, b = np.empty(3), np.empty(3)
    for f in range(faces.shape[0]):
        for side in range(3):
            i, j, k = faces[f, side], faces[f, (side + 1) % 3], faces[f, (side + 2) % 3]
            for axis in range(3):
                a[axis], b[axis] = xyz[i, axis] - xyz[k, axis], xyz[j, axis] - xyz[k, axis]
            x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
            dot, cross = a[0] * b[0] + a[1] * b[1] + a[2] * b[2], np.sqrt(x * x + y * y + z * z)
            if abs(dot) < LARGEST_COTANGENT * cross:
                out[f, side] = 0.5 * dot / cross
            else:
                out[f, side] = 0.5 * LARGEST_COTANGENT * np.sign(dot)


@kernel
def add_normals(xyz, faces, normals):  # type: ignore[no-untyped-def]
    """Add each face's normal, twice its area long and turned away from the camera at 0, to its vertices."""
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax, ay, az = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
        bx, by, bz = xyz[k, 0] - xyz[i, 0], xyz[k, 1] - xyz[i, 1], xyz[k, 2] - xyz[i, 2]
        x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        if x * xyz[i, 0] + y * xyz[i, 1] + z * xyz[i, 2] < 0:  # the same sign at the centroid: both lie in its plane
            x, y, z = -x, -y, -z
        for corner in range(3):
            v = faces[f, corner]
            normals[v, 0] += x
            normals[v, 1] += y
            normals[v, 2] += z


@kernel
def choose_seeds(i, indptr, indices, done, seeds):  # type: ignore[no-untyped-def]
    """Vertex i and others within two hops that are still to do, up to `BLOCK`: they share a patch. Returns how many."""
    seeds[0], done[i] = i, True
    count = 1
    for hops in range(2):
        for p in range(indptr[i], indptr[i + 1]):
            v = indices[p]
            if hops == 0 and count < BLOCK and not done[v]:
                seeds[count], done[v] = v, True
                count += 1
            elif hops == 1 and count < BLOCK:
                for q in range(indptr[v], indptr[v + 1]):
                    u = indices[q]
                    if count < BLOCK and not done[u]:
                        seeds[count], done[u] = u, True
                        count += 1
    return count


@kernel
def grow(seeds, radius, indptr, indices, place, members):  # type: ignore[no-untyped-def]
    """Number the vertices within `radius` hops of the seeds; return how many there are, and of how many it is known
    that all neighbours are among them."""  # noqa: D205, D209
    begin, stop = 0, seeds.shape[0]
    for k in range(stop):
        members[k], place[seeds[k]] = seeds[k], k
    for _ in range(radius):
        end = stop
        for m in range(begin, end):
            v = members[m]
            for p in range(indptr[v], indptr[v + 1]):
                u = indices[p]
                if place[u] < 0:
                    place[u] = stop
                    members[stop] = u
                    stop += 1
        begin = end
        if begin == stop:
            break
    return stop, begin


@kernel
def cut_out(count, members, place, indptr, indices, data, start, near, weight, leak):  # type: ignore[no-untyped-def]
    """The matrix on the patch, as CSR in local numbers, and the weight that leaves each row; returns a spectral bound.

    The bound is Gershgorin's: the largest absolute row sum.
    """
    used, bound = 0, 0.0
    start[0] = 0
    for m in range(count):
        v = members[m]
        leak[m] = 0.0
        total = 0.0
        for p in range(indptr[v], indptr[v + 1]):
            u = place[indices[p]]
            if u >= 0:
                near[used], weight[used] = u, data[p]
                used += 1
                total += abs(data[p])
            else:
                leak[m] += abs(data[p])
        bound = max(bound, total)
        start[m + 1] = used
    return bound


@reassociated_kernel
def diffuse(count, start, near, weight, half, series, now, before, heat):  # type: ignore[no-untyped-def]
    """Columns 0 to `BLOCK` of ``exp(-tL)`` on a patch, for each row of coefficients, to `heat` (S, count, BLOCK)."""
    for m in range(count):
        for b in range(BLOCK):
            now[m, b] = 1.0 if m == b else 0.0
            before[m, b] = 0.0
            for s in range(series.shape[0]):
                heat[s, m, b] = series[s, 0] * now[m, b]
    for k in range(1, series.shape[1]):
        factor = (1.0 if k == 1 else 2.0) / half
        for m in range(count):
            for b in range(BLOCK):
                before[m, b] = -before[m, b] - factor * half * now[m, b]
            for p in range(start[m], start[m + 1]):
                scaled, u = factor * weight[p], near[p]
                for b in range(BLOCK):
                    before[m, b] += scaled * now[u, b]
        now, before = before, now
        for s in range(series.shape[0]):
            coefficient = series[s, k]
            for m in range(count):
                for b in range(BLOCK):
                    heat[s, m, b] += coefficient * now[m, b]


@kernel
def gather(i, b, count, members, heat, xyz, axes, signal, orders, out):  # type: ignore[no-untyped-def]
    """Write ``Σ_j K(i, j) e^{jmφ(i, j)} s_j`` over the patch to `out` (S, M, C); i is its seed b."""
    out[:] = 0.0
    channels = signal.shape[1]
    for m in range(count):
        v = members[m]
        dx, dy, dz = xyz[v, 0] - xyz[i, 0], xyz[v, 1] - xyz[i, 1], xyz[v, 2] - xyz[i, 2]
        x = axes[0] * dx + axes[1] * dy + axes[2] * dz
        y = axes[3] * dx + axes[4] * dy + axes[5] * dz
        length, distance = np.sqrt(x * x + y * y), np.sqrt(dx * dx + dy * dy + dz * dz)
        directed = v != i and length >= NO_DIRECTION * distance and length > 0.0
        unit = complex(x / length, y / length) if directed else 0j
        for o in range(orders.shape[0]):
            harmonic = 1.0 + 0j if orders[o] == 0 else unit
            for _ in range(orders[o] - 1):
                harmonic *= unit
            for s in range(heat.shape[0]):
                weighted = heat[s, m, b] * harmonic
                for c in range(channels):
                    out[s, o, c] += weighted * signal[v, c]


@kernel
def leakage(count, inner, heat, leak, seeds, longest):  # type: ignore[no-untyped-def]
    """How much heat of a seed has left the patch, at most, by the longest time.

    What is missing of a row of K is the flow over the rim, integrated; while the rim warms up, the flow is largest
    at the end.
    """
    worst = 0.0
    for s in range(heat.shape[0]):
        for b in range(seeds):
            flow = 0.0
            for m in range(inner, count):
                flow += leak[m] * abs(heat[s, m, b])
            worst = max(worst, flow)
    return longest * worst


@kernel
def grows(count, heat, seeds):  # type: ignore[no-untyped-def]
    """The first seed whose column of the kernel is longer than `LONGEST`, or is not finite; -1 if there is none."""
    for b in range(seeds):
        for s in range(heat.shape[0]):
            squared = 0.0
            for m in range(count):
                squared += heat[s, m, b] * heat[s, m, b]
            if not squared <= LONGEST * LONGEST:
                return b
    return -1


@kernel
def filter_patches(visit, matrix, table, longest, error, field, orders, out):  # type: ignore[no-untyped-def]
    """Responses of the vertices to visit, to `out` (N, S, M, C), from patches that grow until less than `error` leaks.

    `matrix` is CSR; `table` holds half bounds of spectra (B,), how many coefficients each has, and these (B, S, terms);
    `field` positions, tangent axes and signals. Returns the first vertex at which the kernel grows, which negative
    eigenvalues make it do, or -1.
    """
    indptr, indices, data = matrix
    ladder, lengths, series = table
    xyz, axes, signal = field
    n, radius = indptr.shape[0] - 1, 4
    done, seeds = np.ones(n, np.bool_), np.empty(BLOCK, np.int64)
    done[visit] = False
    place, members = np.full(n, -1, np.int32), np.empty(n, np.int32)
    start, near, weight = np.empty(n + 1, np.int32), np.empty(indices.shape[0], np.int32), np.empty(indices.shape[0])
    leak, heat = np.empty(n), np.empty((series.shape[1], n, BLOCK))
    now, before = np.empty((n, BLOCK)), np.empty((n, BLOCK))
    for i in visit:
        if done[i]:
            continue
        block = seeds[: choose_seeds(i, indptr, indices, done, seeds)]
        while True:
            count, inner = grow(block, radius, indptr, indices, place, members)
            bound = cut_out(count, members, place, indptr, indices, data, start, near, weight, leak)
            b = min(np.searchsorted(ladder, bound / 2), ladder.shape[0] - 1)
            diffuse(count, start, near, weight, ladder[b], series[b, :, : lengths[b]], now, before, heat)
            for m in range(count):
                place[members[m]] = -1
            bad = grows(count, heat, block.shape[0])
            if bad >= 0:
                return block[bad]
            left = leakage(count, inner, heat, leak, block.shape[0], longest)
            if left <= error:
                break
            radius += 1 + radius // 4
        for k in range(block.shape[0]):
            v = block[k]
            gather(v, k, count, members, heat, xyz, axes[v], signal, orders, out[v])
        if left < 1e-3 * error and radius > 1:
            radius -= 1
    return -1


@kernel
def filter_rows(first, heat, field, orders, out):  # type: ignore[no-untyped-def]
    """Responses of the vertices from `first` on, from whole columns of the kernel, (S, N, B)."""
    xyz, axes, signal = field
    everyone = np.arange(xyz.shape[0])
    for b in range(heat.shape[2]):
        i = first + b
        gather(i, b, xyz.shape[0], everyone, heat, xyz, axes[i], signal, orders, out[i])
