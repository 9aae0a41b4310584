"""Recognise: what a complex and its responses look like in a few hundred numbers; places and things seen before."""

from __future__ import annotations

from numbers import Real
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import brief
from .._checks import require, told
from ..errors import InputError
from ..topology.complex import Complex
from ..topology.laplacian import check_values
from ..types import Bank, BoolArray, FloatArray, Response, Signals, real_array

Descriptors = NDArray[np.float32]

_SILENT = 1e-6  # luminance: less is rounding; a step of 16-bit pixels is 1.5e-5
_BINS = 8  # of a filter's magnitudes
_LOW, _HIGH = -4.0, 2.0  # log2 of magnitude over mean: on development images 2 % are beyond
_LEVEL_BINS = 12  # of each comparison of levels
_REACH = 3.0  # mean steps along an edge, beyond which differences of levels count alike
_LONE = 2.0  # mean numbers of vertices of a cell that each cell's own are mixed with: few vertices tell little
_COMMON = 10  # keyframes of 0 that are mixed with the mean of all: a mean of few is no habit of a recording
_MOST_CELLS = 4096


class Places(NamedTuple):
    """Pairs of keyframes that may show the same place, best first.

    ``first``, ``second``: (P,) int64, rows of the descriptors, ``first < second``; ``score``: (P,) float32, falling.
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    score: NDArray[np.float32]

    def __repr__(self) -> str:
        return brief(self)


def describe(
    complex_: Complex,
    signals: Signals,
    response: Response | Bank,
    *,
    layout: tuple[int, int] | None = None,
    uv: ArrayLike | None = None,
    size: tuple[int, int] | None = None,
) -> Descriptors:
    """Describe a complex and its responses by a fixed number of numbers, so that a dot product compares two.

    Without a layout nothing changes when the camera turns about its axis: what counts is how strong the responses are,
    and how faces and edges differ from their vertices. With a layout, what the responses are and where they point is
    told for each cell of the image: better for places, if the camera stays upright. Neither changes with gain and
    offset of the image, where responses are centred ones (the default of `tspslam.tmahf`).

    Parameters
    ----------
    complex_ : Complex
        N vertices, E edges, F faces.
    signals : Signals
        Of the complex, (n,) or (n, C). Marked elements are left out.
    response : Response or Bank
        Of the complex; K filters (times C channels) of order 1 or more count, those of order 0 do not.
    layout : (rows, columns), optional
        Cells of the image, two or more; 6 by 3 does for places.
    uv : (N, 2) float array, optional
        Projections of the vertices, px; needed for a layout.
    size : (width, height), optional
        Of the image, px; needed for a layout.

    Returns
    -------
    (D,) float32
        Of length 1. D = 8 K + 48 C, or with a layout 9 K times the number of cells; it hangs on nothing else. All 0
        where there is nothing to tell: on a constant image, without edges, and with a layout also where no response is
        defined.

    Raises
    ------
    InputError
        If the arrays do not belong to the complex or are not finite, all orders are 0, or a layout lacks `uv` or
        `size`.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals, tmahf_bank
    >>> rng = np.random.default_rng(0)
    >>> uv, image = rng.random((5, 2)) * 31, rng.random((32, 32))
    >>> complex_ = build_complex([[0, 1, 2], [0, 2, 3], [1, 2, 4]], 5)
    >>> signals = sample_signals(image, uv, complex_)
    >>> bank = tmahf_bank(complex_, uv, signals, orders=(1, 2))
    >>> describe(complex_, signals, bank).shape
    (64,)
    >>> describe(complex_, signals, bank, layout=(2, 2), uv=uv, size=(32, 32)).shape
    (72,)
    """
    require(complex_, Complex, "complex_")
    require(signals, Signals, "signals")
    _check_signals(complex_, signals)
    z, defined = _filters(response, complex_.n)
    size_of, mean = _sizes(z, defined)
    if layout is None:
        if uv is not None or size is not None:
            raise InputError("describe: uv and size are given without a layout, expected layout=(rows, columns) too")
        return _unit(np.concatenate([_magnitudes(size_of, mean), _levels(complex_, signals)]))
    places, cells = _places_in(layout, uv, size, defined, signals)
    return _unit(_cells(z, size_of, mean, places, cells))


def compare_descriptors(queries: ArrayLike, known: ArrayLike, *, mean: ArrayLike | None = None) -> Descriptors:
    """Compare descriptors by the cosine of the angle between them.

    What most keyframes of a recording share tells no two of them apart: take it out by `mean`.

    Parameters
    ----------
    queries : (Q, D) float array
        Descriptors, a row each, as `describe` gives them.
    known : (K, D) float array
        Those that they are compared with.
    mean : (D,) float array, optional
        What is taken out of all of them first, such as ``known.mean(axis=0)``.

    Returns
    -------
    (Q, K) float32
        From -1 to 1, and from 0 without a layout and a mean; 1 is alike. 0 where one of the two is all 0: it is like
        nothing.

    Raises
    ------
    InputError
        If they are no rows of as many finite numbers.

    Examples
    --------
    >>> compare_descriptors([[1, 0], [0, 0]], [[1, 0], [0.6, 0.8]]).round(3).tolist()
    [[1.0, 0.6000000238418579], [0.0, 0.0]]
    """
    one, other = _rows(queries, "queries"), _rows(known, "known")
    if one.shape[1] != other.shape[1]:
        raise InputError(f"queries have {one.shape[1]} numbers, known ones {other.shape[1]}, expected as many")
    if mean is not None:
        shared = _rows(np.atleast_2d(real_array(mean, "mean", "(D,)")), "mean")
        if shared.shape != (1, one.shape[1]):
            raise InputError(
                f"mean has shape {np.shape(mean)}, expected ({one.shape[1]},), the numbers of a descriptor"
            )
        one, other = ((rows - shared) * rows.any(axis=1, keepdims=True) for rows in (one, other))
    return np.clip(_unit_rows(one) @ _unit_rows(other).T, -1, 1).astype(np.float32)


def find_places(
    descriptors: ArrayLike,
    *,
    apart: int = 10,
    words: ArrayLike | None = None,
    weight: float = 0.05,
    least: float = 0.0,
) -> Places:
    """Find pairs of keyframes that may show the same place, best first.

    The score of a pair is the similarity of its descriptors, freed of what all keyframes share; with words it is that
    of the words plus `weight` times that of the descriptors.

    Parameters
    ----------
    descriptors : (K, D) float array
        One row for each keyframe, in the order of time, as `describe` gives them.
    apart : int
        Keyframes nearer in time than this are left out, 1 or more.
    words : (K, K) float array, optional
        A second similarity: row j, column i < j says how much of keyframe j is seen in i, in [0, 1], such as the share
        of its binary words that vote for i. The other triangle is not read.
    weight : float
        Of the descriptors beside words, 0 to 1000. The default fits shares of votes, where 0.04 tells a place.
    least : float
        Pairs with a score up to this are left out.

    Returns
    -------
    Places
        Of equal ones the earlier pair comes first.

    Raises
    ------
    InputError
        If arrays are not as described or not finite, or a number is out of its range.

    Examples
    --------
    >>> found = find_places([[1, 0], [0, 1], [0.8, 0.6]], apart=2)
    >>> found.first.tolist(), found.second.tolist(), float(found.score[0]) > 0.7
    ([0], [2], True)
    """
    rows = _rows(descriptors, "descriptors")
    if isinstance(apart, bool) or not isinstance(apart, int | np.integer) or apart < 1:
        raise InputError(f"apart is {apart!r:.80}, expected a whole number of keyframes from 1")
    for name, value, low in (("weight", weight, 0.0), ("least", least, -1e3)):
        if isinstance(value, bool) or not (isinstance(value, Real) and low <= value <= 1e3):
            raise InputError(f"{name} is {value!r:.80}, expected a number from {low:g} to 1000")
    mean = rows.sum(axis=0, dtype=np.float64) / (rows.any(axis=1).sum() + _COMMON)
    score = compare_descriptors(rows, rows, mean=mean)
    if words is not None:
        score = (_votes(words, len(rows)) + weight * score).astype(np.float32)
    second, first = np.tril_indices(len(rows), -int(apart))
    scores = score[second, first]
    order = np.lexsort((second, first, -scores))
    order = order[scores[order] > least]
    return Places(first[order].astype(np.int64), second[order].astype(np.int64), scores[order])


def _filters(response: Any, n: int) -> tuple[NDArray[np.complex128], BoolArray]:
    """Responses (N, K) of order 1 and more, channels as filters of their own, and where they are defined."""
    if not isinstance(response, Response | Bank):
        such = "such as tspslam.tmahf or tspslam.tmahf_bank gives"
        raise InputError(f"response is {told(response)}, expected a Response or a Bank, {such}")
    is_bank = isinstance(response, Bank)
    z = np.asarray(response.z) if is_bank else np.asarray(response.z)[:, None]
    orders = np.asarray(response.orders if isinstance(response, Bank) else [response.order])
    defined = np.asarray(response.defined).reshape(
        *np.shape(response.defined)[: 1 + is_bank], *([] if is_bank else [1])
    )
    if z.ndim not in (2, 3) or z.shape[:2] != (n, len(orders)) or defined.shape != z.shape[:2]:
        raise InputError(f"response has shape {np.shape(response.z)}, expected {n} vertices, the complex's")
    counts = orders >= 1
    if not counts.any():
        raise InputError("response is of order 0 alone, expected an order of 1 or more: 0 is not freed of brightness")
    z = (z if z.ndim == 3 else z[..., None])[:, counts]
    known = np.repeat(defined[:, counts], z.shape[2], axis=1)
    flat = np.ascontiguousarray(z.reshape(known.shape), np.complex128)
    if not np.isfinite(flat).all():
        raise InputError("response is not finite, expected finite numbers")
    return flat, np.ascontiguousarray(known)


def _sizes(z: NDArray[np.complex128], defined: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Magnitudes (N, K), -1 where not defined, and each filter's mean, 0 where it is no more than rounding."""
    from . import _recognise

    size = np.empty(z.shape)
    mean: FloatArray = _recognise.magnitudes(z, defined, size)
    return size, np.where(mean > _SILENT, mean, 0.0)


