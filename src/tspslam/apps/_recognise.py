"""Compiled loops of descriptors: histograms of magnitudes and levels, sums over the cells of an image."""

from __future__ import annotations

import numpy as np

from .._jit import inlined, kernel

HARMONICS = 4
"""Multiples of a response's phase that are summed over a cell."""

CHANNELS = 2 * HARMONICS + 1
"""Numbers of a filter in a cell: a magnitude, and the two parts of each harmonic of its phase."""


@kernel
def magnitudes(z, defined, size):  # type: ignore[no-untyped-def]
    """Magnitudes (N, K) to `size`, -1 where not defined; gives each filter's mean, 0 where it is nowhere defined."""
    total, count = np.zeros(z.shape[1]), np.zeros(z.shape[1])
    for i in range(z.shape[0]):
        for k in range(z.shape[1]):
            size[i, k] = -1.0
            if defined[i, k]:
                size[i, k] = np.sqrt(z[i, k].real ** 2 + z[i, k].imag ** 2)
                total[k] += size[i, k]
                count[k] += 1.0
    return total / np.maximum(count, 1.0)


@inlined
def _add(histogram, place):  # type: ignore[no-untyped-def]
    """Count one at a place, shared by the two bins beside it; the ends take what is beyond them."""
    last = histogram.shape[0] - 1
    place = min(max(place, 0.0), float(last))
    low = min(int(place), last - 1)
    histogram[low] += low + 1 - place
    histogram[low + 1] += place - low


@kernel
def magnitude_histograms(size, mean, low, high, found):  # type: ignore[no-untyped-def]
    """Histograms (K, bins) of log2 of magnitude over mean, between `low` and `high`."""
    per_octave = (found.shape[1] - 1) / (high - low)
    for i in range(size.shape[0]):
        for k in range(size.shape[1]):
            if size[i, k] >= 0.0 and mean[k] > 0.0:
                _add(found[k], (np.log2(size[i, k] / mean[k]) - low) * per_octave if size[i, k] > 0.0 else 0.0)


@kernel
def edge_steps(edges, vertex, vertex_ok):  # type: ignore[no-untyped-def]
    """Sum and count of the absolute difference of an edge's two ends."""
    total, count = 0.0, 0
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        if vertex_ok[i] and vertex_ok[j]:
            total += abs(vertex[i] - vertex[j])
            count += 1
    return total, count


@kernel
def level_histograms(edges, faces, levels, oks, contrast, middle, reach, found):  # type: ignore[no-untyped-def]
    """Histograms (4, bins), in units of the contrast, clipped at `reach`: see `recognise._levels`."""
    vertex, edge, face = levels
    vertex_ok, edge_ok, face_ok = oks
    centre = 0.5 * (found.shape[1] - 1)
    scale = centre / (reach * contrast)
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        if vertex_ok[i] and vertex_ok[j]:
            _add(found[0], 2.0 * scale * abs(vertex[i] - vertex[j]))
            if edge_ok[e]:
                _add(found[1], centre + scale * (edge[e] - 0.5 * (vertex[i] + vertex[j])))
    for f in range(faces.shape[0]):
        if not face_ok[f]:
            continue
        _add(found[3], centre + scale * (face[f] - middle))
        i, j, k = faces[f]
        if vertex_ok[i] and vertex_ok[j] and vertex_ok[k]:
            _add(found[2], centre + scale * (face[f] - (vertex[i] + vertex[j] + vertex[k]) / 3.0))


@kernel
def strengths(size, mean, found):  # type: ignore[no-untyped-def]
    """Joint magnitude of a vertex's filters, each over its mean; -1 where none is defined. Gives their mean."""
    total, count = 0.0, 0
    for i in range(size.shape[0]):
        squared, known = 0.0, False
        for k in range(size.shape[1]):
            if size[i, k] >= 0.0 and mean[k] > 0.0:
                squared += (size[i, k] / mean[k]) ** 2
                known = True
        found[i] = np.sqrt(squared) if known else -1.0
        if known:
            total += found[i]
            count += 1
    return total / max(count, 1)


@kernel
def pool_cells(z, size, mean, strength, typical, places, sums, counts):  # type: ignore[no-untyped-def]
    """Sums over cells (rows, columns, K, channels) of magnitudes and harmonics; a vertex counts in the four about it.

    A vertex's magnitudes are divided by its own strength plus the `typical` one: contrast counts, but only so far.
    """
    channels = sums.shape[3]
    values = np.empty(channels)
    for i in range(z.shape[0]):
        if strength[i] < 0.0:
            continue
        r, c = int(places[i, 0]), int(places[i, 1])
        down, right = places[i, 0] - r, places[i, 1] - c
        corners = (
            (r, c, (1.0 - down) * (1.0 - right)), (r, c + 1, (1.0 - down) * right),
            (r + 1, c, down * (1.0 - right)), (r + 1, c + 1, down * right),
        )  # fmt: skip
        for row, column, share in corners:
            if share > 0.0:
                counts[row, column] += share
        for k in range(z.shape[1]):
            if not (size[i, k] > 0.0 and mean[k] > 0.0):
                continue
            a, b = z[i, k].real / size[i, k], z[i, k].imag / size[i, k]
            p, q = size[i, k] / mean[k] / (strength[i] + typical), 0.0
            values[0] = p
            for h in range(1, channels, 2):
                p, q = p * a - q * b, p * b + q * a
                values[h], values[h + 1] = p, q
            for row, column, share in corners:
                if share > 0.0:
                    for x in range(channels):
                        sums[row, column, k, x] += share * values[x]
