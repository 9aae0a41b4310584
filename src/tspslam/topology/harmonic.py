"""Topological harmonic filters: T-MAHF, eqs (12) and (19)-(22)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import require
from .._settings import setting
from .._threads import both
from ..errors import InputError
from ..types import Bank, FloatArray, Response, Signals, real_array
from .complex import Complex

Centering = Literal["none", "mean", "harmonic", "plane"]
Weight = Callable[[int], float]
_HIGHEST = 1000  # order: cost grows with it, and no neighbourhood samples an angle so finely
LARGEST_BANK = 1 << 32
"""Bytes of responses that are still computed."""

_CENTERINGS = ("none", "mean", "harmonic", "plane")


@dataclass(frozen=True)
class Tmahf:
    """The filter as a stage: T-MAHF of one order and centring over the one-ring.

    Attributes
    ----------
    order : int
        Angular order m.
    centering : {"none", "mean", "harmonic", "plane"} or None
        What is taken out of the sum (see `tmahf`); None is harmonic for orders above 0, none for order 0.

    Examples
    --------
    >>> from tspslam import Settings
    >>> Settings(filter=Tmahf(order=2)).filter.order
    2
    """

    order: int = setting(1, 0, _HIGHEST, unit="", source="the paper's m = 1: edges, and where they point")
    centering: Centering | None = setting(
        None,
        unit="",
        source="harmonic above order 0: answers to texture, not to where neighbours stand (docs/centering)",
    )

    def __post_init__(self) -> None:
        _checked_mode(self.order, self.centering)

    def __call__(self, complex_: Complex, uv: ArrayLike, signals: Signals) -> Response:
        """Filter `signals`; see `tmahf`."""
        return tmahf(complex_, uv, signals, order=self.order, centering=self.centering)


def tmahf(
    complex_: Complex,
    uv: ArrayLike,
    signals: Signals,
    *,
    order: int = 1,
    centering: Centering | None = None,
    weight: Weight | None = None,
) -> Response:
    r"""Topological multiscale anisotropic harmonic filter at every vertex, eqs (12), (19)-(22).

    .. math:: r_i = \sum_{x \in \eta(i)} g(d(i, x)) \, e^{j m \psi(i, x)} \, s(x)

    over the vertices, edges and faces around vertex i, where ψ is the image angle from i's projection to the
    neighbour's projection or barycentre, and d the topological distance.

    Parameters
    ----------
    complex_ : Complex
        N vertices.
    uv : (N, 2) float array
        Projections of the vertices, px.
    signals : Signals
        Unsigned signals on every level, (n,) or (n, C). Marked elements are left out of every sum and fit.
    order : int
        Angular order, 0 <= m <= 1000. For m = 0 the vertex itself counts too.
    centering : {"none", "mean", "harmonic", "plane"}, optional
        ``"none"``: the published sum; it also answers to how unevenly neighbours stand around the vertex.
        ``"mean"``: minus the weighted mean over η(i); 0 on constants.
        ``"harmonic"`` (default for m >= 1): weighted least squares of ``s ≈ c + a cos mψ + b sin mψ``, then
        ``r = (a + jb) Σw/2``.
        ``"plane"`` (m = 1): weighted least squares of ``s ≈ c + g·(x - p)``, ``r = g_u + j g_v``, luminance/px: the
        exact phase on every linear ramp.
        For m = 0 only ``"none"``.
    weight : function of int, optional
        g(d): non-increasing, within [0, 1], g(0) = 1. Default: the indicator of d <= 1, eq. (17). The cost is
        proportional to the elements within the rings where g > 0.

    Returns
    -------
    Response
        (N,) or (N, C); 0 and not `defined` at vertices without a signal, without a neighbour that has one, or whose
        neighbourhood is too poor for the fit (smallest eigenvalue of the normalised design below 1e-3).

    Raises
    ------
    InputError
        If order, centering or weight is not as described, or the arrays do not belong to the complex.

    Examples
    --------
    A linear ramp along u has phase 0 and its slope as magnitude:

    >>> from tspslam import build_complex, sample_signals
    >>> ramp = np.tile(np.linspace(0, 1, 11), (11, 1))
    >>> uv = np.array([[5, 5], [9, 5], [5, 9], [1, 5], [5, 1]], float)
    >>> fan = build_complex([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]], 5)
    >>> response = tmahf(fan, uv, sample_signals(ramp, uv, fan), centering="plane")
    >>> bool(abs(response.z[0] - 0.1) < 1e-9)
    True
    """
    mode, order = _checked_mode(order, centering), int(order)
    points = _checked_points(complex_, uv, signals)
    rings = None if weight is None else _weights_by_distance(weight, complex_.n)
    channels = range(_channel_count(signals))
    filtered = [_filter(complex_, _pack(points, signals, c), order, mode, rings) for c in channels]
    z = np.stack([z for z, _ in filtered], axis=-1) if filtered else np.zeros((complex_.n, 0), complex)
    defined = filtered[0][1] if filtered else np.zeros(complex_.n, bool)
    return Response(z[:, 0] if signals.vertex.ndim == 1 else z, order, defined)


def tmahf_bank(
    complex_: Complex,
    uv: ArrayLike,
    signals: Signals,
    orders: Sequence[int] = (0, 1, 2),
    scales: Sequence[int] = (1,),
    *,
    centering: Literal["none", "mean", "harmonic"] = "harmonic",
) -> Bank:
    """T-MAHF of several orders and neighbourhoods at once: what is around a vertex is gathered once.

    Parameters
    ----------
    complex_, uv, signals
        As `tmahf`.
    orders : sequence of int
        Angular orders m.
    scales : sequence of int
        Rings: all elements at a topological distance of at most so many count alike.
    centering : {"none", "mean", "harmonic"}
        For the orders above 0; order 0 is never centred.

    Returns
    -------
    Bank
        (N, K) or (N, K, C), K = len(scales) · len(orders): all orders of the first scale, then of the next.

    Raises
    ------
    InputError
        As `tmahf`, or if there is no order or no scale.

    Examples
    --------
    >>> from tspslam import build_complex, sample_signals
    >>> uv = np.random.default_rng(0).random((4, 2)) * 9
    >>> complex_ = build_complex([[0, 1, 2], [0, 2, 3]], 4)
    >>> signals = sample_signals(np.eye(10), uv, complex_)
    >>> tmahf_bank(complex_, uv, signals, orders=(0, 1), scales=(1, 2)).z.shape
    (4, 4)
    """
    from . import _bank

    modes, rings = _checked_modes(orders, scales, centering)
    points = _checked_points(complex_, uv, signals)
    near = (complex_.stars, complex_.vertex_rows, complex_.face_rows, complex_.boundary[:2])
    channels, size = _channel_count(signals), (complex_.n, len(rings) * len(modes))
    check_responses(size[0] * size[1] * channels, "tmahf")
    z, defined = np.zeros((*size, channels), np.complex128), np.zeros(size, bool)
    for c in range(channels):
        elements = _pack(points, signals, c)
        _bank.filter_bank(*near, elements, modes, rings, _CENTERINGS.index(centering), z[:, :, c], defined)
    shape = (*size, *signals.vertex.shape[1:])
    return Bank(z.reshape(shape), np.tile(modes, len(rings)), np.repeat(rings, len(modes)).astype(np.float64), defined)


def _checked_modes(
    orders: Sequence[int], scales: Sequence[int], centering: str
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    orders, scales = checked_bank(orders, scales, "tmahf")
    modes = [checked_order(order, "tmahf") for order in orders]
    for rings in scales:
        if isinstance(rings, bool) or not isinstance(rings, int | np.integer) or rings < 1:
            raise InputError(f"tmahf: scale is {rings!r}, expected a number of rings, an integer from 1")
    if centering not in _CENTERINGS[:3]:
        raise InputError(f"tmahf: centering of a bank is {centering!r}, expected one of {', '.join(_CENTERINGS[:3])}")
    return np.array(modes, np.int64), np.array(scales, np.int64)


def _filter(
    complex_: Complex, elements: FloatArray, order: int, mode: int, rings: FloatArray | None
) -> tuple[NDArray[np.complex128], NDArray[np.bool_]]:
    from . import _harmonics, _locality
    from ._memory import empty

    z, defined = empty(complex_.n, np.complex128), empty(complex_.n, bool)
    if rings is None:
        start, rows = complex_.stars
        is_far, visit = _locality.visit_vertices(vars(complex_), elements[: complex_.n, :2])
        numbers = rows.view(np.uint32)  # no wrap-around checks
        _locality.in_parts(
            lambda part: _harmonics.filter_one_ring(
                visit[part], is_far, start, numbers, elements, order, mode, z, defined
            ),
            complex_.n,
        )  # fmt: skip
    else:
        near = (complex_.vertex_rows, complex_.face_rows, complex_.boundary[:2])
        _harmonics.filter_rings(*near, elements, order, mode, rings, z, defined)
    return z, defined


def _pack(uv: FloatArray, signals: Signals, channel: int) -> FloatArray:
    """One row (u, v, signal, weight) an element: vertices, then edges, then faces; a neighbour is one cache line."""
    from . import _harmonics
    from ._locality import FEW
    from ._memory import empty

    one = [each if each.ndim == 1 else each[:, channel] for each in (signals.vertex, signals.edge, signals.face)]
    levels = (
        ("vertex", uv, one[0], signals.vertex_ok),
        ("edge", signals.edge_uv, one[1], signals.edge_ok),
        ("face", signals.face_uv, one[2], signals.face_ok),
    )
    elements = empty((sum(len(level[-1]) for level in levels), 4))
    firsts = np.cumsum([0, *(len(level[-1]) for level in levels)])

    def fill(some: tuple[int, ...]) -> list[int]:
        return [_harmonics.pack(int(firsts[k]), *map(_plain, levels[k][1:3]), levels[k][3], elements) for k in some]

    some, others = both(fill, ((0, 1), (2,))) if len(elements) > FEW else (fill((0, 1, 2)), [])
    for (level, *_), bad in zip(levels, some + others, strict=True):  # the first is named, as if in turn
        if bad >= 0:
            raise InputError(f"tmahf: {level} {bad} has a signal, but its value or position is not finite")
    return elements


def _plain(values: NDArray[Any]) -> FloatArray:
    return np.ascontiguousarray(values, dtype=np.float64)


def _channel_count(signals: Signals) -> int:
    return 1 if signals.vertex.ndim == 1 else signals.vertex.shape[1]


def _checked_mode(order: int, centering: str | None) -> int:
    checked_order(order, "tmahf")
    chosen = centering if centering is not None else ("harmonic" if order else "none")
    if chosen not in _CENTERINGS:
        raise InputError(f"tmahf: centering is {chosen!r}, expected one of {', '.join(_CENTERINGS)}")
    if order == 0 and chosen != "none":
        raise InputError(f"tmahf: centering is {chosen!r} with order 0, expected 'none'")
    if chosen == "plane" and order != 1:
        raise InputError(f"tmahf: centering 'plane' with order {order}, expected order 1")
    return _CENTERINGS.index(chosen)


def checked_bank(orders: Sequence[Any], scales: Sequence[Any], what: str) -> tuple[list[Any], list[Any]]:
    """Return orders and scales of a bank as lists, at least one of each, or raise `InputError`.

    Parameters
    ----------
    orders, scales : sequence
        Of any values.
    what : str
        How the error begins.

    Returns
    -------
    orders, scales : list
    """
    try:
        both = list(orders), list(scales)
    except TypeError as error:
        raise InputError(f"{what}: orders, scales are {orders!r}, {scales!r}, expected sequences") from error
    if not all(both):
        raise InputError(f"{what}: {len(both[0])} orders and {len(both[1])} scales, expected at least one of each")
    return both


def check_responses(count: int, what: str) -> None:
    """Refuse a bank of over 4 GiB.

    Parameters
    ----------
    count : int
        Number of responses, 16 bytes each.
    what : str
        How the error begins.
    """
    if 16 * count > LARGEST_BANK:
        raise InputError(
            f"{what}: responses take {16 * count / 2**30:.1f} GiB, expected at most 4: fewer orders or scales"
        )


def checked_order(order: int, what: str) -> int:
    """Return an angular order as an int, or raise `InputError`.

    Parameters
    ----------
    order : int
        0 <= m <= 1000.
    what : str
        How the error begins.

    Returns
    -------
    int
    """
    if isinstance(order, bool) or not isinstance(order, int | np.integer) or not 0 <= order <= _HIGHEST:
        raise InputError(f"{what}: order is {order!r}, expected an integer from 0 to {_HIGHEST}")
    return int(order)


def _checked_points(complex_: Complex, uv: ArrayLike, signals: Signals) -> FloatArray:
    require(complex_, Complex, "complex_")
    require(signals, Signals, "signals")
    points = np.ascontiguousarray(real_array(uv, "uv", "(N, 2)"), dtype=np.float64)
    if points.shape != (complex_.n, 2):
        raise InputError(f"tmahf: uv has shape {points.shape}, expected ({complex_.n}, 2)")
    sizes = (len(signals.vertex), len(signals.edge), len(signals.face))
    expected = (complex_.n, len(complex_.edges), len(complex_.faces))
    if sizes != expected:
        raise InputError(f"tmahf: signals are on {sizes} vertices, edges, faces, expected {expected}")
    tail = signals.vertex.shape[1:]
    for name, count in zip(("vertex", "edge", "face"), expected, strict=True):
        _require_shape(name, getattr(signals, name), (count, *tail))
        _require_shape(f"{name}_ok", getattr(signals, f"{name}_ok"), (count,))
    _require_shape("edge_uv", signals.edge_uv, (expected[1], 2))
    _require_shape("face_uv", signals.face_uv, (expected[2], 2))
    return points


def _require_shape(name: str, values: NDArray[Any], shape: tuple[int, ...]) -> None:
    if values.shape != shape:
        raise InputError(f"tmahf: signals.{name} has shape {values.shape}, expected {shape}")


def _number(value: Any, d: int) -> float:
    try:
        return float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"tmahf: weight({d}) is {value!r}, expected a number in [0, 1]") from error


def _weights_by_distance(weight: Weight, n: int) -> FloatArray:
    """``g[0..D]``, D the last distance with a positive weight (or n, beyond which nothing is)."""
    if not callable(weight):
        raise InputError(f"tmahf: weight is {weight!r}, expected a function of the topological distance")
    values: list[float] = []
    for d in range(n + 1):
        value = _number(weight(d), d)
        if d == 0 and value != 1.0:
            raise InputError(f"tmahf: weight(0) is {value}, expected 1")
        if not 0.0 <= value <= (values[-1] if values else 1.0):
            raise InputError(f"tmahf: weight({d}) is {value}, expected non-increasing values in [0, 1]")
        if value == 0.0:
            break
        values.append(value)
    return np.array(values)
