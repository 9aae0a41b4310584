"""Images beside the scene: small, with a frame's points, mesh or signals over them; and patches around a place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...frame import Frame
from ...types import FloatArray, Image
from .._frame import grey, projected
from .._layers import BARE, Layer, colours_of, layers_of_frame

WIDTH = 640  # px of the image beside the scene, at most
THUMBNAIL = 120  # px of a keyframe's picture in the scene
PATCH, HALF = 96, 16  # px of a patch as shown; px of the image on each side of the place
COLUMNS = 3  # of patches
OVERLAYS: dict[str, str | None] = {  # words of the choice, and the frame's layer
    "Image alone": None, "Keypoints by depth": "depth", "Mesh": "mesh", "Luminance of faces": "face_signal",
    "Luminance of edges": "edge_signal", "Luminance of vertices": "vertex_signal", "Magnitude": "magnitude",
    "Phase": "phase",
}  # fmt: skip
_BRIGHT = (255, 214, 10)  # the cross in a patch, the mesh over an image
_SHIFT = 4  # bits of a pixel's fraction, as OpenCV draws them

Pixels = NDArray[np.uint8]


def shrunk(image: Image, width: int) -> Pixels:
    """An image in grey or colour as (h, w, 3) uint8, no wider than `width`."""
    height, across = image.shape[:2]
    scale = min(1.0, width / across)
    size = max(1, round(across * scale)), max(1, round(height * scale))
    levels: Any = _levels(image)
    small: Any = cv2.resize(levels, size, interpolation=cv2.INTER_AREA) if size != (across, height) else levels
    return np.ascontiguousarray(small if small.ndim == 3 else np.repeat(small[:, :, None], 3, axis=2))


def _levels(image: Image) -> Pixels:
    """Its 8-bit levels, (H, W) or (H, W, 3)."""
    if image.dtype == np.uint8 and (image.ndim == 2 or image.shape[2] == 3):
        return image.astype(np.uint8, copy=False)
    return np.rint(255 * grey(image)).astype(np.uint8)


def jpeg_of(pixels: Pixels, quality: int = 80) -> bytes:
    """Encode (h, w, 3) pixels."""
    done, data = cv2.imencode(".jpg", pixels[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    assert done
    return bytes(data)


def pixels_of(jpeg: bytes) -> Pixels:
    """Decode what `jpeg_of` gave."""
    decoded: Any = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)
    return np.ascontiguousarray(decoded[:, :, ::-1])


def overlaid(frame: Frame, name: str | None) -> Pixels | None:
    """A frame's image with one of its layers, or its mesh, over it; None if it has no image."""
    if frame.image is None:
        return None
    pixels = shrunk(frame.image, WIDTH)
    if name is None or not len(frame.cloud):
        return pixels
    scale = pixels.shape[1] / frame.image.shape[1]
    good = projected(frame)
    at = np.where(good[:, None], (frame.cloud.uv + 0.5) * scale - 0.5, 0.0)
    if name == "mesh":
        edges = frame.complex_.edges[good[frame.complex_.edges].all(axis=1)]
        cv2.polylines(pixels, list(_fixed(at)[edges]), False, _BRIGHT, 1, cv2.LINE_AA, _SHIFT)
        return pixels
    layer = next((each for each in layers_of_frame(frame) if each.name == name), None)
    return pixels if layer is None else _with_layer(pixels, frame, layer, at, good)


def _with_layer(pixels: Pixels, frame: Frame, layer: Layer, at: FloatArray, good: NDArray[np.bool_]) -> Pixels:
    colours, fixed = colours_of(layer).tolist(), _fixed(at)
    if layer.level == "vertex":
        for k in np.flatnonzero(good & layer.ok).tolist():
            cv2.circle(pixels, fixed[k].tolist(), 2 << _SHIFT, colours[k], cv2.FILLED, cv2.LINE_AA, _SHIFT)
        return pixels
    cells = frame.complex_.edges if layer.level == "edge" else frame.surface.faces
    for k in np.flatnonzero(good[cells].all(axis=1) & layer.ok).tolist():
        corners = fixed[cells[k]]
        if layer.level == "edge":
            cv2.line(pixels, corners[0].tolist(), corners[1].tolist(), colours[k], 2, cv2.LINE_AA, _SHIFT)
        else:
            cv2.fillConvexPoly(pixels, corners, colours[k], cv2.LINE_8, _SHIFT)
    return pixels


def _fixed(at: FloatArray) -> NDArray[np.int32]:
    return np.rint(at * (1 << _SHIFT)).astype(np.int32)


def patch(image: Image, uv: FloatArray, words: str) -> Pixels:
    """What an image shows around a place, enlarged, with a cross on it and words below."""
    levels = _levels(image)
    levels = levels if levels.ndim == 3 else np.repeat(levels[:, :, None], 3, axis=2)
    found: Any = cv2.getRectSubPix(levels, (2 * HALF + 1, 2 * HALF + 1), (float(uv[0]), float(uv[1])))
    large: Pixels = cv2.resize(found, (PATCH, PATCH), interpolation=cv2.INTER_CUBIC)
    middle = PATCH // 2
    for step in ((1, 0), (0, 1)):
        for side in (-1, 1):
            near, far = ((middle + side * off * step[0], middle + side * off * step[1]) for off in (4, 12))
            cv2.line(large, near, far, _BRIGHT, 1, cv2.LINE_AA)
    label = np.full((18, PATCH, 3), 255, np.uint8)
    cv2.putText(label, words[:14], (3, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (40, 40, 40), 1, cv2.LINE_AA)
    return np.vstack([large, label])


def sheet(patches: Sequence[Pixels]) -> Pixels:
    """Patches side by side, in rows."""
    height, width = patches[0].shape[:2]
    rows = -(-len(patches) // COLUMNS)
    page = np.full((rows * (height + 4), COLUMNS * (width + 4), 3), 255, np.uint8)
    for k, each in enumerate(patches):
        top, left = k // COLUMNS * (height + 4), k % COLUMNS * (width + 4)
        page[top : top + height, left : left + width] = each
    return page


def blank() -> Pixels:
    """What stands where there is no image."""
    return np.full((8, 8, 3), BARE, np.uint8)
