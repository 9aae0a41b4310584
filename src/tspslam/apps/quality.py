"""Quality: how far a distorted textured complex is from its original, by what stands on it and by its harmonics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..topology.complex import Complex
from ..topology.harmonic import checked_bank, checked_order
from ..types import BoolArray, FloatArray, Signals, real_array
from ._quality_sides import (
    Side,
    areas_of,
    checked,
    edges_at,
    frames_of,
    levels_of,
    nearest_on,
    sampled_at,
    stars_of,
)  # fmt: skip

Given = tuple[ArrayLike, Complex, Signals]

FLOOR = 0.01  # luminance below which differences hardly count: K1 of structural similarity (Wang 2004)
FLOOR_RESPONSE = 0.03  # luminance, of responses: K2, that of contrast, there
HALF_WAY = 0.5  # mean edges: a vertex so far off counts half; at half an edge it may as well be its neighbour
LEAST_SHARE = 0.1  # of the reference's elements with a signal: fewer that can be compared say nothing about the rest
LEVELS = ("luminance", "edge", "face")

_MODES = np.arange(4)  # orders of the features
_QUANTILES = (np.arange(16) + 0.5) / 16
_SHELLS = 64  # around the centroid: they see a texture that has moved (development: 16, 32, 64 tried)
_FLOOR_SHAPE = 0.1  # edges: heights below which shape hardly counts; this and the next two by development
_FLOOR_LAYOUT = 0.05  # luminance over its mean
_FLOOR_DENSITY = 0.001  # edges over the root of the whole area: a million vertices
_BLOCKS = {
    **dict.fromkeys(LEVELS, FLOOR),
    **dict.fromkeys(("contrast", *(f"response {m}" for m in _MODES[1:])), FLOOR_RESPONSE),
    **dict.fromkeys((f"shape {m}" for m in _MODES), _FLOOR_SHAPE),
    "density": _FLOOR_DENSITY,
    "layout": _FLOOR_LAYOUT,
}
"""What features hold, in order, each with its floor: 16 quantiles, and 64 shells at the end."""
LARGEST = 1e30  # of a feature: float32 holds it, and float64 its square
FEATURES = len(_QUANTILES) * (len(_BLOCKS) - 1) + _SHELLS


class Quality(NamedTuple):
    """How far one complex is from another.

    Attributes
    ----------
    score : float
        Root mean square of the parts; 0 where the two are identical.
    parts : mapping of str to float
        Each 0 where nothing differs, about 1 where nothing agrees.
    """

    score: float
    parts: Mapping[str, float]


def compare_quality(reference: Given, distorted: Given, *, orders: Sequence[int] = (0, 1, 2, 3)) -> Quality:
    r"""Score of a distorted textured complex against its original: 0 is identical, about 1 has nothing in common.

    .. math:: \textrm{score}^2 = \operatorname{mean}_{\textrm{parts}} \operatorname{mean}_i
        \frac{|a_i - b_i|^2}{|a_i|^2 + |b_i|^2 + c^2}

    with a and b the signals of each level, then the harmonic responses of each order in the tangent planes of both
    surfaces: ``r_m = mean (s - s̄) e^{jmψ}`` over the star of a vertex, and the mean s̄ for m = 0.

    Parameters
    ----------
    reference, distorted : (xyz, ``complex_``, signals)
        xyz (N, 3) float array, m, both in one frame: nothing is aligned here. Complex of triangles. Signals (n,) or
        (n, C), luminance in [0, 1]; the constants c, 0.01 and 0.03, are made for that. Vertices without a signal have
        no position either.
    orders : sequence of int
        Angular orders m of the responses.

    Returns
    -------
    Quality
        Parts "geometry": distance d of corresponding vertices in mean edges at the vertex of the reference, ``d² / (d²
        + ¼)``; "luminance", "edge", "face": signals of the three levels, where both have any; "response m";
        "missing": share of the reference's elements that have lost their signal. All as root mean squares.

    Raises
    ------
    InputError
        If a side is not as described, or under a tenth of the reference's elements with a signal can be compared.
    GeometryError
        If the reference or the distorted complex has no face with signals at its vertices.

    Notes
    -----
    With the same faces, elements of the same number correspond. Otherwise the distorted surface is sampled at the
    points nearest to the reference's vertices, edges and faces, linearly between what stands on its three levels, and
    "geometry" is the larger of both ways. The score is not symmetric: lengths are in the reference's edges. No person's
    ratings were used, here or in choosing any constant.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> uv = np.array([[0, 0], [8, 0], [0, 8], [8, 8.0]])
    >>> xyz, square = np.column_stack([uv, np.full(4, 9.0)]), build_complex([[0, 1, 2], [1, 2, 3]], 4)
    >>> image = np.eye(9)
    >>> sharp, dark = (sample_signals(image * k, uv, square) for k in (1.0, 0.8))
    >>> compare_quality((xyz, square, sharp), (xyz, square, sharp)).score
    0.0
    >>> 0 < compare_quality((xyz, square, sharp), (xyz, square, dark)).score < 0.2
    True
    """
    modes = _checked_orders(orders)
    a, b = checked(reference, "reference"), checked(distorted, "distorted")
    if a.values.shape[1] != b.values.shape[1]:
        raise InputError(
            f"distorted: signals have {b.values.shape[1]} channels, expected {a.values.shape[1]} as in the reference"
        )
    same = a.complex_.n == b.complex_.n and np.array_equal(a.complex_.faces, b.complex_.faces)
    same = same and np.array_equal(a.complex_.edges, b.complex_.edges)
    onto = b if same else sampled_at(a, b)
    both = a.ok & onto.ok
    _check_share(int(both.sum()), int(a.ok.sum()))
    unit = edges_at(a, "reference")
    parts = {"geometry": _root(_offset(a.xyz, onto.xyz, unit)[both[: a.complex_.n]])}
    if not same:
        parts["geometry"] = max(parts["geometry"], _back(a, b, unit))
    parts |= _signal_parts(a, onto, both) | _response_parts(a, onto, both, unit, modes)
    parts["missing"] = float(np.sqrt(1 - both.sum() / a.ok.sum()))
    return Quality(_root(np.square(list(parts.values()))), parts)


def quality_features(xyz: ArrayLike, complex_: Complex, signals: Signals) -> NDArray[np.float32]:
    """Numbers of a textured complex that travel in place of the original: what `compare_features` compares.

    Parameters
    ----------
    xyz : (N, 3) float array
        Vertices, m, in any frame: the numbers do not change with a rigid motion, nor with the unit of length.
    complex_ : Complex
        Of triangles.
    signals : Signals
        Luminance in [0, 1]; of several channels the mean counts.

    Returns
    -------
    (256,) float32
        16 quantiles of each of: vertex, edge and face signals, standard deviation in the star, magnitudes of the
        responses of orders 1 to 3, of those of the heights over the tangent plane, in edges, of orders 0 to 3, mean
        edges at the vertices over the root of the area; then the faces' luminance over its mean, times area, in 64
        shells around the centroid.

    Raises
    ------
    InputError, GeometryError
        As `compare_quality`.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> uv = np.array([[0, 0], [8, 0], [0, 8], [8, 8.0]])
    >>> xyz, square = np.column_stack([uv, np.full(4, 9.0)]), build_complex([[0, 1, 2], [1, 2, 3]], 4)
    >>> quality_features(xyz, square, sample_signals(np.eye(9), uv, square)).shape
    (256,)
    """
    side = checked((xyz, complex_, signals), "quality_features")
    side = side._replace(values=side.values.mean(axis=1, keepdims=True))
    unit, value = edges_at(side, "quality_features"), side.values[:, 0]
    stars = stars_of(side, frames_of(side, side, side.ok)[0], unit, 0, side.ok, _MODES)
    used = stars.used
    several = [value[at][side.ok[at]] for at in levels_of(complex_)]
    several += [np.sqrt(stars.plain[used, 2]), *np.abs(stars.texture[used, 1:].T), *np.abs(stars.shape[used].T)]
    area = areas_of(side)
    several.append(unit[used] / (np.sqrt(area.sum()) or 1))
    quantiles = [np.quantile(each, _QUANTILES) if len(each) else np.zeros(len(_QUANTILES)) for each in several]
    found = np.concatenate([*quantiles, _layout(side, value, area)])
    if np.abs(found).max() > LARGEST:
        most = float(np.abs(value).max())
        raise InputError(f"quality_features: signals reach {most:.3g}, expected luminance, at most {LARGEST:g}")
    return found.astype(np.float32)


def compare_features(reference: ArrayLike, distorted: ArrayLike) -> Quality:
    """Score of a distorted complex by features alone: 0 is identical, about 1 has nothing in common.

    Parameters
    ----------
    reference, distorted : (256,) float array
        What `quality_features` gives for each.

    Returns
    -------
    Quality
        Parts "luminance", "edge", "face", "contrast", "response m", "shape m", "density", "layout". Symmetric.

    Raises
    ------
    InputError
        If either is not 256 finite numbers.

    Examples
    --------
    >>> compare_features(np.ones(256), np.ones(256)).score
    0.0
    """
    one, other = _checked_features(reference, "reference"), _checked_features(distorted, "distorted")
    sizes = [_SHELLS if name == "layout" else len(_QUANTILES) for name in _BLOCKS]
    off = np.split(_relative(one, other, np.repeat(list(_BLOCKS.values()), sizes)), np.cumsum(sizes)[:-1])
    parts = {name: _root(squares) for name, squares in zip(_BLOCKS, off, strict=True)}
    return Quality(_root(np.square(list(parts.values()))), parts)


def _layout(side: Side, value: FloatArray, area: FloatArray) -> FloatArray:
    """Luminance of the faces over its mean, in shells (64,) around the centroid: of equal area where it is a disc."""
    value, middle = value[levels_of(side.complex_)[2]], side.xyz[side.complex_.faces].mean(axis=1)
    if not area.sum() > 0:
        return np.zeros(_SHELLS)
    area = area / area.sum()
    squared = ((middle - area @ middle) ** 2).sum(axis=1)
    spread = float(area @ squared) or 1.0
    height = _SHELLS * area * (value - area @ value)
    depth = np.minimum(squared / (2 * spread), 1) * (_SHELLS - 1)  # a face lies between two shells: nothing jumps
    low = np.minimum(depth.astype(np.int64), _SHELLS - 2)
    inner, outer = height * (1 + low - depth), height * (depth - low)
    return np.asarray(np.bincount(low, inner, _SHELLS) + np.bincount(low + 1, outer, _SHELLS), np.float64)


def _checked_features(features: ArrayLike, what: str) -> FloatArray:
    values = np.asarray(real_array(features, f"{what}: features", f"({FEATURES},)"), np.float64)
    if values.shape != (FEATURES,) or not (np.abs(values) <= 2 * LARGEST).all():
        raise InputError(f"{what}: features have shape {values.shape}, expected ({FEATURES},), all of them finite")
    return values


def _signal_parts(a: Side, b: Side, both: BoolArray) -> dict[str, float]:
    off = _relative(a.values, b.values, FLOOR).mean(axis=1)
    levels = [(name, off[at][both[at]]) for name, at in zip(LEVELS, levels_of(a.complex_), strict=True)]
    return {name: _root(values) for name, values in levels if len(values)}


def _response_parts(a: Side, b: Side, both: BoolArray, unit: FloatArray, modes: NDArray[np.int64]) -> dict[str, float]:
    """Differences of the responses at vertices that both have with a star."""
    frames = frames_of(a, b, both)
    off, used = np.zeros((a.complex_.n, len(modes))), np.zeros(a.complex_.n, bool)
    channels = a.values.shape[1]
    for c in range(channels):
        one, other = (stars_of(side, frame, unit, c, both, modes) for side, frame in zip((a, b), frames, strict=True))
        used = one.used
        floors = np.where(modes == 0, FLOOR, FLOOR_RESPONSE)
        off += _relative(one.texture, other.texture, floors) / channels
    return {f"response {m}": _root(off[used, k]) for k, m in enumerate(modes)}


def _back(a: Side, b: Side, unit: FloatArray) -> float:
    """How far the vertices of b are from the surface of a, in the edges there."""
    xyz = b.xyz[b.ok[: b.complex_.n]]
    place, nodes, _ = nearest_on(xyz, a)
    unit = np.append(unit, np.full(len(a.ok) - len(unit), unit.mean()))  # of an edge without a face
    return _root(_offset(place, xyz, unit[nodes[:, 0]]))


def _offset(xyz: FloatArray, other: FloatArray, unit: FloatArray) -> FloatArray:
    squared = np.minimum(np.linalg.norm(xyz - other, axis=1) / unit, 1e9) ** 2
    return np.asarray(squared / (squared + HALF_WAY**2))


def _relative(a: Any, b: Any, floor: Any) -> FloatArray:
    return np.asarray(np.abs(a - b) ** 2 / (np.abs(a) ** 2 + np.abs(b) ** 2 + floor**2))


def _root(squares: FloatArray) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else 0.0


def _check_share(both: int, ours: int) -> None:
    if both < LEAST_SHARE * ours:
        raise InputError(
            f"distorted: {both} of the reference's {ours} elements with a signal have one here,"
            f" expected at least {LEAST_SHARE:.0%}"
        )


def _checked_orders(orders: Sequence[int]) -> NDArray[np.int64]:
    modes = [checked_order(order, "compare_quality") for order in checked_bank(orders, (1,), "compare_quality")[0]]
    if len(set(modes)) < len(modes):
        raise InputError(f"compare_quality: orders are {tuple(modes)}, expected each once")
    return np.array(modes, np.int64)
