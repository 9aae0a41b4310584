"""The keyframes of a map as other programs take them: their images of 8 bits in colour."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._checks import is_rigid, require
from ..errors import InputError
from ..topological_map import TopologicalMap
from ..types import Image
from ..vision.rig import check_image

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


def write_images(folder: Path, map_: TopologicalMap, image_of: ImageOf) -> NDArray[np.uint8]:
    """Write the image of each keyframe as PNG; returns the colour of each vertex, (N, 3), black if nothing shows it.

    It is the mean over the pixels of its observations, as the images have them: exposures are not taken out.
    """
    (folder / IMAGES).mkdir()
    seen, total, count = map_.observations, np.zeros((len(map_), 3)), np.zeros(len(map_))
    for row in range(len(map_.keyframes)):
        pixels = view_of(map_, row, image_of)
        write_bytes(folder / IMAGES / image_name(map_, row), png_of(pixels))
        rows = np.flatnonzero((seen.keyframe == row) & np.isfinite(seen.uv).all(axis=1))
        u, v = np.rint(np.clip(seen.uv[rows], 0, (map_.rig.width - 1, map_.rig.height - 1))).astype(np.int64).T
        total[seen.vertex[rows]] += pixels[v, u]  # a keyframe observes a vertex once
        count[seen.vertex[rows]] += 1
    return np.rint(total / np.maximum(count, 1)[:, None]).astype(np.uint8)


def png_of(pixels: NDArray[np.uint8]) -> bytes:
    """Encode grey or RGB as PNG; of photographs, level 6 takes 1 % fewer bytes and four times as long as 1."""
    from PIL import Image

    made = io.BytesIO()
    Image.fromarray(pixels).save(
        made, format="PNG", compress_level=1
    )  # of photographs, 6 takes 1 % less and 4 x longer
    return made.getvalue()


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