def _magnitudes(size: FloatArray, mean: FloatArray) -> FloatArray:
    """How each filter's magnitudes are spread about their mean: roots of shares (K bins), of length 1."""
    from . import _recognise

    found = np.zeros((size.shape[1], _BINS))
    _recognise.magnitude_histograms(size, mean, _LOW, _HIGH, found)
    return _unit(_root_shares(found))


def _levels(complex_: Complex, signals: Signals) -> FloatArray:
    """How levels differ, in units of the mean step along an edge: roots of shares (C, 4, bins), of length 1.

    The steps along edges; edges less the mean of their ends; faces less the mean of their corners; faces less the
    median face.
    """
    from . import _recognise

    oks = signals.vertex_ok, signals.edge_ok, signals.face_ok
    planes = [np.atleast_2d(level.T) for level in (signals.vertex, signals.edge, signals.face)]
    found = np.zeros((len(planes[0]), 4, _LEVEL_BINS))
    for c, levels in enumerate(zip(*planes, strict=True)):
        values = tuple(np.ascontiguousarray(level, np.float64) for level in levels)
        total, count = _recognise.edge_steps(complex_.edges, values[0], oks[0])
        if total > _SILENT * count:
            shape = complex_.edges, complex_.faces, values, oks
            middle = float(np.median(values[2][oks[2]])) if oks[2].any() else 0.0
            _recognise.level_histograms(*shape, total / count, middle, _REACH, found[c])
    return _unit(_root_shares(found.reshape(-1, _LEVEL_BINS)))


