"""Kernels of `cloud`: pairs of faces with a common edge, and the heights that make them lie flat."""

from __future__ import annotations

import numpy as np

from .._jit import kernel


@kernel
def find_hinges(edges, faces, face_edges):  # type: ignore[no-untyped-def]
    """Edges with exactly two faces: their ends and the faces' other corners (H, 4), and the two faces (H, 2)."""
    count = np.zeros(edges.shape[0], np.int32)
    sides = np.empty((edges.shape[0], 2), np.int32)
    for f in range(faces.shape[0]):
        for corner in range(3):
            e = face_edges[f, corner]
            if count[e] < 2:
                sides[e, count[e]] = f
            count[e] += 1
    total = (count == 2).sum()
    corners = np.empty((total, 4), np.uint32)  # without a sign: no test for one at each look-up
    pair = np.empty((total, 2), np.int32)
    h = 0
    for e in range(edges.shape[0]):
        if count[e] == 2:
            i, j = edges[e]
            for side in range(2):
                f = sides[e, side]
                corners[h, 2 + side] = faces[f, 0] + faces[f, 1] + faces[f, 2] - i - j
                pair[h, side] = f
            corners[h, 0], corners[h, 1] = i, j
            h += 1
    return corners, pair


@kernel
def fold_coefficients(uv, corners, spread, coefficient):  # type: ignore[no-untyped-def]
    """Write the weights c of each hinge with Σ c = 0 and Σ c uv = 0: Σ c q is 0 where q is linear over both faces.

    They are scaled so that errors of standard deviation `spread` in q make an error of 1. False where there are none:
    four corners on one line, or at one place.
    """
    ok = np.zeros(corners.shape[0], np.bool_)
    x, y = np.empty(4), np.empty(4)
    for h in range(corners.shape[0]):
        size = 0.0
        for a in range(4):
            x[a], y[a] = uv[corners[h, a], 0] - uv[corners[h, 0], 0], uv[corners[h, a], 1] - uv[corners[h, 0], 1]
            size = max(size, x[a] * x[a] + y[a] * y[a])
        coefficient[h, 1] = y[2] * x[3] - x[2] * y[3]
        coefficient[h, 2] = x[1] * y[3] - y[1] * x[3]
        coefficient[h, 3] = y[1] * x[2] - x[1] * y[2]
        coefficient[h, 0] = -(coefficient[h, 1] + coefficient[h, 2] + coefficient[h, 3])
        variance, longest = 0.0, 0.0
        for a in range(4):
            longest = max(longest, abs(coefficient[h, a]))
            variance += (coefficient[h, a] * spread[corners[h, a]]) ** 2
        ok[h] = longest > 1e-12 * size  # px² of area: below it is rounding
        for a in range(4):
            coefficient[h, a] = coefficient[h, a] / np.sqrt(variance) if ok[h] else 0.0
    return ok


@kernel
def fold(corners, coefficient, q):  # type: ignore[no-untyped-def]
    """Compute Σ c q of every hinge."""
    out = np.empty(corners.shape[0])
    for h in range(corners.shape[0]):
        out[h] = (
            coefficient[h, 0] * q[corners[h, 0]]
            + coefficient[h, 1] * q[corners[h, 1]]
            + coefficient[h, 2] * q[corners[h, 2]]
            + coefficient[h, 3] * q[corners[h, 3]]
        )
    return out


@kernel
def flatten(corners, coefficient, folds, tolerance, spread, stiffness, creases, outlying, steps):  # type: ignore[no-untyped-def]
    """Find the moves of the points that flatten the hinges, by reweighted least squares.

    Minimises Σ_i m_i (move_i / spread_i)² + stiffness Σ_h w_h (fold_h + Σ c move)², the weights m and w computed anew
    for each of `creases` from what is left of each fold (a crease is let be) and from how far each point has moved (an
    outlier lets go); each time some steps of conjugate gradients go on from the moves so far.
    """
    n = spread.shape[0]
    move, pull, left, direction, product = np.zeros(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    inverse, weight = np.empty(n), np.empty(corners.shape[0])
    for crease in creases:
        for i in range(n):
            pull[i] = 1 / (spread[i] ** 2 + (move[i] / outlying) ** 2)
            left[i], inverse[i] = -pull[i] * move[i], pull[i]
        for h in range(corners.shape[0]):
            rest = folds[h]
            for a in range(4):
                rest += coefficient[h, a] * move[corners[h, a]]
            weight[h] = stiffness / (1 + (rest / (crease * tolerance[h])) ** 2) ** 2
            for a in range(4):
                i, c = corners[h, a], coefficient[h, a]
                left[i] -= weight[h] * rest * c
                inverse[i] += weight[h] * c * c
        energy = 0.0
        for i in range(n):
            inverse[i] = 1 / inverse[i]
            direction[i] = inverse[i] * left[i]
            energy += left[i] * direction[i]
        for _ in range(steps):
            if not energy > 1e-24 * n:  # moves of 1e-12 standard deviations
                break
            _apply(corners, coefficient, weight, pull, direction, product)
            along = 0.0
            for i in range(n):
                along += direction[i] * product[i]
            step, before, energy = energy / along, energy, 0.0
            for i in range(n):
                move[i] += step * direction[i]
                left[i] -= step * product[i]
                energy += left[i] * left[i] * inverse[i]
            for i in range(n):
                direction[i] = inverse[i] * left[i] + energy / before * direction[i]
    return move


@kernel
def _apply(corners, coefficient, weight, pull, x, out):  # type: ignore[no-untyped-def]
    """Write (diag(pull) + Cᵀ diag(weight) C) x."""
    for i in range(x.shape[0]):
        out[i] = pull[i] * x[i]
    for h in range(corners.shape[0]):
        i, j, k, m = corners[h, 0], corners[h, 1], corners[h, 2], corners[h, 3]  # one by one: a slice costs more
        a, b, c, d = coefficient[h, 0], coefficient[h, 1], coefficient[h, 2], coefficient[h, 3]
        bent = weight[h] * (a * x[i] + b * x[j] + c * x[k] + d * x[m])
        out[i] += a * bent
        out[j] += b * bent
        out[k] += c * bent
        out[m] += d * bent
