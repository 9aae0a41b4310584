"""A pair as the stages want it: grey levels, smoothed planes and pyramids, each made once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import cached_property
from threading import RLock
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from ..errors import GeometryError, InputError
from ..types import BoolArray, Features, FloatArray, Image, StereoPair
from .rig import check_pair

Given = TypeVar("Given")
Made = TypeVar("Made")
Plane = NDArray[np.float32]
Detector = Callable[[NDArray[np.uint8]], Features]
SAME_PICTURE = "left and right show the same picture, expected two views of one scene"
_TO_GREY_LEVELS = {"u1": 1.0, "u2": 1 / 257, "f4": 255.0, "f8": 255.0}
_SMOOTHING = 0.6  # px; less lets the interpolation bias through, more blurs depth edges
_LEVELS = 4
MARGIN = 16
"""px from a pixel that no camera saw to the nearest that is used: patches, of ORB and of tracking, reach 15 px."""
_SMALLEST = 60  # px that the shorter side of a level must have for a smaller level to be made


def grey_levels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """8-bit luminance of any supported image: Rec. 601 weights in float, then rounded once.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1]; colour is RGB.

    Returns
    -------
    (H, W) uint8

    Raises
    ------
    InputError
        If the shape or dtype is another one.

    Examples
    --------
    >>> grey_levels(np.full((1, 1), 65535, np.uint16)).tolist()
    [[255]]
    >>> grey_levels(np.array([[[255, 0, 0]]], np.uint8)).tolist()
    [[76]]
    """
    return _rounded(image, lambda: luminance_levels(image))


def _rounded(image: NDArray[Any], luminance: Callable[[], Plane]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(image) if _is_plain(image) else np.rint(luminance()).astype(np.uint8)


def _is_plain(image: NDArray[Any]) -> bool:
    """Whether an image is grey levels as they are."""
    return image.ndim == 2 and image.dtype == np.uint8 and image.size > 0


def luminance_levels(image: NDArray[Any]) -> NDArray[np.float32]:
    """Luminance of any supported image in 8-bit grey levels, not rounded.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1]; colour is RGB, weighed by Rec. 601.

    Returns
    -------
    (H, W) float32
        0 to 255.

    Raises
    ------
    InputError
        If the shape or dtype is another one.

    Examples
    --------
    >>> luminance_levels(np.full((1, 1), 0.5, np.float32)).tolist()
    [[127.5]]
    """
    to_grey = _TO_GREY_LEVELS.get(image.dtype.str[1:])
    if to_grey is None or image.size == 0 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise InputError(
            f"image: {image.dtype} of shape {image.shape}, expected (H, W) or (H, W, 3) of uint8, uint16 or float"
        )
    plane: NDArray[np.float32] = image.astype(np.float32)
    if image.ndim == 3:
        import cv2

        plane = cv2.cvtColor(plane, cv2.COLOR_RGB2GRAY)  # Rec. 601
    if _is_plain(image):
        return plane
    if to_grey != 1.0:
        plane *= np.float32(to_grey)
    return np.clip(plane, 0, 255, out=plane)


def smooth_plane(image: NDArray[Any]) -> Plane:
    """Luminance in grey levels, smoothed by a Gaussian of 0.6 px so that it can be interpolated without bias.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1].

    Returns
    -------
    (H, W) float32

    Raises
    ------
    InputError
        If the shape or dtype is another one.

    Examples
    --------
    >>> round(float(smooth_plane(np.full((5, 5), 51, np.uint8))[2, 2]), 3)
    51.0
    """
    return _smoothed(image, lambda: luminance_levels(image))


def _smoothed(image: NDArray[Any], luminance: Callable[[], Plane]) -> Plane:
    import cv2

    levels = np.ascontiguousarray(image) if _is_plain(image) else luminance()
    taps = cv2.getGaussianKernel(5, _SMOOTHING, cv2.CV_32F)
    plane: Plane = cv2.sepFilter2D(levels, cv2.CV_32F, taps, taps)
    return plane


def find_usable(valid: BoolArray) -> BoolArray:
    """Find the pixels around which patches see nothing but what the cameras saw: 16 px from any other.

    Parameters
    ----------
    valid : (H, W) bool
        Pixels that the cameras saw. Beyond the border of the image nothing is taken to be unseen.

    Returns
    -------
    (H, W) bool

    Examples
    --------
    >>> valid = np.ones((40, 40), bool)
    >>> valid[:, 0] = False
    >>> int(find_usable(valid)[0].argmax())
    17
    """
    import cv2

    side = 2 * MARGIN + 1
    return np.asarray(cv2.erode(valid.astype(np.uint8), np.ones((side, side), np.uint8)) > 0)


def are_usable(usable: BoolArray | None, uv: FloatArray) -> BoolArray:
    """Tell whether places lie on usable pixels; outside the image, the nearest one counts.

    Parameters
    ----------
    usable : (H, W) bool or None
        None is all of them.
    uv : (N, 2) float64
        Places, px; NaN is not usable, unless all are.

    Returns
    -------
    (N,) bool

    Examples
    --------
    >>> are_usable(np.array([[True, False]]), np.array([[0.4, 0.0], [0.6, 0.0]])).tolist()
    [True, False]
    """
    if usable is None:
        return np.ones(len(uv), np.bool_)
    is_number = np.asarray(np.isfinite(uv).all(axis=1))
    last = np.array(usable.shape[::-1]) - 1
    pixel = np.clip(np.rint(np.where(is_number[:, None], uv, 0)), 0, last).astype(np.int64)
    return np.asarray(usable[pixel[:, 1], pixel[:, 0]] & is_number)


@dataclass(frozen=True, repr=False)
class Pyramid(Brief):
    """An image in half, quarter and eighth size too.

    Attributes
    ----------
    levels : tuple of (h, w) float32
        Smoothed grey levels, full size first; pixel (2u, 2v) of one is (u, v) of the next.
    usable : (H, W) bool or None
        Pixels of the full size that may be tracked; None is all of them.
    """

    levels: tuple[Plane, ...]
    usable: BoolArray | None = None


def build_pyramid(image: Image) -> Pyramid:
    """Smooth an image and halve it while it is larger than a few patches.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1].

    Returns
    -------
    Pyramid

    Examples
    --------
    >>> [level.shape for level in build_pyramid(np.zeros((100, 200), np.uint8)).levels]
    [(100, 200), (50, 100)]
    """
    return _halved(smooth_plane(image))


def _halved(plane: Plane, usable: BoolArray | None = None) -> Pyramid:
    import cv2

    levels = [plane]
    while len(levels) < _LEVELS and min(levels[-1].shape) >= _SMALLEST:
        levels.append(cv2.pyrDown(levels[-1]))
    return Pyramid(tuple(levels), usable)


class MadeOnce(Generic[Given, Made]):
    """What is made of one thing at a time, once, by the thread that is the first to ask; others wait for it.

    Examples
    --------
    >>> half = MadeOnce()
    >>> half.of(4, lambda: 2), half.of(4, lambda: "asked again"), half.of(6, lambda: 3)
    (2, 2, 3)
    """

    def __init__(self) -> None:
        self._lock, self._known = RLock(), list[tuple[Given, Made]]()

    def of(self, given: Given, make: Callable[[], Made]) -> Made:
        """Return what was made of the very same thing, or make it.

        Parameters
        ----------
        given : object
            What it is made of.
        make : callable
            Called without arguments; what it raises is raised, and it is called anew by the next to ask.

        Returns
        -------
        object
        """
        with self._lock:
            if not (self._known and self._known[0][0] is given):
                self._known[:] = [(given, make())]
            return self._known[0][1]

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), ()


@dataclass(frozen=True, repr=False)
class PreparedImage(Brief):
    """One image of a pair in the forms that stages want; each is made once, when it is first asked for.

    Attributes
    ----------
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        Floats in [0, 1].
    usable : (H, W) bool or None
        Pixels on which keypoints and landmarks may lie; None is all of them.
    """

    image: Image
    usable: BoolArray | None = None
    _features: MadeOnce[Detector, Features] = field(default_factory=MadeOnce, init=False, repr=False, compare=False)

    def features(self, detect: Detector) -> Features:
        """Detect keypoints on all pixels, once for the same detector: a thread that asks meanwhile waits for them.

        Parameters
        ----------
        detect : callable
            Grey image (H, W) uint8 -> `Features`.

        Returns
        -------
        Features
        """
        return self._features.of(detect, lambda: detect(self.grey))

    @cached_property
    def luminance(self) -> Plane:
        """Luminance in grey levels, (H, W) float32."""
        return luminance_levels(self.image)

    @cached_property
    def grey(self) -> NDArray[np.uint8]:
        """Luminance rounded, (H, W) uint8: what detectors take."""
        return _rounded(self.image, lambda: self.luminance)

    @cached_property
    def smooth(self) -> Plane:
        """Luminance smoothed, (H, W) float32: what patches are compared on."""
        return _smoothed(self.image, lambda: self.luminance)

    @cached_property
    def pyramid(self) -> Pyramid:
        """The smoothed luminance in several sizes: what landmarks are tracked in."""
        return _halved(self.smooth, self.usable)


@dataclass(frozen=True, repr=False)
class PreparedPair(StereoPair):
    """A pair that was checked, each of its images prepared once for all stages."""

    @cached_property
    def usable(self) -> BoolArray | None:
        """Pixels of either image that are used, (H, W); None is all of them."""
        return None if self.valid is None else find_usable(self.valid)

    @cached_property
    def left_image(self) -> PreparedImage:
        """The left image."""
        return PreparedImage(self.left, self.usable)

    @cached_property
    def right_image(self) -> PreparedImage:
        """The right image."""
        return PreparedImage(self.right, self.usable)

    @cached_property
    def levelled(self) -> MadeOnce[float, tuple[Plane, Plane]]:
        """The smoothed planes, moved until their rows agree, for an offset of the rows, px."""
        return MadeOnce()

    def fill(self) -> None:
        """Make now what every frame needs: the planes and the pyramid that landmarks are looked for in."""
        _ = self.left_image.pyramid
        if self.disparity is None:
            _ = self.right_image.smooth

    def detect(self, detector: Detector) -> None:
        """Make now what a keyframe needs besides: the keypoints of both images, of the left one where depths are known.

        Parameters
        ----------
        detector : callable
            Grey image (H, W) uint8 -> `Features`.
        """
        self.left_image.features(detector)
        if self.disparity is None:
            self.right_image.features(detector)


def prepare(pair: StereoPair) -> PreparedPair:
    """Check a pair, and give it a place for the forms of its images that stages share.

    Parameters
    ----------
    pair : StereoPair
        The images; one that is prepared stays as it is.

    Returns
    -------
    PreparedPair

    Raises
    ------
    InputError
        If the images do not fit each other or the rig (`check_pair`).
    GeometryError
        If left and right are the same picture, and no map of disparities stands in for the right one.
    """
    if isinstance(pair, PreparedPair):
        return pair
    check_pair(pair)
    if pair.disparity is None and np.array_equal(pair.left, pair.right) and pair.left.min() < pair.left.max():
        raise GeometryError(f"{pair.name}: {SAME_PICTURE}")
    return PreparedPair(**{each.name: getattr(pair, each.name) for each in fields(StereoPair)})