def _cells(
    z: NDArray[np.complex128], size: FloatArray, mean: FloatArray, places: FloatArray, cells: tuple[int, int]
) -> FloatArray:
    """What each cell shows beside the whole image: its magnitudes, and harmonics of its directions."""
    from . import _recognise

    strength = np.empty(len(z))
    typical = _recognise.strengths(size, mean, strength)
    sums, counts = np.zeros((*cells, z.shape[1], _recognise.CHANNELS)), np.zeros(cells)
    if typical > 0:
        _recognise.pool_cells(z, size, mean, strength, typical, places, sums, counts)
    total = max(float(counts.sum()), 1.0)
    beside = sums - counts[..., None, None] * (sums.sum(axis=(0, 1)) / total)
    beside /= counts[..., None, None] + _LONE * total / counts.size
    spread = np.sqrt((beside**2).mean(axis=(0, 1)))
    beside /= np.where(spread > _SILENT, spread, np.inf)
    return (np.sign(beside) * np.sqrt(np.abs(beside))).ravel()


def _places_in(
    layout: Any, uv: ArrayLike | None, size: Any, defined: BoolArray, signals: Signals
) -> tuple[FloatArray, tuple[int, int]]:
    """Row and column of each vertex among the centres of the cells, and the number of rows and columns."""
    rows, columns = _two(layout, "layout", "(rows, columns)")
    if not 2 <= rows * columns <= _MOST_CELLS:
        raise InputError(f"layout is {rows} by {columns} cells, expected 2 to {_MOST_CELLS} in all")
    if uv is None or size is None:
        raise InputError("describe: a layout is given without uv or size, expected both")
    width, height = _two(size, "size", "(width, height)")
    points = np.asarray(real_array(uv, "uv", "(N, 2)"), np.float64)
    if points.shape != (len(defined), 2):
        raise InputError(f"uv has shape {points.shape}, expected ({len(defined)}, 2)")
    lost = np.flatnonzero(defined.any(axis=1) & ~np.isfinite(points).all(axis=1))
    if len(lost):
        raise InputError(f"uv is not finite at vertex {lost[0]}, which has a response; expected finite numbers")
    centre = (np.nan_to_num(points[:, ::-1]) + 0.5) * (rows / height, columns / width) - 0.5
    return np.clip(centre, 0, (rows - 1, columns - 1)), (rows, columns)


