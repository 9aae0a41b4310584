"""Compiled kernels of the signals' denoising: pairs of elements, their weights, and steps of conjugate gradients.

Elements are counted vertices first, then edges, then faces. Pairs come in four kinds: an edge and its ends ``(E, 2)``,
a face and its vertices ``(F, 3)``, a face and its edges ``(F, 3)``, two faces of one edge ``(P,)``. ``own`` is what an
element's own signal weighs, the number of pixels that it averages over; 0 marks one without a signal.
"""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel, reassociated_kernel

FEW = 8  # faces of an edge that are still joined two by two: a surface has two, a book's spine any number
STEEPEST = 0.02  # added to the spread of a star's places, as a share of its trace: stars on a line have no slope across


@kernel
def join_faces(faces, face_edges, n_edges):  # type: ignore[no-untyped-def]
    """Pairs of faces that share an edge (P, 2), and the vertices of both that are not on it (P, 2)."""
    start = np.zeros(n_edges + 1, np.int32)
    for f in range(faces.shape[0]):
        for side in range(3):
            start[face_edges[f, side] + 1] += 1
    count = 0
    for e in range(n_edges):
        k = start[e + 1]
        count += k * (k - 1) // 2 if k <= FEW else 0
        start[e + 1] += start[e]
    slot, fill = np.empty(start[n_edges], np.int32), start[:-1].copy()
    for f in range(faces.shape[0]):
        for side in range(3):
            slot[fill[face_edges[f, side]]] = 3 * f + side
            fill[face_edges[f, side]] += 1
    pairs, opposite, count = np.empty((count, 2), np.uint32), np.empty((count, 2), np.uint32), 0
    for e in range(n_edges):
        if start[e + 1] - start[e] > FEW:
            continue
        for p in range(start[e], start[e + 1]):
            for q in range(p + 1, start[e + 1]):
                f, g = slot[p] // 3, slot[q] // 3
                pairs[count, 0], pairs[count, 1] = f, g
                opposite[count, 0] = faces[f, (slot[p] + 2) % 3]  # the sides are (i, j), (j, k), (i, k)
                opposite[count, 1] = faces[g, (slot[q] + 2) % 3]
                count += 1
    return pairs, opposite


@kernel
def place_vertices(edges, faces, face_edges, edge_uv, edge_ok, uv):  # type: ignore[no-untyped-def]
    """Where vertices are, from middles of edges: at a corner of a triangle, those beside it less that across."""
    weight = np.zeros(uv.shape[0])
    for f in range(faces.shape[0]):
        a, b, c = face_edges[f, 0], face_edges[f, 1], face_edges[f, 2]
        if not (edge_ok[a] and edge_ok[b] and edge_ok[c]):
            continue
        for axis in range(2):
            total = edge_uv[a, axis] + edge_uv[b, axis] + edge_uv[c, axis]
            uv[faces[f, 0], axis] += total - 2 * edge_uv[b, axis]
            uv[faces[f, 1], axis] += total - 2 * edge_uv[c, axis]
            uv[faces[f, 2], axis] += total - 2 * edge_uv[a, axis]
        for side in range(3):
            weight[faces[f, side]] += 1
    has_corner = weight > 0
    for e in range(edges.shape[0]):
        for side in range(2):
            i = edges[e, side]
            if edge_ok[e] and not has_corner[i]:
                uv[i] += edge_uv[e]
                weight[i] += 1
    for i in range(uv.shape[0]):
        uv[i] /= max(weight[i], 1.0)


@kernel
def compare_links(x, own, n, faces, face_edges):  # type: ignore[no-untyped-def]
    """Each vertex against the mean of the edges across its faces, which share no pixel with it.

    Returns the difference, the variance of those edges' signals, the mean square of both for noise of variance 1, and
    how many edges they are (n,).
    """
    count, total, squares = np.zeros(n), np.zeros(n), np.zeros(n)
    gain, expected = np.zeros(n), np.zeros(n)
    for f in range(faces.shape[0]):
        for side in range(3):
            i, e = faces[f, side], n + face_edges[f, (side + 1) % 3]
            if own[i] > 0 and own[e] > 0:
                d = x[e] - x[i]
                count[i] += 1
                total[i] += d
                squares[i] += d * d
                gain[i] += 1 / own[e]
    for i in range(n):
        if count[i] > 0:
            mean = total[i] / count[i]
            squares[i] = max(squares[i] / count[i] - mean * mean, 0.0)
            total[i] = mean
            expected[i] = gain[i] / count[i] * (1 - 1 / count[i])
            gain[i] = gain[i] / (count[i] * count[i]) + 1 / own[i]
    return total, squares, gain, expected, count


