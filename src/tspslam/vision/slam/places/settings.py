"""How places seen before are found: each threshold, its unit, and where it comes from."""

from __future__ import annotations

from dataclasses import dataclass

from ...._settings import Checked, setting


@dataclass(frozen=True)
class LoopSettings(Checked, what="tracking.loops"):
    """How places seen before are found.

    Parameters
    ----------
    min_error : float
        Error of old landmarks in the image, in the median, above which a loop is closed.
    candidates : int
        Keyframes that a camera may have come back to, tried at each keyframe: so many near it, so many that look alike.
    lost_candidates : int
        Keyframes that a lost camera may be near.
    sample : int
        Descriptors of an image that say which keyframes it is like.
    min_words : float
        Words that a keyframe which looks alike shares with an image; those that other keyframes show count less.
    group : int
        Keyframes, with those that see the same landmarks, whose landmarks are looked for together.
    max_distance : float
        Distance of a keyframe that a camera may have come back to, beside what the path may have drifted.
    drift_rate : float
        How far a path may drift, by the way it has come.
    drift_slack : float
        How far a path may drift whatever its length.
    max_angle : float
        Angle between the viewing directions of the two.
    known_share : float
        Share of a keyframe's landmarks that are tracked already, from which it is not looked at.
    held_share : float
        Share of the tracked landmarks that keyframes before the window see, from which no place is looked for.
    min_landmarks : int
        Landmarks that prove a place.
    sure_landmarks : int
        Landmarks that prove a place far from where the camera was thought to be, if the keyframe before was not there.
    same_motion : float
        How far two keyframes in a row that are both at a place may have it from where the path has them.
    same_landmark : float
        Distance of two observations, in u, v and disparity, of one landmark.
    max_hamming : float
        Largest distance of two descriptors, bits in 256.
    ratio : float
        A descriptor's distance must be at most this times that of the second nearest.
    pnp_error : float
        Largest distance of a landmark that agrees with a pose from descriptors.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> LoopSettings(min_landmarks=50).min_error
    1.0
    """

    min_error: float = setting(1.0, 0, 100, unit="px", source="by hand; half, twice: same paths")
    candidates: int = setting(2, 0, 100, unit="keyframes", source="by hand; half, twice: same paths")
    lost_candidates: int = setting(5, 0, 100, unit="keyframes", source="by hand; half, twice: same paths")
    sample: int = setting(2000, 1, 100_000, unit="descriptors", source="all that the default detector finds")
    min_words: float = setting(
        2.0, 0, 1e6, unit="words", source="synthetic street, corridor: other places up to 1.5, the same 4 and more"
    )
    group: int = setting(3, 1, 100, unit="keyframes", source="as many as are tracked (references)")
    max_distance: float = setting(
        0.3, 0, 10, unit="m per m of depth", source="by hand; corridor 0.15: 1.5, 0.6: 1.7 mm (1.5)"
    )
    drift_rate: float = setting(0.02, 0, 1, unit="m per m", source="by hand; half, twice: same paths")
    drift_slack: float = setting(0.02, 0, 1, unit="m per m of depth", source="by hand; half, twice: same paths")
    max_angle: float = setting(40.0, 0, 180, unit="degrees", source="by hand; half, twice: same paths")
    known_share: float = setting(0.3, 0, 1, unit="", source="by hand; corridor 0.15: 1.7, 0.6: 1.5 mm (1.5)")
    held_share: float = setting(
        0.5, 0, 1, unit="", source="by hand; town along KITTI 06: 0.5 costs a seventh less a keyframe than 1"
    )
    min_landmarks: int = setting(
        30, 4, 10_000, unit="landmarks", source="twice what a pose needs; half, twice: same paths"
    )
    sure_landmarks: int = setting(120, 4, 100_000, unit="landmarks", source="four times what proves a place nearby")
    same_motion: float = setting(
        0.1, 0, 10, unit="m per m of depth", source="P3P of 15 points to 4 px of 700 is good to a twentieth"
    )
    same_landmark: float = setting(1.0, 0.01, 100, unit="px", source="by hand; corridor 0.5: 1.5, 2: 1.7 mm (1.5)")
    max_hamming: float = setting(
        64.0,
        0,
        256,
        unit="bits",
        source="as in matching left to right; corridor 32: 1.6, 128: 1.5 mm (1.5)",
    )
    ratio: float = setting(
        0.85,
        0,
        1,
        unit="",
        source="as in matching left to right; corridor 0.425: 1.6, 1: 1.5 mm (1.5)",
    )
    pnp_error: float = setting(4.0, 0.1, 100, unit="px", source="by hand; corridor 2: 1.5, 8: 1.6 mm (1.5)")
