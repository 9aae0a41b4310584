"""How both images of a pair are in one frame of a video or a camera."""

from __future__ import annotations

from collections.abc import Callable

from .._files import PathLike, bad_input, one_line
from ..errors import InputError
from ..types import Image

LAYOUTS = ("side-by-side", "over-under", "alternate")
"""How both images are in one video: left and right half, upper and lower half, or frame after frame; left first."""
_WIDE, _TALL = 2.2, 1.15  # width / height: above it two images are beside each other, below it on top (16:9, 4:3, 5:4)
_HALVES: dict[str, Callable[[Image], tuple[Image, Image]]] = {
    "side-by-side": lambda image: (image[:, : image.shape[1] // 2], image[:, image.shape[1] // 2 :]),
    "over-under": lambda image: (image[: image.shape[0] // 2], image[image.shape[0] // 2 :]),
}


def halves(image: Image, layout: str) -> tuple[Image, Image]:
    """Divide a frame into the left and the right image.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        The frame.
    layout : str
        ``"side-by-side"`` or ``"over-under"``.

    Returns
    -------
    tuple of 2 (h, w) or (h, w, 3) uint8
        Half as wide, or half as high; views of the frame.
    """
    return _HALVES[layout](image)


def half_size(size: tuple[int, int], layout: str | None, where: PathLike) -> tuple[int, int]:
    """Return the size of the images in a frame of a layout.

    Parameters
    ----------
    size : tuple of 2 int
        Width and height of the frame, px.
    layout : str or None
        One of `LAYOUTS`; None for a frame that is one image.
    where : str or path
        What to name in the error.

    Returns
    -------
    tuple of 2 int
        px.

    Raises
    ------
    InputError
        If the side that is divided is odd.
    """
    for axis, (each, side) in enumerate((("side-by-side", "width"), ("over-under", "height"))):
        if layout == each and size[axis] % 2:
            raise bad_input(where, f"has the {side} {size[axis]} px, which is odd", f"two halves, as {layout} has them")
    return size[0] // (1 + (layout == "side-by-side")), size[1] // (1 + (layout == "over-under"))


def likely(size: tuple[int, int]) -> str:
    """Return words for the layout that the shape of a frame suggests.

    Parameters
    ----------
    size : tuple of 2 int
        Width and height of the frame, px.

    Returns
    -------
    str
        Empty where the shape is that of one image.
    """
    ratio = size[0] / size[1]
    layout = "side-by-side" if ratio > _WIDE else "over-under" if ratio < _TALL else ""
    return layout and f" ({layout} is likely, by its shape)"


def check_layout(layout: str | None) -> None:
    """Refuse a layout that is none.

    Parameters
    ----------
    layout : str or None
        What was given; None is no layout.

    Raises
    ------
    InputError
        If it is none of `LAYOUTS`.
    """
    if layout is not None and layout not in LAYOUTS:
        raise InputError(one_line(f"layout is {repr(layout)[:60]}, expected {' or '.join(LAYOUTS)}"))