def _two(value: Any, what: str, names: str) -> tuple[int, int]:
    pair = value if isinstance(value, tuple | list) else ()
    if len(pair) != 2 or any(isinstance(x, bool) or not isinstance(x, int | np.integer) or x < 1 for x in pair):
        raise InputError(f"{what} is {value!r:.80}, expected {names}, two whole numbers from 1")
    return int(pair[0]), int(pair[1])


def _check_signals(complex_: Complex, signals: Signals) -> None:
    tail = signals.vertex.shape[1:]
    for name, count in (("vertex", complex_.n), ("edge", len(complex_.edges)), ("face", len(complex_.faces))):
        values, ok = getattr(signals, name), getattr(signals, f"{name}_ok")
        if len(tail) > 1 or values.shape != (count, *tail) or ok.shape != (count,):
            raise InputError(f"signals.{name} has shape {values.shape}, expected {(count, *tail)}, as the complex has")
        check_values(np.where(ok.reshape(-1, *[1] * len(tail)), values, 0), f"signals.{name}", name)


def _rows(values: ArrayLike, what: str) -> Descriptors:
    rows = real_array(values, what, "(K, D)")
    if rows.ndim != 2 or not np.isfinite(rows).all():
        raise InputError(f"{what} are {told(rows)}, expected (K, D) finite numbers, a row for each descriptor")
    return rows.astype(np.float32)


def _votes(words: ArrayLike, count: int) -> NDArray[Any]:
    votes = real_array(words, "words", "(K, K)")
    if votes.shape != (count, count) or not np.isfinite(np.tril(votes, -1)).all():
        raise InputError(f"words are {told(votes)}, expected ({count}, {count}) finite numbers")
    return votes


def _root_shares(histograms: FloatArray) -> FloatArray:
    """Square roots of each row's shares: a dot product of two compares them (Bhattacharyya)."""
    return np.sqrt(histograms / np.maximum(histograms.sum(axis=1, keepdims=True), 1e-300)).ravel()


def _unit(values: FloatArray) -> Any:
    return _unit_rows(values[None])[0].astype(np.float32)


def _unit_rows(rows: Any) -> Any:
    """Rows of length 1; those that are 0 stay."""
    length = np.linalg.norm(rows, axis=1, keepdims=True)
    return np.divide(rows, length, out=np.zeros_like(rows), where=length > 0)
