"""What the report says of a map: the surface to turn, with the path over it, and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..topological_map import TopologicalMap
from ._html import tiles
from ._map import check_map
from ._space import Others, Station
from ._turning import map_to_turn

MAP_CAPTIONS = {
    "map_path": (
        "The map from its path",
        "One surface over the landmarks of all keyframes, each a single vertex however often it was seen. Above, each "
        "face in its mean luminance over the keyframes that see it; below, the magnitude of the harmonic response.",
    ),
    "map_above": (
        "The map from above",
        "The surface, the camera's path, and where the keyframes stand. Faces that look down, a ceiling's, are left "
        "out.",
    ),
    "map_response": (
        "Response of the map",
        "The harmonic response as a direction in space: along the surface, toward where luminance grows; a vertex has "
        "one, whatever keyframe saw it. Hue is its direction on this picture, brightness its magnitude.",
    ),
    "map_variance": (
        "Difference between views",
        "How much the luminance of a face differs between keyframes, which a single frame cannot tell: what shines, "
        "moves or is mismatched stands out.",
    ),
}
OFTEN = 3  # observations of a landmark that is seen often


def map_section(map_: TopologicalMap, stations: Sequence[Station] = (), others: Others = ()) -> str:
    """Make the section of a map, which must be whole: the surface to turn with the path over it, and its numbers.

    Parameters
    ----------
    map_ : TopologicalMap
        The map.
    stations : sequence of Station
        Where each frame was taken, and how that went.
    others : sequence of (words, (T, 3) float64)
        Other paths, such as the true one, m.
    """
    check_map(map_)
    words = (
        "All keyframes in one simplicial complex: every vertex is a landmark, every face knows its luminance from all "
        "views."
    )
    return (
        f'<section class="scene" aria-labelledby="map"><h2 id="map">The map and the path</h2>'
        f'<p class="quiet">{words}</p>'
        f"{map_to_turn(map_, stations=stations, others=others)}{tiles(map_numbers(map_))}</section>"
    )


def map_numbers(map_: TopologicalMap) -> list[tuple[str, Any]]:
    """Names and values of what a map amounts to."""
    complex_, seen = map_.complex_, np.asarray(map_.view_count.face) > 0
    often = np.diff(map_.observations.start) >= OFTEN
    several = map_.direction_count > 1
    spread = float(np.degrees(np.median(map_.direction_spread[several]))) if several.any() else None
    return [
        ("vertices, each a landmark", complex_.n),
        ("edges", len(complex_.edges)),
        ("faces", len(complex_.faces)),
        ("Euler characteristic", complex_.euler),
        ("parts", int(map_.part.max()) + 1 if len(map_) else 0),
        ("keyframes", len(map_.keyframes)),
        (f"landmarks with {OFTEN} or more observations", _share(often)),
        ("faces that a keyframe sees, not too slanted", _share(seen)),
        ("vertices with a response", _share(map_.defined)),
        ("spread of a direction over views, median", None if spread is None else f"{spread:.1f}°"),
        ("exposure, most over least", f"{map_.gain.max() / map_.gain.min():.2f}×"),
    ]


def _share(which: np.ndarray[Any, np.dtype[np.bool_]]) -> str | None:
    return f"{100 * float(which.mean()):.0f} %" if len(which) else None