@kernel
def compare_ends(x, own, edges, off, chosen):  # type: ignore[no-untyped-def]
    """How much of what sets chosen vertices off from the edges across is found in edges that end there, in pixels.

    Returns ``Σ p d (d + x_e - x_i)``, p an edge's pixels and -d the vertex' difference `off`, ``Σ d²``, ``Σ p`` and the
    number of ends.
    """
    n, shared, square, pixels, count = off.shape[0], 0.0, 0.0, 0.0, 0
    for e in range(edges.shape[0]):
        for side in range(2):
            i = edges[e, side]
            if chosen[i] and own[n + e] > 0:
                shared -= own[n + e] * off[i] * (x[n + e] - x[i] - off[i])
                square += off[i] * off[i]
                pixels += own[n + e]
                count += 1
    return shared, square, pixels, count


@kernel
def difference(x, own, one, other):  # type: ignore[no-untyped-def]
    """Sum of squared differences of pairs, of their variances for noise of variance 1, and how many there are."""
    total, gain, count = 0.0, 0.0, 0
    for p in range(one.shape[0]):
        i, j = one[p], other[p]
        if own[i] > 0 and own[j] > 0:
            total += (x[i] - x[j]) ** 2
            gain += 1 / own[i] + 1 / own[j]
            count += 1
    return total, gain, count


@inlined
def _add_offset(sums, i, u, v, d):  # type: ignore[no-untyped-def]
    sums[i, 0] += 1
    sums[i, 1] += u
    sums[i, 2] += v
    sums[i, 3] += d
    sums[i, 4] += u * u
    sums[i, 5] += u * v
    sums[i, 6] += v * v
    sums[i, 7] += u * d
    sums[i, 8] += v * d


@kernel
def fit_slopes(x, own, places, edges, faces, slope):  # type: ignore[no-untyped-def]
    """Slope (n, 2) of the plane through the edges and faces at each vertex; 0 with fewer than three of them."""
    n, first_face = slope.shape[0], slope.shape[0] + edges.shape[0]
    sums = np.zeros((n, 9))
    for e in range(edges.shape[0]):
        for side in range(2):
            i, j = edges[e, side], n + e
            if own[i] > 0 and own[j] > 0:
                _add_offset(sums, i, places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], x[j] - x[i])
    for f in range(faces.shape[0]):
        for side in range(3):
            i, j = faces[f, side], first_face + f
            if own[i] > 0 and own[j] > 0:
                _add_offset(sums, i, places[j, 0] - places[i, 0], places[j, 1] - places[i, 1], x[j] - x[i])
    for i in range(n):
        slope[i, 0], slope[i, 1] = 0.0, 0.0
        if sums[i, 0] < 3:
            continue
        w, u, v, d = 1 / sums[i, 0], sums[i, 1], sums[i, 2], sums[i, 3]
        uu, uv, vv = sums[i, 4] - w * u * u, sums[i, 5] - w * u * v, sums[i, 6] - w * v * v
        ud, vd = sums[i, 7] - w * u * d, sums[i, 8] - w * v * d
        more = STEEPEST * (uu + vv)
        uu, vv = uu + more, vv + more
        determinant = uu * vv - uv * uv
        if determinant > 0:
            slope[i, 0], slope[i, 1] = (vv * ud - uv * vd) / determinant, (uu * vd - uv * ud) / determinant


@kernel
def average_tensors(slope, own, edges, tensor):  # type: ignore[no-untyped-def]
    """Mean (n, 3) of the products ``g gᵀ`` (uu, uv, vv) of slopes over a vertex and its neighbours."""
    n = slope.shape[0]
    count = np.ones(n)
    for i in range(n):
        u, v = slope[i, 0], slope[i, 1]
        tensor[i, 0], tensor[i, 1], tensor[i, 2] = u * u, u * v, v * v
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        if not (own[i] > 0 and own[j] > 0):
            continue
        for a, b in ((i, j), (j, i)):
            u, v = slope[b, 0], slope[b, 1]
            tensor[a, 0] += u * u
            tensor[a, 1] += u * v
            tensor[a, 2] += v * v
            count[a] += 1
    for i in range(n):
        for k in range(3):
            tensor[i, k] /= count[i]


