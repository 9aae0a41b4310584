"""Pictures of the topological map of a sequence: from its path, from above, its response, and what varies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .._atomic import make_folder, write_bytes
from ..topological_map import TopologicalMap
from . import _map_faces as faces
from . import _map_page as page
from . import _style as style
from ._frame import limits
from ._map import check_map, deviation, magnitude, tangents
from ._viewpoints import from_above, from_path

MAGNITUDE_MAP, DEVIATION_MAP = "inferno", "magma"
DIMMEST = 0.3  # brightness of the least magnitude: its hue can still be told
BRIGHTEST = 95.0  # percentile of the deviations that is shown brightest: what moves is a small share


def write_map_pictures(map_: TopologicalMap, folder: str | Path) -> list[Path]:
    """Write every picture of a map as PNG; one set of versions gives the same map the same bytes.

    Parameters
    ----------
    map_ : TopologicalMap
        What to show.
    folder : path
        Where to; made if it does not exist.

    Returns
    -------
    list of Path
        The files in reading order: ``map_path`` (luminance, and magnitude of the response, from the middle of the
        path), ``map_above``, ``map_response`` (its direction and magnitude), ``map_variance`` (over the views).

    Raises
    ------
    InputError
        If the parts of the map do not belong together.
    OutputError
        If a picture cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from tspslam import Cloud, Frame, Response, Rig, Surface, build_complex, sample_signals
    >>> from tspslam.mapping.build import map_of_frame
    >>> uv, faces, image = np.array([[1.0, 1], [8, 2], [3, 7]]), np.array([[0, 1, 2]], np.int32), np.eye(10)
    >>> rig, complex_ = Rig(10, 10, 5, 5, width=10, height=10), build_complex(faces, 3)
    >>> cloud = Cloud(np.insert(uv / 10, 2, 5.0, axis=1), uv, np.ones(3))
    >>> signals, response = sample_signals(image, uv, complex_), Response(np.ones(3, complex), 1, np.ones(3, bool))
    >>> frame = Frame(0, 0.0, "toy", rig, cloud, Surface(faces), complex_, signals, response, image=image)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     [path.stem for path in write_map_pictures(map_of_frame(frame, rig, np.eye(4)), folder)]
    ['map_path', 'map_above', 'map_response', 'map_variance']
    """
    check_map(map_)
    views = from_above(map_), from_path(map_)
    pictures: dict[str, Callable[[TopologicalMap, faces.Pair], Figure]] = {
        "map_path": path_picture,
        "map_above": above_picture,
        "map_response": response_picture,
        "map_variance": variance_picture,
    }
    make_folder(Path(folder))
    paths = []
    for name, draw in pictures.items():
        paths.append(Path(folder) / f"{name}.png")
        write_bytes(paths[-1], style.png(draw(map_, views)))
    return paths


def path_picture(map_: TopologicalMap, views: faces.Pair) -> Figure:
    """Draw the surface from the middle of the path: luminance, and below it the magnitude of the response.

    Parameters
    ----------
    map_ : TopologicalMap
        What to show.
    views : (Outlook, Outlook)
        From above, and from the path.

    Returns
    -------
    Figure
    """
    outlook, strength = views[1], magnitude(map_)
    caption = (
        "From a little behind and above a keyframe in the middle of the path, along its view. Above: mean luminance of "
        "each face over all keyframes that see it, lightly shaded. Below: magnitude |r| of the harmonic response, "
        "large where luminance changes."
    )
    figure, (top, bottom) = page.double_page(map_, outlook, "The map from its path", caption)
    faces.show_luminance(figure, top, map_, outlook)
    norm = Normalize(*limits(strength.values[strength.ok]))
    page.show_faces(bottom, outlook, style.colours(strength.values, norm, MAGNITUDE_MAP), strength.ok)
    page.draw_legend(bottom, outlook, [], faces.tint_words(outlook, strength, "no response"))
    style.colour_bar(figure, bottom, norm, MAGNITUDE_MAP, "log₁₀ |r|", extend=faces.ends(strength, norm))
    return figure


def above_picture(map_: TopologicalMap, views: faces.Pair) -> Figure:
    """Draw the surface from above in its luminance, with the camera's path, its keyframes and a scale.

    Parameters, returns: as `path_picture`.
    """
    outlook = views[0]
    caption = (
        f"One surface of {len(map_.surface.faces)} faces over {len(map_)} landmarks; grey: mean luminance over views."
    )
    figure, axes = page.map_page(map_, outlook, "The map from above", caption + faces.left_out(map_))
    faces.show_luminance(figure, axes, map_, outlook)
    return figure


def response_picture(map_: TopologicalMap, views: faces.Pair) -> Figure:
    """Draw the response where it shows most: direction as hue, magnitude as brightness.

    Parameters, returns: as `path_picture`.
    """
    strength = magnitude(map_)
    outlook = faces.fuller(map_, views, strength)
    angle, length = tangents(map_, outlook)
    norm = Normalize(*limits(strength.values[strength.ok]))
    brightness = DIMMEST + (1 - DIMMEST) * np.clip(np.asarray(norm(strength.values)), 0, 1)
    rgb = page.direction_colours(angle, length, brightness)
    caption = (
        f"{faces.whence(outlook)}: the harmonic response of order {map_.response.order} at "
        f"{int(map_.defined.sum())} of {len(map_)} landmarks. Hue: the direction along the surface in which "
        "luminance grows, as it lies on this picture; grey: across it. Brightness: magnitude |r|, logarithmic."
    )
    figure, axes = page.map_page(map_, outlook, "Response of the map", caption + faces.left_out(map_, outlook))
    page.show_faces(axes, outlook, rgb, strength.ok)
    faces.explain(map_, axes, outlook, faces.tint_words(outlook, strength, "no response"))
    page.direction_wheel(figure, axes, norm, DIMMEST)
    return figure


def variance_picture(map_: TopologicalMap, views: faces.Pair) -> Figure:
    """Draw how much the luminance of each face differs between the keyframes that see it.

    Parameters, returns: as `path_picture`.
    """
    shown = deviation(map_)
    outlook = faces.fuller(map_, views, shown)
    norm = Normalize(0.0, max(limits(shown.values[shown.ok], high=BRIGHTEST)[1], 1e-3))
    caption = (
        f"{faces.whence(outlook)}: standard deviation of the luminance of each face over the keyframes that see it, "
        "after their exposures are made equal. Bright: what shines, moves or is mismatched."
    )
    figure, axes = page.map_page(map_, outlook, "Difference between views", caption + faces.left_out(map_, outlook))
    page.show_faces(axes, outlook, style.colours(shown.values, norm, DEVIATION_MAP), shown.ok)
    faces.explain(map_, axes, outlook, faces.tint_words(outlook, shown, "seen by fewer than two keyframes"))
    style.colour_bar(figure, axes, norm, DEVIATION_MAP, "deviation of luminance", extend=faces.ends(shown, norm))
    return figure
