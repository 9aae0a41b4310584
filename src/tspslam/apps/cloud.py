"""Stereo points denoised: moved along their rays, so that faces lie flat and steps and creases stay."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import check_luminance, check_pixels, require
from ..errors import InputError
from ..topology.complex import build_complex
from ..topology.texture import sample_signals
from ..types import BoolArray, Cloud, FloatArray, Rig, Surface, real_array

# Chosen together on synthetic worlds of seeds 100 and 101: street, corridor, room, and heaps of 30 and 150 things,
# round and square. The heaps keep the flatness low: at 100 the median error of a room goes from 0.41 of the raw points'
# to 0.30, and that of the worst heap from 0.91 to over 1.
_CREASES = np.geomspace(0.5, 0.15, 8)  # noise levels: folds well beyond are creases; looser first, then tight
_PLAIN = 4.0  # times that, where the image shows no edge along the fold; 2 to 6 tried
_CONTRAST = 0.03  # difference of two faces' luminance that makes half an edge; 0.015 to 0.06 tried
_OUTLYING = 2.0  # noise levels from where on a point lets go of its place; 1 to 3 do alike
_STEPS = 5  # of conjugate gradients for each of the creases; 8 do alike, 3 a little less
_PAIRS = (
    2500  # of faces in a cloud of 1000 to 2000 points; of more, each bends less, and the flatness grows with them ...
)
_DENSEST = 10.0  # ... up to so many times. 4000 to 7000 points: 3 to 10 times 10 serve best
_QUIET = 0.25  # quantile of the folds that tells the noise: the flattest part. Heaps: the median takes shape for noise
_NORMAL = 0.3186  # the same quantile of |x| for a normal x of standard deviation 1
_WIDEST = 10.0  # ratio of a point's spread to the median one, either way, that is believed
_FEWEST = 12  # hinges that a noise level can be estimated from
_ROUNDING = 1e-12  # of the largest inverse depth: less is no noise
_FARTHEST = 2.0  # times its depth, to which a point moves at most
_AGREE = 1e-3  # px per px: by how much disparity and depth may disagree


def denoise_cloud(
    cloud: Cloud,
    surface: Surface,
    image: NDArray[Any],
    *,
    rig: Rig | None = None,
    flatness: float = 10.0,
    limit: float = 2.0,
) -> Cloud:
    """Move the points of a stereo cloud along their rays so that its faces lie flat, but for steps and creases.

    Over the image of a plane, inverse depth q is linear. So each pair of faces with a common edge has a *fold*
    ``Σ c q`` over its four corners that is 0 where the two are coplanar, and the moves of q minimise

    ``Σ_i ρ(move_i / spread_i) + flatness Σ_h φ(fold_h / tolerance_h)``

    in units of the noise level, which the flattest quarter of the folds themselves tells. φ stops pulling at folds
    beyond its tolerance, which is wide where the luminance of both faces is alike and narrow where the image has an
    edge between them: a step or crease stays where image and depth agree on it. ρ lets an outlying point go to its
    surroundings instead of drawing them to it.

    Parameters
    ----------
    cloud : Cloud
        N points, such as `reconstruct` gives; with a covariance, certain points move less.
    surface : Surface
        Faces over the rows of the cloud, such as `delaunay_surface` gives.
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        The left image; floats in [0, 1].
    rig : Rig, optional
        The cameras; without them focal length times baseline and offset of the disparities are those that fit the
        cloud.
    flatness : float
        Weight of the folds against the points' own places, 0 to 1e6; 0 moves nothing. With more than 2500 pairs of
        faces it grows with their number, up to ten times.
    limit : float
        Farthest move, in noise levels times the point's spread, 0 to 1e6.

    Returns
    -------
    Cloud
        The same points in the same order: `xyz` (m) scaled along the rays from the camera, `disparity` (px) likewise,
        `uv` as it was. Points without a pair of faces around them stay, as do all where there are fewer than 12 pairs
        to tell the noise from. `covariance` stays what it was, that of the measurement: neighbours err alike, so that
        no smaller one could be vouched for.

    Raises
    ------
    InputError
        If shapes do not fit, a value is not finite, a depth is not positive, a point is outside the image, a face
        names no point, disparities and depths belong to no pair of cameras, or a setting is out of range.

    Examples
    --------
    >>> from tspslam import delaunay_surface, reconstruct
    >>> from tspslam.datasets import motorcycle
    >>> pair = motorcycle()
    >>> cloud = reconstruct(pair)
    >>> flat = denoise_cloud(cloud, delaunay_surface(cloud), pair.left)
    >>> bool(np.median(abs(flat.disparity - cloud.disparity)) < 0.5)
    True
    """
    _check(cloud, image)
    require(surface, Surface, "denoise: surface")
    for name, value in (("flatness", flatness), ("limit", limit)):
        _check_setting(name, value)
    scale, _ = _stereo_of(cloud, rig)
    moved = _moved(cloud, surface, image, float(flatness), float(limit))
    inverse = 1 / cloud.xyz[:, 2]
    return replace(
        cloud,
        xyz=cloud.xyz * (inverse / moved)[:, None],
        disparity=cloud.disparity + scale * (moved - inverse),
    )


def _moved(cloud: Cloud, surface: Surface, image: NDArray[Any], flatness: float, limit: float) -> FloatArray:
    """Inverse depths that make the faces flat."""
    from . import _cloud

    inverse = 1 / cloud.xyz[:, 2]
    corners, tolerance = _hinges(cloud, surface, image)
    spread = _spread(cloud)
    coefficient = np.empty(corners.shape)
    ok = _cloud.fold_coefficients(cloud.uv.astype(np.float64), corners, spread, coefficient)
    corners, coefficient, tolerance = corners[ok], coefficient[ok], tolerance[ok]
    folds = _cloud.fold(corners, coefficient, inverse)
    noise = float(np.quantile(np.abs(folds), _QUIET)) / _NORMAL if len(folds) >= _FEWEST else 0.0
    if noise <= _ROUNDING * inverse.max(initial=0.0):
        return inverse
    stiffness = flatness * min(max(len(folds) / _PAIRS, 1.0), _DENSEST)
    move = _cloud.flatten(
        corners, coefficient, folds / noise, tolerance, spread, stiffness, _CREASES, _OUTLYING, _STEPS
    )
    farthest = limit * spread
    moved = inverse + noise * np.clip(move, -farthest, farthest)
    return np.maximum(moved, inverse / _FARTHEST)


def _hinges(cloud: Cloud, surface: Surface, image: NDArray[Any]) -> tuple[NDArray[np.uint32], FloatArray]:
    """Corners of each pair of faces with a common edge, and how much of a fold is taken for noise."""
    from . import _cloud

    complex_ = build_complex(surface.faces, len(cloud))
    corners, faces = _cloud.find_hinges(complex_.edges, complex_.faces, complex_.face_edges)
    signals = sample_signals(image, cloud.uv, complex_)
    grey = signals.face if signals.face.ndim == 1 else signals.face @ (0.299, 0.587, 0.114)
    contrast = (grey[faces[:, 0]] - grey[faces[:, 1]]) ** 2
    return corners, 1 + (_PLAIN - 1) / (1 + contrast / _CONTRAST**2)


def _spread(cloud: Cloud) -> FloatArray:
    """How uncertain each inverse depth is, over the median one; 1 without a covariance.

    It is the root of the ratio of standard deviations: errors of real matches differ by less than the pixels' scale
    that the covariance is made of.
    """
    if cloud.covariance is None:
        return np.ones(len(cloud))
    spread = np.sqrt(np.maximum(cloud.covariance[:, 2, 2], 0.0)) / cloud.xyz[:, 2] ** 2
    middle = float(np.median(spread)) if len(spread) else 0.0
    if not middle > 0:
        return np.ones(len(cloud))
    return np.clip(np.sqrt(spread / middle), 1 / _WIDEST, _WIDEST)


def _stereo_of(cloud: Cloud, rig: Rig | None) -> tuple[float, float]:
    """Focal length times baseline, px m, and the offset of disparities, px."""
    inverse = 1 / cloud.xyz[:, 2]
    if rig is not None:
        require(rig, Rig, "denoise: rig")
        scale, offset = rig.fx * rig.baseline, rig.doffs
    else:
        scale, offset = _fit(inverse, cloud.disparity)
    off = np.abs(scale * inverse - offset - cloud.disparity) - _AGREE * (1 + np.abs(cloud.disparity))
    if len(cloud) and not (off.max() <= 0 and scale > 0):
        bad = int(off.argmax())
        where = f"point {bad} has disparity {cloud.disparity[bad]:.6g} px and z {cloud.xyz[bad, 2]:.6g} m"
        cameras = "those of the rig" if rig is not None else "any two cameras"
        raise InputError(f"denoise: {where}, expected z (disparity + doffs) to be fx baseline of {cameras}")
    return scale, offset


def _fit(inverse: FloatArray, disparity: FloatArray) -> tuple[float, float]:
    """Line through disparities over inverse depths; through 0 where all depths are the same."""
    if len(inverse) == 0:
        return 1.0, 0.0
    centre, middle = inverse.mean(), disparity.mean()
    across = inverse - centre
    if np.abs(across).max() <= 1e-6 * centre:
        return float(middle / centre), 0.0
    slope = float(across @ (disparity - middle) / (across @ across))
    return slope, float(slope * centre - middle)


def _check(cloud: Cloud, image: NDArray[Any]) -> None:
    require(cloud, Cloud, "denoise: cloud")
    n = len(real_array(cloud.xyz, "denoise: xyz", "(N, 3)"))
    shapes = {"xyz": (n, 3), "uv": (n, 2), "disparity": (n,), "covariance": (n, 3, 3)}
    for name, shape in shapes.items():
        if name == "covariance" and cloud.covariance is None:
            continue
        values = real_array(getattr(cloud, name), f"denoise: {name}", f"{shape}")
        if values.shape != shape:
            raise InputError(f"denoise: {name} has shape {values.shape}, expected {shape}")
        good: BoolArray = np.isfinite(values.reshape(n, values.size // n if n else 0)).all(axis=1)
        _refuse(good, f"{name} is not finite", "finite values")
    _refuse(cloud.xyz[:, 2] > 0, "z is not positive", "points before the camera")
    check_pixels("denoise: image", image)
    check_luminance("denoise: image", image)
    height, width = image.shape[:2]
    inside: Any = (cloud.uv >= -0.5) & (cloud.uv <= (width - 0.5, height - 0.5))
    _refuse(
        inside.all(axis=1), f"uv is outside the image of {width} x {height} px", "the image that the cloud was made of"
    )


def _refuse(good: BoolArray, found: str, expected: str) -> None:
    if not good.all():
        raise InputError(f"denoise: {found} at point {int(np.flatnonzero(~good)[0])}, expected {expected}")


def _check_setting(name: str, value: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0 <= value <= 1e6:
        raise InputError(f"denoise: {name} is {value!r:.40}, expected a number from 0 to 1e6")