@kernel
def weigh_evenly(own, edges, faces, face_edges, pairs, by_kind, weights):  # type: ignore[no-untyped-def]
    """Give each pair the weight of its kind, 0 where an element has no signal."""
    at_edge, at_face, of_edge, of_pair = weights
    first_face = own.shape[0] - faces.shape[0]
    n = first_face - edges.shape[0]
    for e in range(edges.shape[0]):
        for side in range(2):
            at_edge[e, side] = by_kind[0] if own[edges[e, side]] > 0 and own[n + e] > 0 else 0.0
    for f in range(faces.shape[0]):
        is_ok = own[first_face + f] > 0
        for side in range(3):
            at_face[f, side] = by_kind[1] if is_ok and own[faces[f, side]] > 0 else 0.0
            of_edge[f, side] = by_kind[2] if is_ok and own[n + face_edges[f, side]] > 0 else 0.0
    for p in range(pairs.shape[0]):
        is_ok = own[first_face + pairs[p, 0]] > 0 and own[first_face + pairs[p, 1]] > 0
        of_pair[p] = by_kind[3] if is_ok else 0.0


@inlined
def _step(x, places, i, j, a, b, c):  # type: ignore[no-untyped-def]
    """Squared step from element i to j, and what slopes foretell of it: ``d² + (u, v) T (u, v)ᵀ``, T = (a, b; b, c)."""
    d, u, v = x[j] - x[i], places[j, 0] - places[i, 0], places[j, 1] - places[i, 1]
    return d * d + a * u * u + 2 * b * u * v + c * v * v


@kernel
def _average_over(elements, tensor):  # type: ignore[no-untyped-def]
    """Mean of the tensors of each element's vertices."""
    mean, share = np.zeros((elements.shape[0], 3)), 1 / elements.shape[1]
    for e in range(elements.shape[0]):
        for side in range(elements.shape[1]):
            for k in range(3):
                mean[e, k] += share * tensor[elements[e, side], k]
    return mean


@reassociated_kernel
def weigh_by_steps(x, places, tensor, edges, faces, face_edges, pairs, by_kind, usual, weights):  # type: ignore[no-untyped-def]
    """Turn each weight that is not 0 into ``by_kind / (usual + step)``; the tensor of a pair is the mean of both's."""
    at_edge, at_face, of_edge, of_pair = weights
    first_face = x.shape[0] - faces.shape[0]
    n = first_face - edges.shape[0]
    of_edges, of_faces = _average_over(edges, tensor), _average_over(faces, tensor)
    for e in range(edges.shape[0]):
        a, b, c = 0.5 * of_edges[e, 0], 0.5 * of_edges[e, 1], 0.5 * of_edges[e, 2]
        for side in range(2):
            if at_edge[e, side] > 0:
                i = edges[e, side]
                p, q, r = a + 0.5 * tensor[i, 0], b + 0.5 * tensor[i, 1], c + 0.5 * tensor[i, 2]
                at_edge[e, side] = by_kind[0] / (usual[0] + _step(x, places, n + e, i, p, q, r))
    for f in range(faces.shape[0]):
        a, b, c = 0.5 * of_faces[f, 0], 0.5 * of_faces[f, 1], 0.5 * of_faces[f, 2]
        for side in range(3):
            i, e = faces[f, side], face_edges[f, side]
            if at_face[f, side] > 0:
                p, q, r = a + 0.5 * tensor[i, 0], b + 0.5 * tensor[i, 1], c + 0.5 * tensor[i, 2]
                at_face[f, side] = by_kind[1] / (usual[1] + _step(x, places, first_face + f, i, p, q, r))
            if of_edge[f, side] > 0:
                p, q, r = a + 0.5 * of_edges[e, 0], b + 0.5 * of_edges[e, 1], c + 0.5 * of_edges[e, 2]
                of_edge[f, side] = by_kind[2] / (usual[2] + _step(x, places, first_face + f, n + e, p, q, r))
    for s in range(pairs.shape[0]):
        f, g = pairs[s, 0], pairs[s, 1]
        if of_pair[s] > 0:
            p, q = 0.5 * (of_faces[f, 0] + of_faces[g, 0]), 0.5 * (of_faces[f, 1] + of_faces[g, 1])
            r = 0.5 * (of_faces[f, 2] + of_faces[g, 2])
            of_pair[s] = by_kind[3] / (usual[3] + _step(x, places, first_face + f, first_face + g, p, q, r))


