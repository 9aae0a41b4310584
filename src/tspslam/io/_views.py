"""The keyframes of a map as other programs take them: images of 8 bits in colour, names, colours of the vertices."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import is_rigid, require
from ..errors import InputError
from ..topological_map import TopologicalMap
from ..types import Image, one_channel
from ..vision.rig import check_image
from .images import write_png

ImageOf = Callable[[int], Image]
"""Gives the left image of a keyframe, by its row in `TopologicalMap.keyframes`."""
IMAGES = "images"
TO_CORNER = 0.5  # px: COLMAP and nerfstudio count from the corner of the first pixel, ours from its centre


def check_views(map_: Any, what: str) -> None:
    """Refuse what is no map with keyframes of rigid poses, or whose camera has a skew, which others do not know."""
    require(map_, TopologicalMap, "map_")
    if not len(map_.keyframes):
        raise InputError(f"{what}: the map has no keyframe, expected at least one")
    if not is_rigid(map_.T_world_camera):
        raise InputError(f"{what}: T_world_camera of the map holds no rigid motion")
    if map_.rig.skew:
        raise InputError(f"{what}: the camera has a skew of {map_.rig.skew:g} px, expected 0: its model has none")


def image_name(map_: TopologicalMap, row: int) -> str:
    """Name a keyframe's image by the number of its frame, as the run folder does."""
    return f"{map_.keyframes[row]:06d}.png"


def write_images(folder: Path, map_: TopologicalMap, image_of: ImageOf) -> None:
    """Write the image of each keyframe as PNG."""
    (folder / IMAGES).mkdir()
    for row in range(len(map_.keyframes)):
        write_png(folder / IMAGES / image_name(map_, row), view_of(map_, row, image_of))


def view_of(map_: TopologicalMap, row: int, image_of: ImageOf) -> NDArray[np.uint8]:
    """Ask for the image of a keyframe; it has the size that the camera says."""
    image, rig = image_of(row), map_.rig
    what = f"image of frame {map_.keyframes[row]}"
    check_image(what, image)
    if image.shape[:2] != (rig.height, rig.width):
        size = f"{image.shape[1]} x {image.shape[0]} px"
        raise InputError(f"{what} is {size}, expected {rig.width} x {rig.height} px as the camera")
    return in_colour(image)


def in_colour(image: Image) -> NDArray[np.uint8]:
    """Turn an image into (H, W, 3) of 8 bits, three equal channels where it is grey: loaders of splats slice three.

    Nothing is lost of 8 bits; 16 bits and floats are rounded.
    """
    if image.dtype == np.uint8:
        pixels = image
    else:
        scale = 255 / 65535 if image.dtype == np.uint16 else 255.0
        pixels = np.rint(image * scale).astype(np.uint8)
    return np.ascontiguousarray(np.broadcast_to(pixels[..., None], (*pixels.shape, 3)) if pixels.ndim == 2 else pixels)


def vertex_rgb(map_: TopologicalMap) -> NDArray[np.uint8]:
    """Colour of each vertex, (N, 3): its luminance or colour, cut at white; black where it has none."""
    signal, ok = map_.signals.vertex, map_.signals.vertex_ok
    channels = signal if signal.ndim == 2 and signal.shape[1] == 3 else one_channel(signal)[:, None]
    values = np.rint(255 * np.clip(channels, 0, 1)).astype(np.uint8)
    return np.where(ok[:, None], np.broadcast_to(values, (len(values), 3)), np.uint8(0))
