"""Pairs of one rig from images as they are stored: 16-bit pixels fill their range, and raw pairs are rectified."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from .._files import one_line
from ..errors import InputError
from ..types import FloatArray, Image, RawRig, Rig, StereoPair
from ..vision.calibration.rectify import Rectification, rectification
from ..vision.rig import check_pair
from ._levels import Levels


class StoredImages(Protocol):
    """Left and right images as a camera left them: of folders, a video or a bag, without a calibration."""

    @property
    def name(self) -> str:
        """What to call them."""

    @property
    def stamps(self) -> FloatArray:
        """Times of the pairs, s."""

    @property
    def names(self) -> Sequence[str]:
        """What to call each pair."""

    @property
    def unpaired(self) -> Sequence[str]:
        """Images without a partner."""

    def __len__(self) -> int:
        """How many pairs there are."""

    def images(self, index: int) -> Iterator[Image]:
        """Read the left and the right image of a pair; `InputError` if one is bad."""


class Reader:
    """Pairs of one rig: 16-bit pixels fill their range, and raw pairs are rectified.

    Parameters
    ----------
    cameras : Rig or RawRig
        Of the images as they are stored.
    images : callable
        Left and right image of a pair by its index, as they are stored.
    names : sequence of str
        What to call each pair.
    bits : int, optional
        How many bits 16-bit pixels use; found in a sample of all images by default.

    Attributes
    ----------
    rig : Rig
        The cameras of the rectified pairs.
    rectify : Rectification or None
        How raw pairs become rectified ones.
    """

    rig: Rig

    def __init__(
        self, cameras: Rig | RawRig, images: Callable[[int], Iterator[Image]], names: Sequence[str],
        bits: int | None = None,
    ) -> None:  # fmt: skip
        self._images, self._names, self._levels = images, names, Levels(images, len(names), bits)
        self.rectify: Rectification | None = None
        if isinstance(cameras, RawRig):
            self.rectify = rectification(cameras)
            cameras = self.rectify.rig
        self.rig = cameras

    def read(self, index: int) -> StereoPair:
        """Read a pair, with its index as its stamp.

        Parameters
        ----------
        index : int
            From 0.

        Returns
        -------
        StereoPair
        """
        stored = list(self._images(index))
        name = one_line(self._names[index])
        try:
            left, right = self._levels(stored)  # before rectification, which makes values between those that occur
            if self.rectify:
                left, right = map(_within, self.rectify(left, right))
        except InputError as error:
            raise InputError(f"{name}: {error}") from error
        bits = self._levels.bits_of(left)
        pair = StereoPair(left, right, self.rig, stamp=float(index), index=index, name=name, bits=bits)
        check_pair(pair)
        return pair


def _within(image: Image) -> Image:
    """Luminance from 0 to 1 again, where cubic interpolation went beyond; OpenCV sees to that for integers."""
    return np.clip(image, 0, 1, dtype=np.float32) if image.dtype == np.float32 else image


class FileReader(Reader):
    """Pairs from image files, named after the left one.

    Parameters
    ----------
    cameras, bits
        As `Reader`.
    files : sequence of tuple of 2 Path
        Left and right file of each pair.
    """

    def __init__(self, cameras: Rig | RawRig, files: Sequence[tuple[Path, Path]], bits: int | None = None) -> None:
        self._files = files
        super().__init__(cameras, self._read_files, [left.stem for left, _ in files], bits)

    def _read_files(self, index: int) -> Iterator[Image]:
        from ..io.images import read_image

        return map(read_image, self._files[index])
