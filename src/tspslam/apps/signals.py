"""Denoising of texture signals on vertices, edges and faces at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import brief
from .._checks import require
from ..errors import InputError
from ..topology.complex import Complex
from ..topology.laplacian import LARGEST_VALUE, check_values, checked_mask
from ..types import BoolArray, FloatArray, Response, Signals, real_array
from ._signal_graph import Graph, build_graph, estimate_contrast, estimate_variance

LEVELS = ("vertex", "edge", "face")
FLOOR = 1e-3  # least contrast, as a share of the noise's variance: below it there is nothing to keep apart
PILOT, STEPS, ROUNDS = (
    5,
    4,
    2,
)  # steps of conjugate gradients evenly, then by steps, and how often; twice as many gain 0.1 dB


class Constants(NamedTuple):
    """What the estimate knows of photographs; fitted by ``python -m benchmarks.uses.signals_fit``.

    Attributes
    ----------
    kind : (4,) float64
        Relative weights of the kinds of pairs: edge and end, face and vertex, face and edge, two faces.
    usual : (4,) float64
        Mean squared step of each kind, as photographs have it, over that between a face and its vertices.
    ratio : (K,) float64
        Logarithms of noise over contrast where the next four are tabled; linear between, constant beyond.
    even, weight, least, slant : (K,) float64
        Logarithms of: the pilot's weight; the weight by steps; what share of the usual step is added to a step; how
        much steps count that slopes foretell.
    """

    kind: FloatArray
    usual: FloatArray
    ratio: FloatArray
    even: FloatArray
    weight: FloatArray
    least: FloatArray
    slant: FloatArray

    def __repr__(self) -> str:
        return brief(self)

    def at(self, ratio: float) -> FloatArray:
        """Even, weight, least and slant, no longer logarithms.

        Parameters
        ----------
        ratio : float
            Logarithm of noise over contrast.

        Returns
        -------
        (4,) float64
        """
        return np.exp([np.interp(ratio, self.ratio, values) for values in self[3:]])


CONSTANTS = Constants(
    kind=np.array([1.0, 0.94, 1.56, 5.42]),
    usual=np.array([0.67, 1.0, 0.37, 0.8]),
    ratio=np.array([-2.4, -1.2, -0.3, 0.6, 1.5]),
    even=np.array([-2.57, -0.97, 0.82, -0.14, 0.89]),
    weight=np.array([-0.81, -1.2, -0.52, -0.44, -0.98]),
    least=np.array([-6.24, -5.14, -4.15, -2.37, -2.11]),
    slant=np.array([0.51, -0.08, 1.92, 2.47, 3.73]),
)


def denoise_signals(
    complex_: Complex,
    signals: Signals,
    *,
    uv: ArrayLike | None = None,
    response: Response | None = None,
    noise: float | None = None,
) -> Signals:
    r"""Denoise the signals of vertices, edges and faces jointly, edges of the image kept.

    .. math:: \min_x \sum_i \frac{(x_i - s_i)^2}{\sigma^2 c_i} + \sum_{i \sim j} w_{ij} (x_i - x_j)^2

    over all elements i of all levels. c is the share of the pixels' noise that an element has: its mean over p pixels
    has 1/p, a bilinear sample the sum of its squared weights. An edge is tied to its ends, a face to its vertices, its
    edges and the faces beside it. The ties w are even at first; then those across which the first estimate steps, or
    across which its slopes run, are loosened, twice.

    Parameters
    ----------
    complex_ : Complex
        Of triangles.
    signals : Signals
        Noisy, (n,) or (n, C), of any unit. Marked elements take no part and stay marked. Channels are denoised each by
        itself.
    uv : (n, 2) float array, optional
        Projections of the vertices, px. Without it they are taken from the barycentres of the edges, to about half a
        pixel.
    response : Response, optional
        Of order 1, (n,) or (n, C): where the texture has its edges, from elsewhere, such as the mean of many views.
        Only its direction and relative magnitude count. Default: the slopes of the estimate itself.
    noise : float, optional
        Standard deviation of the noise of each pixel, in the signals' unit, > 0. Default: estimated for each channel
        from the flattest tenth of the vertices.

    Returns
    -------
    Signals
        The same but for the values.

    Raises
    ------
    InputError
        If something is not as described, or does not belong to the complex.

    Examples
    --------
    >>> from scipy.spatial import Delaunay
    >>> from tspslam import build_complex, sample_signals
    >>> rng = np.random.default_rng(0)
    >>> uv = rng.random((900, 2)) * 119
    >>> disc = build_complex(Delaunay(uv).simplices, 900)
    >>> image = 0.5 + 0.25 * np.sign(np.arange(120) - 60) * np.ones((120, 1))  # dark and bright half
    >>> noisy = np.clip(image + rng.normal(0, 0.08, image.shape), 0, 1)
    >>> true, raw = (sample_signals(each, uv, disc) for each in (image, noisy))
    >>> better = denoise_signals(disc, raw, uv=uv)
    >>> gain = np.mean((raw.vertex - true.vertex) ** 2) / np.mean((better.vertex - true.vertex) ** 2)
    >>> bool(gain > 4)
    True
    """
    check_signals(complex_, signals)
    deviation = _checked_noise(noise)
    if complex_.n == 0 or signals.vertex.size == 0:
        return signals
    graph = build_graph(complex_, signals, uv)
    tensors = _tensors_of(response, graph, signals)
    values = graph.pack(signals)
    for c, channel in enumerate(values):
        tensor = None if tensors is None else tensors[c % len(tensors)]
        values[c] = denoise(graph, channel, deviation, tensor, CONSTANTS)
    return graph.unpack(values, signals)


def denoise(
    graph: Graph, y: FloatArray, noise: float | None, tensor: FloatArray | None, constants: Constants
) -> FloatArray:
    """Denoise one channel; see `denoise_signals`.

    Parameters
    ----------
    graph : Graph
        The complex.
    y : (M,) float64
        Noisy signals of all M elements, as `Graph.pack` gives them.
    noise : float or None
        Standard deviation in a pixel; None: estimated.
    tensor : (n, 3) float64 or None
        Relative products of slopes, uu, uv, vv, averaged over neighbours; None: of the estimate.
    constants : Constants
        What is known of photographs.

    Returns
    -------
    (M,) float64
    """
    from . import _signals

    variance = estimate_variance(graph, y) if noise is None else noise * noise
    if not variance > 0:
        return y
    contrast = max(estimate_contrast(graph, y, variance), FLOOR * variance)
    even, weight, least, slant = constants.at(0.5 * np.log(variance / contrast))
    usual, x = constants.usual * contrast, y.copy()
    topology = (graph.edges, graph.faces, graph.face_edges, graph.pairs)
    weights = tuple(np.empty(shape) for shape in (graph.edges.shape, *[graph.faces.shape] * 2, len(graph.pairs)))
    _signals.weigh_evenly(graph.own, *topology, even * variance * constants.kind / usual, weights)
    _signals.relax(x, y, graph.own, *topology, weights, PILOT)
    for _ in range(ROUNDS):
        steep = slant * (slopes(graph, x) if tensor is None else _as_steep(tensor, graph, x))
        by_kind = weight * variance * constants.kind
        _signals.weigh_by_steps(x, graph.places, steep, *topology, by_kind, least * usual, weights)
        _signals.relax(x, y, graph.own, *topology, weights, STEPS)
    return x


def slopes(graph: Graph, x: FloatArray) -> FloatArray:
    """Products of slopes (uu, uv, vv) at each vertex, averaged over it and its neighbours, per px².

    Parameters
    ----------
    graph : Graph
        The complex.
    x : (M,) float64
        Signals of all M elements.

    Returns
    -------
    (n, 3) float64
    """
    from . import _signals

    slope, tensor = np.empty((graph.n, 2)), np.empty((graph.n, 3))
    _signals.fit_slopes(x, graph.own, graph.places, graph.edges, graph.faces, slope)
    _signals.average_tensors(slope, graph.own, graph.edges, tensor)
    return tensor


def _as_steep(tensor: FloatArray, graph: Graph, x: FloatArray) -> FloatArray:
    """A given tensor, as steep in the mean as the estimate is."""
    own, given = slopes(graph, x), float((tensor[:, 0] + tensor[:, 2]).mean())
    scaled: FloatArray = tensor * (float((own[:, 0] + own[:, 2]).mean()) / given if given > 0 else 0.0)
    return scaled


def _tensors_of(response: Response | None, graph: Graph, signals: Signals) -> list[FloatArray] | None:
    """Products of directions of a response, averaged over neighbours, for each of its channels."""
    from . import _signals

    if response is None:
        return None
    require(response, Response, "response")
    z, defined = np.asarray(response.z), np.asarray(response.defined)
    shapes = ((graph.n,), signals.vertex.shape)
    if response.order != 1 or z.shape not in shapes or defined.shape != shapes[0]:
        found = f"order {response.order} and shape {z.shape}, {defined.shape} of defined"
        raise InputError(f"response has {found}, expected order 1 and {signals.vertex.shape}, {shapes[0]}")
    z = np.where(defined.reshape(-1, *[1] * (z.ndim - 1)), z, 0.0)
    if not (np.abs(z) <= LARGEST_VALUE).all():
        raise InputError(f"response holds values that are not finite or above {LARGEST_VALUE:g}, expected smaller ones")
    tensors = []
    for column in z.reshape(graph.n, -1).T:
        slope, tensor = np.stack([column.real, column.imag], axis=1), np.empty((graph.n, 3))
        slope[graph.own[: graph.n] == 0] = 0.0
        _signals.average_tensors(slope, graph.own, graph.edges, tensor)
        tensors.append(tensor)
    return tensors


def check_signals(complex_: Complex, signals: Signals) -> None:
    """Refuse signals that do not belong to a complex of triangles, or are not finite.

    Parameters
    ----------
    complex_ : Complex
        The complex.
    signals : Signals
        Its signals.
    """
    require(complex_, Complex, "complex_")
    require(signals, Signals, "signals")
    if not isinstance(complex_.faces, np.ndarray):
        raise InputError("complex: its faces are polygons, expected triangles")
    sizes = (complex_.n, len(complex_.edges), len(complex_.faces))
    tail = signals.vertex.shape[1:]
    for level, count in zip(LEVELS, sizes, strict=True):
        values: FloatArray = getattr(signals, level)
        if values.shape != (count, *tail) or values.ndim > 2:
            raise InputError(
                f"signals.{level} has shape {values.shape}, expected ({count},) or ({count}, C) as all levels"
            )
        ok: BoolArray = checked_mask(getattr(signals, f"{level}_ok"), count)
        check_values(np.where(ok.reshape(-1, *[1] * len(tail)), values, 0.0), f"signals.{level}", level)
        if level != "vertex":
            _check_places(getattr(signals, f"{level}_uv"), getattr(signals, f"{level}_pixels"), ok, level)


def _check_places(uv: FloatArray, pixels: NDArray[np.int32], ok: BoolArray, level: str) -> None:
    if uv.shape != (len(ok), 2) or pixels.shape != ok.shape:
        raise InputError(f"signals.{level}_uv, _pixels have shapes {uv.shape}, {pixels.shape}, expected {len(ok)} rows")
    if not (np.isfinite(uv[ok]).all() and (pixels >= 0).all()):
        raise InputError(
            f"signals.{level}_uv, _pixels hold NaN, infinite or negative values, expected places and counts"
        )


def _checked_noise(noise: float | None) -> float | None:
    if noise is None:
        return None
    value = real_array(noise, "noise", "a single number, one of the")
    if value.shape != () or isinstance(noise, bool) or not 0 < float(value) <= LARGEST_VALUE:
        raise InputError(f"noise is {repr(noise)[:60]}, expected a standard deviation > 0, or None")
    return float(value)
