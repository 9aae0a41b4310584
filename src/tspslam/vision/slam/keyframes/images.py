"""Left images of keyframes, in case the camera comes back: the newest in memory, the others in a nameless file."""

from __future__ import annotations

import contextlib
import tempfile
import weakref
from collections import OrderedDict
from collections.abc import Callable
from typing import IO

import numpy as np
from numpy.typing import NDArray

from ....errors import InputError
from ....types import Image
from ...images import grey_levels

Grey = NDArray[np.uint8]


class KeyframeImages:
    """Grey images by the numbers of their frames.

    What memory has no room for goes to a temporary file that has no name, so that nothing is left of it, however the
    process ends. Where that cannot be written, the oldest images are forgotten, and counted; so are those that are to
    be had from elsewhere, and are there no more.

    Parameters
    ----------
    memory : float
        Room in memory, bytes; at least one image is held.
    shape : (int, int), optional
        Height and width of all images, px; any by default.

    Attributes
    ----------
    forgotten : int
        Images that are gone: the disk had no room for them, or their source has them no more.
    """

    def __init__(self, memory: float, shape: tuple[int, int] | None = None) -> None:
        self._memory, self._used, self._shape = memory, 0, shape
        self._held: OrderedDict[int, Grey] = OrderedDict()  # oldest first
        self._stored: dict[int, tuple[int, tuple[int, int]]] = {}  # where in the file, and the shape
        self._free: list[int] = []  # places of images that were dropped
        self._end = 0
        self._file: IO[bytes] | None = None
        self._elsewhere: dict[int, Callable[[int], Image]] = {}
        self.forgotten = 0

    def __contains__(self, index: int) -> bool:
        return index in self._held or index in self._stored or index in self._elsewhere

    def add(self, index: int, grey: Grey) -> None:
        """Keep an image.

        Parameters
        ----------
        index : int
            Number of the frame.
        grey : (H, W) uint8
            Its left image; not copied.
        """
        self._held[index] = grey
        self._used += grey.nbytes
        while self._used > self._memory and len(self._held) > 1:
            oldest, image = self._held.popitem(last=False)
            self._used -= image.nbytes
            self._store(oldest, image)

    def add_elsewhere(self, index: int, image_of: Callable[[int], Image]) -> None:
        """Note that an image is to be had from somewhere else: it is read when it is asked for.

        Parameters
        ----------
        index : int
            Number of the frame.
        image_of : callable
            Left image of a frame by its number.
        """
        self._elsewhere[index] = image_of

    def get(self, index: int) -> Grey | None:
        """Return an image, or None if it was forgotten.

        Parameters
        ----------
        index : int
            Number of the frame.

        Returns
        -------
        (H, W) uint8 or None
        """
        if index in self._held:
            return self._held[index]
        if index in self._stored:
            return self._load(index)
        return self._fetch(index) if index in self._elsewhere else None

    def drop(self, index: int) -> None:
        """Let an image go.

        Parameters
        ----------
        index : int
            Number of the frame.
        """
        image = self._held.pop(index, None)
        self._used -= 0 if image is None else image.nbytes
        place = self._stored.pop(index, None)
        if place is not None:
            self._free.append(place[0])
        self._elsewhere.pop(index, None)

    def close(self) -> None:
        """Let the file go, and with it what it holds."""
        if self._file is not None:
            self._file.close()
            self._file = None
        self._stored, self._free, self._end = {}, [], 0

    def _store(self, index: int, image: Grey) -> None:
        """Move an image to the file: all have one size, so that the place of one serves for any other.

        As it is: zlib or PNG at their fastest would take 11 or 14 ms to leave 0.77 or 0.65 of an image of KITTI.
        """
        try:
            file = self._file or self._open()
            place = self._free[-1] if self._free else self._end
            file.seek(place)
            if file.write(np.ascontiguousarray(image).data) < image.nbytes:
                raise OSError("no room")
        except OSError:  # what was there before is whole: the next image may find room
            self.forgotten += 1
            return
        if self._free:
            self._free.pop()
        self._end = max(self._end, place + image.nbytes)
        self._stored[index] = place, (image.shape[0], image.shape[1])

    def _open(self) -> IO[bytes]:
        """The file, which is gone when these images are, also where nobody closes them."""
        self._file = tempfile.TemporaryFile(prefix="tspslam-", buffering=0)  # noqa: SIM115
        weakref.finalize(self, self._file.close)
        return self._file

    def _load(self, index: int) -> Grey | None:
        """Read an image from the file."""
        assert self._file is not None
        place, shape = self._stored[index]
        image = np.empty(shape, np.uint8)
        with contextlib.suppress(OSError):
            self._file.seek(place)
            if self._file.readinto(image.data) == image.nbytes:  # type: ignore[attr-defined]
                return image
        del self._stored[index]
        self.forgotten += 1
        return None

    def _fetch(self, index: int) -> Grey | None:
        """Take over an image from elsewhere, if it is there and as large as the others."""
        image_of = self._elsewhere.pop(index)
        with contextlib.suppress(InputError, OSError):  # of a file that is gone, from a source of the caller's own
            image = np.array(grey_levels(image_of(index)))
            if self._shape in (None, image.shape):
                self.add(index, image)
                return image
        self.forgotten += 1
        return None
