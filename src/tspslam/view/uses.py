"""What the uses of a map show: its regions, and what denoising changed, as a picture and as a page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import hsv_to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .._atomic import make_folder, write_bytes
from ..errors import InputError
from ..topological_map import TopologicalMap
from ..types import FloatArray
from . import _map_faces as faces
from . import _map_page as page
from . import _style as style
from ._frame import Shown
from ._html import figures, page_of, text, tiles
from ._map import check_map
from ._turning import map_to_turn
from ._viewpoints import from_above, from_path

GOLDEN = (np.sqrt(5) - 1) / 2  # of a turn from one hue to the next: those of neighbouring numbers lie far apart
SATURATION, VALUES = 0.62, (0.95, 0.78)  # every other region is darker


def region_colours(labels: NDArray[np.integer[Any]]) -> FloatArray:
    """Give each region a colour; the same number has the same one in every picture and file.

    Parameters
    ----------
    labels : (F,) integers
        The region of each face, from 0.

    Returns
    -------
    (F, 3) float64
        RGB in [0, 1].
    """
    number = np.asarray(labels, np.int64)
    hue = (number * GOLDEN) % 1.0
    value = np.where(number % 2 == 0, *VALUES)
    return np.asarray(hsv_to_rgb(np.stack([hue, np.full(len(number), SATURATION), value], axis=1)))


def write_regions_picture(map_: TopologicalMap, labels: NDArray[np.integer[Any]], path: str | Path) -> Path:
    """Draw the regions of a map below its luminance, from where more of it is seen.

    Parameters
    ----------
    map_ : TopologicalMap
        What was segmented.
    labels : (F,) integers
        The region of each face, from 0.
    path : path
        A PNG file.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the parts of the map do not belong together, or there is not one label a face.
    OutputError
        If the file cannot be written.
    """
    check_map(map_)
    _check_labels(map_, labels)
    everywhere = Shown(np.zeros(len(labels)), np.ones(len(labels), np.bool_))
    outlook = faces.fuller(map_, (from_above(map_), from_path(map_)), everywhere)
    count = int(np.unique(labels).size)
    caption = f"{faces.whence(outlook)}. Above: luminance of each face. Below: {count} regions, each in a colour."
    figure, (top, bottom) = page.double_page(map_, outlook, "Regions", caption + faces.left_out(map_, outlook))
    faces.show_luminance(figure, top, map_, outlook)
    page.show_faces(bottom, outlook, region_colours(labels) * faces.light(map_)[:, None], everywhere.ok)
    return _written(figure, path)


def write_denoised_picture(before: TopologicalMap, after: TopologicalMap, path: str | Path) -> Path:
    """Draw a map before denoising, and below it after, both from the middle of the path.

    Where places moved, faces are shaded by how they stand; else they have their luminance.

    Parameters
    ----------
    before, after : TopologicalMap
        Of the same complex.
    path : path
        A PNG file.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the parts of a map do not belong together, or the maps have other faces.
    OutputError
        If the file cannot be written.
    """
    for each in (before, after):
        check_map(each)
    if not np.array_equal(before.complex_.faces, after.complex_.faces):
        raise InputError("view: the two maps have other faces, expected one complex before and after")
    outlook, has_moved = from_path(before), not np.array_equal(before.xyz, after.xyz)
    what = "faces shaded by how they stand" if has_moved else "luminance of each face"
    caption = f"From the middle of the path: {what}. Above: as measured. Below: denoised."
    figure, panels = page.double_page(before, outlook, "Denoised", caption)
    for axes, map_, view in zip(panels, (before, after), (outlook, from_path(after)), strict=True):
        if has_moved:
            shade = np.repeat(faces.light(map_, side=1.0)[:, None], 3, axis=1)
            page.show_faces(axes, view, shade, np.ones(len(shade), np.bool_))
        else:
            faces.show_luminance(figure, axes, map_, view)
    return _written(figure, path)


def write_use_page(
    map_: TopologicalMap, title: str, numbers: Sequence[tuple[str, Any]], pictures: Sequence[Path], path: str | Path,
    *, labels: NDArray[np.integer[Any]] | None = None, before: TopologicalMap | None = None,
) -> Path:  # fmt: skip
    """Write a page of what was made of a map, which loads nothing from anywhere: numbers, the map to turn, pictures.

    Parameters
    ----------
    map_ : TopologicalMap
        The map after it.
    title : str
        What was done, and with what.
    numbers : sequence of (name, value)
        What it amounts to.
    pictures : sequence of Path
        PNG files.
    path : path
        The HTML file.
    labels : (F,) integers, optional
        Regions, from 0: the map can be seen in their colours.
    before : TopologicalMap, optional
        What a denoised map was, of the same complex: its luminance can be seen too.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If the parts of the map do not belong together, or there is not one label a face.
    OutputError
        If the file cannot be written.
    """
    check_map(map_)
    if labels is not None:
        _check_labels(map_, labels)
    colours = None if labels is None else region_colours(labels)
    sections = [
        f"<header><h1>{text(title)}</h1></header>",
        tiles(numbers),
        f'<section class="scene"><h2>The map in space</h2>{map_to_turn(map_, colours, before=before)}</section>',
        f'<section class="pictures">{figures(pictures, {})}</section>' if pictures else "",
    ]
    make_folder(Path(path).parent)
    write_bytes(path, page_of(f"TSP-SLAM: {title}", sections).encode("utf-8", "replace"))
    return Path(path)


def _check_labels(map_: TopologicalMap, labels: NDArray[np.integer[Any]]) -> None:
    if len(labels) != len(map_.surface.faces):
        raise InputError(f"view: {len(labels)} labels for {len(map_.surface.faces)} faces, expected one a face")


def _written(figure: Figure, path: str | Path) -> Path:
    make_folder(Path(path).parent)
    write_bytes(path, style.png(figure))
    return Path(path)