@reassociated_kernel
def _flow(x, edges, faces, face_edges, pairs, weights, out):  # type: ignore[no-untyped-def]
    """Add ``Σ w (x_i - x_j)`` over the pairs of each element i to `out`."""
    at_edge, at_face, of_edge, of_pair = weights
    first_face = x.shape[0] - faces.shape[0]
    n = first_face - edges.shape[0]
    for e in range(edges.shape[0]):
        i, j, here = edges[e, 0], edges[e, 1], x[n + e]
        a, b = at_edge[e, 0] * (here - x[i]), at_edge[e, 1] * (here - x[j])
        out[i] -= a
        out[j] -= b
        out[n + e] += a + b
    for f in range(faces.shape[0]):
        here, total = x[first_face + f], 0.0
        for side in range(3):
            i, e = faces[f, side], n + face_edges[f, side]
            a, b = at_face[f, side] * (here - x[i]), of_edge[f, side] * (here - x[e])
            out[i] -= a
            out[e] -= b
            total += a + b
        out[first_face + f] += total
    for p in range(pairs.shape[0]):
        i, j = first_face + pairs[p, 0], first_face + pairs[p, 1]
        a = of_pair[p] * (x[i] - x[j])
        out[i] += a
        out[j] -= a


@reassociated_kernel
def _diagonal(own, edges, faces, face_edges, pairs, weights):  # type: ignore[no-untyped-def]
    """Inverse of the system's diagonal; 0 for an element without a signal."""
    at_edge, at_face, of_edge, of_pair = weights
    first_face = own.shape[0] - faces.shape[0]
    n = first_face - edges.shape[0]
    diagonal = own.copy()
    for e in range(edges.shape[0]):
        for side in range(2):
            diagonal[edges[e, side]] += at_edge[e, side]
            diagonal[n + e] += at_edge[e, side]
    for f in range(faces.shape[0]):
        for side in range(3):
            diagonal[faces[f, side]] += at_face[f, side]
            diagonal[n + face_edges[f, side]] += of_edge[f, side]
            diagonal[first_face + f] += at_face[f, side] + of_edge[f, side]
    for p in range(pairs.shape[0]):
        for side in range(2):
            diagonal[first_face + pairs[p, side]] += of_pair[p]
    for i in range(own.shape[0]):
        diagonal[i] = 1 / diagonal[i] if own[i] > 0 else 0.0
    return diagonal


@reassociated_kernel
def relax(x, y, own, edges, faces, face_edges, pairs, weights, steps):  # type: ignore[no-untyped-def]
    """Take x towards the least of ``Σ own (x - y)² + Σ w (x_i - x_j)²`` by steps of conjugate gradients."""
    inverse = _diagonal(own, edges, faces, face_edges, pairs, weights)
    product = np.zeros(x.shape[0])
    _flow(x, edges, faces, face_edges, pairs, weights, product)
    left = own * (y - x) - product
    direction = inverse * left
    energy = (left * direction).sum()
    for _ in range(steps):
        if not energy > 0:
            break
        for i in range(x.shape[0]):
            product[i] = own[i] * direction[i]
        _flow(direction, edges, faces, face_edges, pairs, weights, product)
        curvature = 0.0
        for i in range(x.shape[0]):
            curvature += direction[i] * product[i]
        step, before, energy = energy / curvature, energy, 0.0
        for i in range(x.shape[0]):
            x[i] += step * direction[i]
            left[i] -= step * product[i]
            energy += left[i] * left[i] * inverse[i]
        for i in range(x.shape[0]):
            direction[i] = inverse[i] * left[i] + energy / before * direction[i]
