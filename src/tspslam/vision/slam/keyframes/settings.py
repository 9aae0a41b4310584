"""Which landmarks and keyframes the map keeps, and what is adjusted."""

from __future__ import annotations

from dataclasses import dataclass

from ...._settings import Checked, setting


@dataclass(frozen=True)
class MapSettings(Checked, what="tracking.map"):
    """Which landmarks and keyframes the map keeps, and what is adjusted.

    Parameters
    ----------
    min_total : float
        Least disparity + doffs of a new landmark; farther points become landmarks once they come nearer.
    spacing : float
        Least distance of a new landmark from those that are tracked.
    references : int
        Last keyframes whose landmarks are looked for in a new image.
    cull_every : int
        Keyframes between cullings.
    min_views : int
        Other keyframes that must see a landmark, for one keyframe to be redundant in it.
    redundant_share : float
        Share of its landmarks in which a keyframe is redundant, from which it is culled.
    twin_distance : float
        Largest distance of two keyframes of which one is culled, if they look the same way and share landmarks.
    twin_angle : float
        Largest angle between their viewing directions.
    twin_share : float
        Least share of the landmarks of the one that the other sees.
    image_bytes : float
        Room in memory for the images of older keyframes, in case the camera comes back; more go to a temporary file.
    min_shared : int
        Landmarks in common with the window, from which an older keyframe is held fixed in its adjustment.
    min_points : int
        Landmarks seen twice or more that an adjustment needs.
    max_keyframes : int
        Keyframes that are adjusted at once at the end; maps of more are adjusted piece by piece.
    max_steps : int
        Steps of an adjustment.
    outlier : float
        Standard deviations beyond which an observation is dropped after an adjustment.
    left_behind : float
        How far from where the one keyframe that saw it has it a landmark may stay where that keyframe is adjusted,
        standard deviations of a tracked point; farther ones go with it.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> MapSettings(spacing=20).spacing
    20.0
    """

    min_total: float = setting(1.5, 0, 1e3, unit="px", source="0.3 px are a fifth; KITTI 05 0.75: 45, 3: 37 mm (38)")
    spacing: float = setting(12.0, 1, 1e3, unit="px", source="patches stay apart; KITTI 05 6: 56, 24: 33 mm (38)")
    references: int = setting(3, 1, 50, unit="keyframes", source="by hand; KITTI 05 2: 39, 6: 40 mm (38)")
    cull_every: int = setting(10, 1, 1000, unit="keyframes", source="by hand; KITTI 05 5: 38, 20: 38 mm (38)")
    min_views: int = setting(3, 1, 100, unit="keyframes", source="Mur-Artal 2015; half, twice: same paths")
    redundant_share: float = setting(0.9, 0, 1, unit="", source="Mur-Artal 2015; KITTI 05 0.45: 40, 1: 38 mm (38)")
    twin_distance: float = setting(0.1, 0, 10, unit="m per m of depth", source="by hand; half, twice: same paths")
    twin_angle: float = setting(15.0, 0, 180, unit="degrees", source="by hand; half, twice: same paths")
    twin_share: float = setting(0.3, 0, 1, unit="", source="by hand; half, twice: same paths")
    image_bytes: float = setting(50e6, 0, 1e12, unit="bytes", source="110 keyframes of KITTI; any: same paths")
    min_shared: int = setting(4, 1, 1000, unit="landmarks", source="by hand; half, twice: same paths")
    min_points: int = setting(30, 3, 10_000, unit="landmarks", source="two poses' need; half, twice: same paths")
    max_keyframes: int = setting(500, 2, 5000, unit="keyframes", source="72 MB of equations; half, twice: same paths")
    max_steps: int = setting(8, 1, 100, unit="steps", source="by hand; KITTI 05 4: 38, 16: 38 mm (38)")
    outlier: float = setting(5.0, 1, 100, unit="sigmas", source="by hand; KITTI 05 2.5: 42, 10: 40 mm (38)")
    left_behind: float = setting(
        6.0, 0, 1e6, unit="sigmas", source="the next frame would drop it (first_gate); KITTI 05 0: 37, 3.3: 41 mm (38)"
    )
