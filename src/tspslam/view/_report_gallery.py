"""Frames to page through: small images, with keypoints and mesh drawn over them from compact data."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from ..frame import Frame
from ..types import Image
from ._frame import depth, grey, image_of, limits, projected
from ._html import data_of, plain, shown_value
from ._layers import table
from ._report_parts import Shot, State

MOST_SHOTS = 120
WIDEST = 480  # px of an image
QUALITY = 62  # of JPEG: keypoints are drawn over it
STEPS_A_PIXEL = 2  # of the places that are sent
MOST_POINTS, MOST_EDGES = 4000, 12_000  # of a frame: beyond it, points are thinned and the mesh is left out


def thinned(indices: Sequence[int], most: int = MOST_SHOTS) -> list[int]:
    """Choose at most so many of some numbers, evenly, with the first and the last.

    Examples
    --------
    >>> thinned(range(10), 4)
    [0, 3, 6, 9]
    """
    if len(indices) <= most:
        return list(indices)
    return [indices[k] for k in np.rint(np.linspace(0, len(indices) - 1, most)).astype(int).tolist()]


def shot_of(frame: Frame, state: State, landmarks: int | None = None) -> Shot:
    """Make what the gallery shows of a frame; `InputError` if it has no image."""
    picture = _small(image_of(frame))
    buffer = io.BytesIO()
    picture.save(buffer, "JPEG", quality=QUALITY, optimize=True)
    uv, z, edges = _drawn(frame)
    complex_ = frame.complex_
    counts: tuple[tuple[str, Any], ...] = (
        ("points", complex_.n),
        ("faces", len(complex_.faces)),
        ("responses", int(frame.response.defined.sum())),
    )
    counts += () if landmarks is None else (("landmarks", landmarks),)
    return Shot(
        frame.index, frame.name, frame.stamp, state, counts, buffer.getvalue(), picture.size,
        uv.astype(np.float32), z.astype(np.float32), edges.astype(np.int32),
    )  # fmt: skip


def gallery_section(shots: Iterable[Shot], stored: int) -> str:
    """Make the section of some of `stored` frames; nothing where there are none."""
    taken = list(shots)
    if not taken:
        return ""
    known = np.concatenate([shot.depth[np.isfinite(shot.depth)] for shot in taken])
    low, high = limits(known.astype(np.float64))
    span = (max(low, 1e-3), max(high, 1.01 * max(low, 1e-3)))
    data = {
        "frames": [_described(shot, span) for shot in taken],
        "table": base64.b64encode(table("viridis").tobytes()).decode(),
    }
    ratio = float(np.median([shot.size[0] / shot.size[1] for shot in taken]))
    script = files(__package__).joinpath("_web/gallery.js").read_text(encoding="utf-8")
    return (
        f"{_head(len(taken), stored)}{_stage(span)}"
        f'<ul class="previews" style="--ratio:{ratio:.4g}">{"".join(map(_preview, taken))}</ul>'
        f'<script type="application/json" class="frames">{data_of(data)}</script><script>{script}</script></section>'
    )


def _head(count: int, stored: int) -> str:
    """The beginning of the section: what is in it, of how many."""
    if count == 1 == stored:
        return '<section class="gallery single" aria-labelledby="gallery"><h2 id="gallery">The left image</h2>'
    few = "" if count == stored else f" {count} of {stored} stored frames are here, evenly chosen."
    return (
        '<section class="gallery" aria-labelledby="gallery"><h2 id="gallery">Frames to page through</h2>'
        f'<p class="quiet">Keyframes, and frames where tracking was lost.{few}</p>'
        f'<p class="quiet on-paper">Printed: the first of {count} frames; the page has all of them.</p>'
    )


def _stage(span: tuple[float, float]) -> str:
    """The large picture with its buttons, hidden until the script wakes it."""
    box = '<label><input type="checkbox" class="{}" checked> {}</label>'
    bar = f'<span class="bar" aria-hidden="true"></span>{shown_value(float(f"{span[1]:.2g}"))} m'
    return (
        '<div class="stage" hidden><div class="screen"><img class="large" alt=""><canvas aria-hidden="true"></canvas>'
        '</div><div class="row"><button type="button" class="previous">Previous</button>'
        '<button type="button" class="next">Next</button>'
        f"{box.format('points', 'Keypoints by depth')}{box.format('mesh', 'Mesh')}"
        f'<span class="legend">{shown_value(float(f"{span[0]:.2g}"))} m {bar}</span></div>'
        '<p class="said" role="status"></p></div>'
    )


def _preview(shot: Shot) -> str:
    width, height = shot.size
    data = base64.b64encode(shot.jpeg).decode("ascii")
    return (
        f'<li><button type="button" aria-label="Frame {shot.index}, {shot.state}" class="{shot.state}">'
        f'<img data-frame="{shot.index}" src="data:image/jpeg;base64,{data}" width="{width}" height="{height}" '
        'alt="" loading="lazy"></button></li>'
    )


def _described(shot: Shot, span: tuple[float, float]) -> dict[str, Any]:
    """Words and drawing of a frame, fit for JSON."""
    counts = ", ".join(f"{shown_value(value)} {name}" for name, value in shot.counts)
    words = plain(f"frame {shot.index}, {shot.name}, {shot.stamp:.6f} s: {shot.state}; {counts}")
    return {"words": words, "alt": f"Left image of frame {shot.index}", "drawing": drawing_of(shot, span)}


def drawing_of(shot: Shot, span: tuple[float, float]) -> str:
    """Pack keypoints and mesh as base64 of variable-length integers.

    Vertices come from left to right. First their number; then of each how far right of the one before and how far down
    it is, in half pixels; its place on the logarithmic scale of depth, from 1 to 255, or 0; how many edges go on from
    it, and of each how many vertices further its other end is.
    """
    grid = np.rint(np.clip(shot.uv, 0, 1) * shot.size * np.float64(STEPS_A_PIXEL)).astype(np.int64)
    order = np.lexsort((grid[:, 1], grid[:, 0]))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    ends = np.sort(rank[shot.edges], axis=1)
    ends = ends[np.lexsort((ends[:, 1], ends[:, 0]))]
    further = np.bincount(ends[:, 0], minlength=len(order))
    heads = np.stack([np.diff(grid[order, 0], prepend=0), grid[order, 1], _steps(shot.depth[order], span), further], 1)
    starts = 4 * np.arange(len(order)) + np.cumsum(further) - further
    values = np.empty(4 * len(order) + len(ends), np.int64)
    values[starts[:, None] + np.arange(4)] = heads
    within = np.arange(len(ends)) - np.repeat(np.cumsum(further) - further, further)
    values[np.repeat(starts, further) + 4 + within] = ends[:, 1] - ends[:, 0]
    return base64.b64encode(varints(np.concatenate([[len(order)], values]))).decode("ascii")


def varints(values: NDArray[np.int64]) -> bytes:
    """Pack integers below 2²⁸, seven bits a byte, the low ones first; the high bit says that one more follows.

    Examples
    --------
    >>> varints(np.array([5, 300])).hex()
    '05ac02'
    """
    parts = (values[:, None] >> (7 * np.arange(4))) & 0x7F
    count = np.maximum(1, 4 - np.argmax(parts[:, ::-1] > 0, axis=1))
    count[values == 0] = 1
    is_kept = np.arange(4) < count[:, None]
    goes_on = np.arange(4) < count[:, None] - 1
    return bytes((parts | (goes_on << 7)).astype(np.uint8)[is_kept].tobytes())


def _steps(z: NDArray[Any], span: tuple[float, float]) -> NDArray[np.int64]:
    """Places of depths on the scale, 0 where there is none."""
    known = np.isfinite(z) & (z > 0)
    share = np.log(np.where(known, z, span[0]) / span[0]) / np.log(span[1] / span[0])
    return np.where(known, np.clip(np.rint(1 + 254 * share), 1, 255), 0).astype(np.int64)


def _drawn(frame: Frame) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Vertices with a projection, as shares of the image, their depth, and the edges between them."""
    height, width = image_of(frame).shape[:2]
    seen, z = projected(frame), depth(frame)
    kept = np.flatnonzero(seen)
    edges = frame.complex_.edges
    edges = edges[seen[edges].all(axis=1)] if len(edges) else edges.reshape(0, 2)
    if len(edges) > MOST_EDGES or len(kept) > MOST_POINTS:
        kept, edges = kept[:: -(-len(kept) // MOST_POINTS)], edges[:0]
    place = np.full(len(seen), -1, np.int64)
    place[kept] = np.arange(len(kept))
    uv = (frame.cloud.uv[kept] + 0.5) / (width, height)
    return uv, np.where(z.ok, z.values, np.nan)[kept], place[edges]


def _small(image: Image) -> PillowImage.Image:
    """An image of at most 480 px in width, grey or in colour."""
    if image.dtype != np.uint8 or (image.ndim == 3 and image.shape[2] != 3):
        image = np.rint(255 * grey(image)).astype(np.uint8)
    picture = PillowImage.fromarray(np.ascontiguousarray(image))
    share = min(1.0, WIDEST / picture.width)
    size = (max(1, round(picture.width * share)), max(1, round(picture.height * share)))
    return picture if share == 1 else picture.resize(size, PillowImage.Resampling.BOX)
