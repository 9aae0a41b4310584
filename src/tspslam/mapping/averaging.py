"""Many views to one answer: exposures taken out, weighted means, their variance, and mean directions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import brief
from ..types import FloatArray, Response
from .sampling import Answer, Sample
from .settings import ViewSettings
from .views import Rows

DARKEST = 0.02  # luminance below which a ratio says little of the exposure: five grey levels of 255
_ENOUGH = 100_000  # samples of faces that tell the exposures; of more, every n-th face
_LEAST_RESULTANT = 1e-3  # of tangents that cancel: a spread of 3.7 rad


class Mean(NamedTuple):
    """A level's luminance over the views.

    Attributes
    ----------
    value, variance : (n,) float64
        Weighted mean and variance; 0 without a view.
    views : (n,) int32
        How many.
    best : (n,) int32
        Row of the keyframe of the best view, that of the largest weight; -1 without one.
    uv : (n, 2) float64
        Barycentre in the best view, px.
    pixels : (n,) int32
        Pixels in the best view.
    """

    value: FloatArray
    variance: FloatArray
    views: NDArray[np.int32]
    best: NDArray[np.int32]
    uv: FloatArray
    pixels: NDArray[np.int32]

    def __repr__(self) -> str:
        return brief(self)


def estimate_gains(faces: Sample, keyframes: int, settings: ViewSettings) -> FloatArray:
    """Estimate the luminance of the map over that of each keyframe, from the faces that keyframes share.

    The log-ratio of two keyframes is the median over faces that both see, and at most one between them; logs of gains
    are the least-squares potential of these differences, with mean 0 over the keyframes that are joined.

    Parameters
    ----------
    faces : Sample
        Of faces.
    keyframes : int
        How many there are.
    settings : ViewSettings
        How many faces a comparison needs.

    Returns
    -------
    (K,) float64
        Of geometric mean 1.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.sparse.linalg import spsolve

    one, other, difference, count = _compare_exposures(faces, keyframes, settings)
    if not len(one):
        return np.ones(keyframes)
    edges = coo_array((np.ones(len(one)), (one, other)), shape=(keyframes, keyframes))
    _, part = connected_components(edges, directed=False)
    # weighted Laplacian of the keyframes' graph; each part's mean is held at 0
    W = coo_array((count, (one, other)), shape=(keyframes, keyframes)).tocsr()
    W = W + W.T
    degree = np.asarray(W.sum(axis=1)).ravel()
    L = (coo_array((degree, (np.arange(keyframes),) * 2), shape=W.shape) - W).tocsc()
    right = np.bincount(one, count * difference, minlength=keyframes) - np.bincount(
        other, count * difference, minlength=keyframes
    )
    hold = coo_array((np.full(keyframes, 1e-9 * max(degree.max(), 1.0)), (np.arange(keyframes),) * 2), shape=W.shape)
    logs = spsolve((L + hold).tocsc(), right)
    logs -= (np.bincount(part, logs) / np.bincount(part))[part]
    return np.exp(logs)


