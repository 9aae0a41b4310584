"""Circular harmonic filters on images, eqs (7) and (8): the Euclidean ancestor of the topological filters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..types import Bank, FloatArray, Response
from .harmonic import check_responses, checked_bank, checked_order
from .spectral import checked_number
from .texture import luminance

_REACH = 4  # standard deviations beyond which the Gaussian is cut off
_LARGEST = 1 << 27  # pixels of a padded image: 2 GiB of complex numbers


def chf(image: NDArray[Any], order: int = 1, scale: float = 2.0) -> Response:
    r"""Circular harmonic filter at every pixel, eqs (7) and (8).

    .. math:: r(p) = \sum_q g(|q - p|) \, e^{j m \psi(p, q)} \, s(q), \qquad
              g(\rho) = \frac{e^{-\rho^2 / 2\sigma^2}}{\sum e^{-\rho^2 / 2\sigma^2}}

    with ψ from the centre p to the neighbour q, as in `tmahf`: :math:`(-1)^m` times eq. (8). The centre itself counts
    for m = 0 only.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1]; of colour the luminance. Beyond its border it is mirrored.
    order : int
        Angular order, 0 <= m <= 1000.
    scale : float
        σ, px, at least 0.1.

    Returns
    -------
    Response
        z and defined (H, W).

    Raises
    ------
    InputError
        If an argument is not as described, or the work would take over 2 GiB.

    Examples
    --------
    A ramp downwards has phase π/2:

    >>> ramp = np.tile(np.linspace(0, 1, 31)[:, None], (1, 31))
    >>> chf(ramp).phase[15, 15].round(6)
    np.float64(1.570796)
    """
    return chf_bank(image, (order,), (scale,))[0]


def chf_bank(image: NDArray[Any], orders: Sequence[int] = (0, 1, 2), scales: Sequence[float] = (2.0,)) -> Bank:
    """Circular harmonic filters of several orders and scales at every pixel.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        As `chf`.
    orders : sequence of int
        Angular orders m.
    scales : sequence of float
        Standard deviations σ, px.

    Returns
    -------
    Bank
        (H, W, K), K = len(scales) · len(orders): all orders of the first scale, then of the next.

    Raises
    ------
    InputError
        As `chf`, or if there is no order or no scale.

    Examples
    --------
    >>> chf_bank(np.eye(9), orders=(1, 2), scales=(1.0, 2.0, 3.0)).z.shape
    (9, 9, 6)
    """
    from scipy.fft import fft2, ifft2, next_fast_len

    orders, scales = checked_bank(orders, scales, "chf")
    modes = [checked_order(order, "chf") for order in orders]
    sigmas = [checked_number(scale, "scale", 0.1) for scale in scales]
    plane = luminance(image)
    reach = int(np.ceil(_REACH * max(sigmas)))
    size = [next_fast_len(side + 2 * reach) for side in plane.shape]
    if size[0] * size[1] > _LARGEST:
        raise InputError(
            f"chf: an image of {size[0]} x {size[1]} px with its rim is too large for a scale of {max(sigmas):g}"
        )
    check_responses(plane.size * len(sigmas) * len(modes), "chf")
    transformed = fft2(np.pad(plane, reach, mode="symmetric"), size)
    z = np.empty((*plane.shape, len(sigmas) * len(modes)), np.complex128)
    for k in range(z.shape[2]):
        kernel = _kernel(modes[k % len(modes)], sigmas[k // len(modes)], reach)
        whole = ifft2(transformed * fft2(kernel[::-1, ::-1], size))
        z[:, :, k] = whole[2 * reach : 2 * reach + plane.shape[0], 2 * reach : 2 * reach + plane.shape[1]]
    columns = np.tile(modes, len(sigmas)), np.repeat(sigmas, len(modes))
    return Bank(z, columns[0].astype(np.int64), columns[1].astype(np.float64), np.ones(z.shape, bool))


def _kernel(order: int, sigma: float, reach: int) -> NDArray[np.complex128]:
    """Gaussian times harmonic on the offsets (v, u) from -reach to reach."""
    v, u = np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(np.float64)
    near = np.maximum(np.abs(u), np.abs(v)) <= np.ceil(_REACH * sigma)
    gauss: FloatArray = np.where(near, np.exp(-(u**2 + v**2) / (2 * sigma**2)), 0)
    gauss /= gauss.sum()
    harmonic = np.exp(1j * order * np.arctan2(v, u))
    harmonic[reach, reach] = order == 0
    return gauss * harmonic
