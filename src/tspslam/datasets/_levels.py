"""Bits that 16-bit pixels use: cameras of 10, 12 and 14 bits fill only a part of their files' range."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..types import Image

_DEPTHS = (8, 10, 12, 14, 16)  # bits of the converters in cameras
_SAMPLE = 16  # frames looked at, evenly spread: a dark one among them does not decide
_STRAY = 0.01  # of an image's pixels that may be above the range found, as glints are; they become white


@dataclass(frozen=True)
class Levels:
    """What makes the 16-bit pixels of a source fill their range, as SPEC's luminance (16-bit / 65535) expects.

    Attributes
    ----------
    read : callable
        Images of a frame as they are stored, by its place from 0.
    count : int
        How many frames there are.
    given : int, optional
        Bits that the user says are used.

    Raises
    ------
    InputError
        If `given` is no whole number from 1 to 16.

    Examples
    --------
    >>> levels = Levels(lambda index: [np.array([[0, 1, 4095]], np.uint16)], 1)
    >>> levels.bits, levels(levels.read(0))[0].tolist()
    (12, [[0, 16, 65520]])
    """

    read: Callable[[int], Iterable[Image]]
    count: int
    given: int | None = None

    def __post_init__(self) -> None:
        if self.given is not None and (type(self.given) is not int or not 1 <= self.given <= 16):
            raise InputError(f"bits is {repr(self.given)[:40]}, expected how many pixels use, from 1 to 16")

    @cached_property
    def bits(self) -> int:
        """Bits in use: those given, else those found in a sample of all frames."""
        return used_bits(self._sample()) if self.given is None else self.given

    def _sample(self) -> Iterable[Image]:
        places = np.linspace(0, self.count - 1, min(self.count, _SAMPLE)).round().astype(int)
        for place in dict.fromkeys(places.tolist()):
            try:
                yield from self.read(place)
            except InputError:  # said when the frame itself is read
                continue

    def __call__(self, images: Sequence[Image]) -> list[Image]:
        """Images with 16-bit pixels moved up to the full range; others as they are.

        Raises
        ------
        InputError
            If more than 1 % of the pixels do not go into the bits, or bits are given for other pixels.
        """
        return [self._moved(image) for image in images]

    def _moved(self, image: Image) -> Image:
        if image.dtype != np.uint16:
            if self.given is not None and (self.given > 8 or image.dtype != np.uint8):
                raise InputError(f"image is {image.dtype}, expected 16-bit pixels where bits={self.given} is given")
            return image
        bits = self.bits
        most = (1 << bits) - 1
        above = np.count_nonzero(image > most) / image.size
        if above > _STRAY:
            needed = holding(int(image.max()))
            said = f"{above:.0%} of the pixels are above {most}, the most that {bits} bits hold"
            raise InputError(f"{said}, expected bits={needed} to be given (--bits {needed})")
        moved = np.minimum(image, most) << (16 - bits)
        return moved.astype(np.uint16, copy=False)

    def bits_of(self, image: Image) -> int | None:
        """Bits that an image's pixels use, None unless they are of 16 bits."""
        return self.bits if image.dtype == np.uint16 else None


def holding(value: int) -> int:
    """Bits of the smallest converter that gives a value: 8, 10, 12, 14 or 16."""
    return next(bits for bits in _DEPTHS if not value >> bits)


def used_bits(images: Iterable[Image]) -> int:
    """Bits that the pixels of 16-bit images use: 8, 10, 12, 14 or 16.

    Pixels whose two lowest bits are always 0 are aligned to the left, and those that are all multiples of 257 were
    widened from 8 bits: both use the full range however dark they are.

    Examples
    --------
    >>> used_bits([np.array([[700, 1023]], np.uint16)]), used_bits([np.array([[16, 4080]], np.uint16)])
    (10, 16)
    """
    used, widened = 0, True
    for image in images:
        if image.dtype == np.uint16:
            used |= int(np.bitwise_or.reduce(image, axis=None))
            widened = widened and not (image % 257).any()
        if used >> 14:
            return 16
    return 16 if widened or used % 4 == 0 else holding(used)