def _compare_exposures(
    faces: Sample, keyframes: int, settings: ViewSettings
) -> tuple[Rows, Rows, FloatArray, FloatArray]:
    """Pairs of keyframes, by how much the log of the first gain exceeds that of the second, and of how many faces."""
    step = 1 + len(faces.element) // _ENOUGH
    rows = np.flatnonzero(faces.element % step == 0)
    order = rows[np.argsort(faces.element[rows], kind="stable")]  # by keyframe within
    order = order[faces.value[order] > DARKEST]
    element, keyframe, logs = faces.element[order], faces.keyframe[order], np.log(faces.value[order])
    pairs = [np.flatnonzero(element[gap:] == element[:-gap]) for gap in (1, 2)]
    first = np.concatenate(pairs)
    second = np.concatenate([pairs[0] + 1, pairs[1] + 2])
    key, difference = keyframe[first] * keyframes + keyframe[second], logs[second] - logs[first]
    order = np.lexsort((difference, key))
    key, difference = key[order], difference[order]
    start = np.flatnonzero(np.diff(key, prepend=-1))
    count = np.diff(np.append(start, len(key)))
    good = count >= settings.min_shared
    start, count = start[good], count[good]
    median = 0.5 * (difference[start + (count - 1) // 2] + difference[start + count // 2])
    return key[start] // keyframes, key[start] % keyframes, median, count.astype(np.float64)


def average(sample: Sample, gain: FloatArray, count: int) -> Mean:
    """Average each element's luminance over its views.

    Parameters
    ----------
    sample : Sample
        One row for each element and keyframe.
    gain : (K,) float64
        Of the keyframes.
    count : int
        How many elements there are.

    Returns
    -------
    Mean
    """
    at, value = sample.element, sample.value * gain[sample.keyframe]
    views, total = np.bincount(at, minlength=count), np.bincount(at, sample.weight, minlength=count)
    best = best_rows(at, sample.weight, count)
    is_seen, first = best >= 0, np.maximum(best, 0)
    mean = np.zeros(count)
    mean[is_seen] = value[first[is_seen]]  # from which others are counted: one view is its own mean
    off = value - mean[at]
    with np.errstate(divide="ignore", invalid="ignore"):
        shift = np.where(is_seen, np.bincount(at, sample.weight * off, minlength=count) / total, 0.0)
        spread = np.bincount(at, sample.weight * (off - shift[at]) ** 2, minlength=count) / total
    uv, pixels = np.zeros((count, 2)), np.zeros(count, np.int32)
    uv[is_seen], pixels[is_seen] = sample.uv[first[is_seen]], sample.pixels[first[is_seen]]
    keyframe = np.full(count, -1, np.int32)
    keyframe[is_seen] = sample.keyframe[first[is_seen]]
    return Mean(mean + shift, np.where(is_seen, spread, 0.0), views.astype(np.int32), keyframe, uv, pixels)


def best_rows(at: Rows, weight: FloatArray, count: int) -> Rows:
    """Row of the largest weight of each element, the first of equal ones.

    Parameters
    ----------
    at : (S,) int64
        Elements.
    weight : (S,) float64
        Theirs.
    count : int
        How many elements there are.

    Returns
    -------
    (count,) int64
        -1 for an element without a row.
    """
    most = np.full(count, -np.inf)
    np.maximum.at(most, at, weight)
    rows = np.flatnonzero(weight == most[at])[::-1]  # the first one is written last
    best = np.full(count, -1)
    best[at[rows]] = rows
    return best


def average_answers(
    answer: Answer, count: int, order: int
) -> tuple[Response, NDArray[np.int32], FloatArray, FloatArray, NDArray[np.int32]]:
    """Take each vertex' response in its best view, and the mean direction over all views.

    Parameters
    ----------
    answer : Answer
        One row for each vertex and keyframe.
    count : int
        How many vertices there are, N.
    order : int
        Angular order.

    Returns
    -------
    response : Response
        That of the best view.
    keyframe : (N,) int32
        Row of the keyframe of that view; -1 where none counts.
    direction : (N, 3) float64
        Unit mean tangent; 0 where no view counts.
    spread : (N,) float64
        Standard deviation of the views' tangents about it, rad.
    views : (N,) int32
        How many have a tangent.
    """
    at = answer.vertex
    best = best_rows(at, answer.weight, count)
    is_seen = best >= 0
    z = np.zeros(count, np.complex128)
    z[is_seen] = answer.z[best[is_seen]]
    has_tangent = answer.direction.any(axis=1)  # a response of 0 points nowhere
    total, weight = np.bincount(at, answer.weight * has_tangent, minlength=count), answer.weight
    summed = np.stack([np.bincount(at, weight * column, minlength=count) for column in answer.direction.T], axis=1)
    length = np.linalg.norm(summed, axis=1)
    direction, views = np.zeros((count, 3)), np.bincount(at[has_tangent], minlength=count).astype(np.int32)
    direction[is_seen] = answer.direction[best[is_seen]]  # where the views' tangents cancel
    is_mean, is_sum = views > 1, length > 0
    direction[is_sum] = summed[is_sum] / length[is_sum, None]
    resultant = np.clip(length[is_mean] / total[is_mean], _LEAST_RESULTANT, 1.0)
    spread = np.zeros(count)
    spread[is_mean] = np.sqrt(-2 * np.log(resultant))  # of a wrapped normal distribution
    keyframe = np.full(count, -1, np.int32)
    keyframe[is_seen] = answer.keyframe[best[is_seen]]
    return Response(z, order, is_seen), keyframe, direction, spread, views
