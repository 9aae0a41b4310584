"""From a pair of images to points: detect, match, triangulate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from ..._checks import require, require_stage
from ..._threads import both
from ...errors import GeometryError, InputError
from ...types import Cloud, Features, FloatArray, StereoPair
from ..features.detecting import detect_usable
from ..features.orb import OrbDetector
from ..images import Detector as Detector
from ..images import PreparedPair, are_usable, prepare
from .dense import checked_map, cloud_from_disparity, sample_map
from .descriptor_matcher import DescriptorMatcher
from .matches import Matches, uv_right
from .mismatch import explain_mismatch, refuse_one_picture_stored_twice
from .row_matcher import RowMatcher
from .triangulate import PIXEL_SIGMA, triangulate

Matcher = Callable[[Features, Features, StereoPair], Matches]
Preset = Literal["paper"]

PAPER_MATCHER = DescriptorMatcher(max_disparity=48.0)
_FEWEST = 3
_DARK = 1 << 13  # of 16-bit pixels: an eighth of white, which cameras of 8, 10 and 12 bits do not reach


@dataclass(frozen=True)
class StereoQuality:
    """How well a pair was matched, and how well it is rectified.

    Attributes
    ----------
    vertical_offset_px : float
        Median of ``v_right - v_left``; 0 for a perfectly rectified pair.
    vertical_offset_std_px : float
        Its spread: 1.4826 times the median absolute deviation.
    keypoints_left, keypoints_right : int
        Keypoints detected.
    matched : int
        Points in the cloud.
    by_row_search : int
        Of the matches, those found without a keypoint in the right image.
    """

    vertical_offset_px: float
    vertical_offset_std_px: float
    keypoints_left: int
    keypoints_right: int
    matched: int
    by_row_search: int


def reconstruct(
    pair: StereoPair,
    *,
    detector: Detector | None = None,
    matcher: Matcher | None = None,
    max_disparity: float | None = None,
    preset: Preset | None = None,
) -> Cloud:
    """Reconstruct the points that both cameras see.

    Parameters
    ----------
    pair : StereoPair
        A rectified pair. Where it carries a disparity map, points are sampled from that at the keypoints.
    detector : callable, optional
        Grey image (H, W) uint8 -> `Features`; `OrbDetector()` by default.
    matcher : callable, optional
        Left features, right features, pair -> `Matches`; `RowMatcher()` by default.
    max_disparity : float, optional
        Largest disparity, px; taken from the pair by default. Give it to `matcher` itself if you give one.
    preset : "paper", optional
        The paper's matching: descriptors along rows, disparities up to 48 px, no more.

    Returns
    -------
    Cloud
        At least 3 points in the left camera's frame, with covariance; no two on the same pixel.

    Raises
    ------
    InputError
        If the pair is not usable or the options contradict each other.
    GeometryError
        If fewer than 3 points are found, or the images are one picture twice, or look swapped, turned, or not
        rectified.

    Examples
    --------
    >>> from tspslam.datasets import motorcycle
    >>> cloud = reconstruct(motorcycle(), max_disparity=64)
    >>> len(cloud) > 1000
    True
    """
    return reconstruct_with_quality(
        pair, detector=detector, matcher=matcher, max_disparity=max_disparity, preset=preset
    )[0]


def reconstruct_with_quality(
    pair: StereoPair,
    *,
    detector: Detector | None = None,
    matcher: Matcher | None = None,
    max_disparity: float | None = None,
    preset: Preset | None = None,
) -> tuple[Cloud, StereoQuality]:
    """Reconstruct like `reconstruct`, and tell how well it went.

    Parameters, errors: as `reconstruct`.

    Returns
    -------
    cloud : Cloud
        The points.
    quality : StereoQuality
        Counts and the vertical offset between the images.

    Examples
    --------
    >>> from tspslam.datasets import motorcycle
    >>> cloud, quality = reconstruct_with_quality(motorcycle())
    >>> quality.matched == len(cloud), abs(quality.vertical_offset_px) < 0.5
    (True, True)
    """
    for value, what, such in ((detector, "detector", "OrbDetector()"), (matcher, "matcher", "RowMatcher()")):
        if value is not None:
            require_stage(value, what, such)
    seen = match_stereo(pair, detector or OrbDetector(), _choose_matcher(matcher, max_disparity, preset))
    return seen.cloud, seen.quality


@dataclass(frozen=True)
class Stereo:
    """What both images of a pair show.

    Attributes
    ----------
    left : Features
        Keypoints of the left image, N.
    disparity : (N,) float64
        Where the right image shows them too, px; NaN elsewhere.
    cloud : Cloud
        The points behind them.
    quality : StereoQuality
        How well the images match.
    """

    left: Features
    disparity: FloatArray
    cloud: Cloud
    quality: StereoQuality


def match_stereo(pair: StereoPair, detect: Detector, match: Matcher) -> Stereo:
    """Detect on both images at a time, match, triangulate.

    Parameters
    ----------
    pair : StereoPair
        The images.
    detect, match : callable
        The stages, as `detector` and `matcher` of `reconstruct`.

    Returns
    -------
    Stereo

    Raises
    ------
    InputError, GeometryError
        As `reconstruct`.
    """
    pair = prepare(pair)
    if pair.disparity is not None:
        return _of_map(pair, pair.disparity, detect_usable(pair.left_image, detect))
    left, right = both(lambda image: detect_usable(image, detect), (pair.left_image, pair.right_image))
    _require_features(pair, left, right)
    matches = match(left, right, pair)
    _check_matches(matches, left, right)
    matches = _drop_unseen(pair, left, matches)
    refuse_one_picture_stored_twice(pair, matches)
    cloud = triangulate(pair.rig, left, matches)
    explain_mismatch(pair, left, right, len(cloud))
    if len(cloud) < _FEWEST:
        raise GeometryError(
            f"{pair.name}: {len(cloud)} points from {len(left.uv)} left and {len(right.uv)} right keypoints and "
            f"{len(matches)} matches, expected at least {_FEWEST}"
        )
    disparity = np.full(len(left.uv), np.nan)
    disparity[matches.left_index] = matches.disparity
    return Stereo(left, disparity, cloud, _quality(left, right, matches, cloud))


def _drop_unseen(pair: PreparedPair, left: Features, matches: Matches) -> Matches:
    """Drop matches whose place in the right image no camera saw."""
    if pair.usable is None:
        return matches
    rows = are_usable(pair.usable, uv_right(left.uv[matches.left_index], matches.disparity))
    return replace(
        matches,
        left_index=np.asarray(matches.left_index)[rows],
        right_index=np.asarray(matches.right_index)[rows],
        disparity=np.asarray(matches.disparity)[rows],
        score=np.asarray(matches.score)[rows],
    )


def _of_map(pair: PreparedPair, disparity: FloatArray, left: Features) -> Stereo:
    """What the left image and a map of disparities show."""
    _require_features(pair, left, left)
    try:
        spread = PIXEL_SIGMA * left.scale
        cloud = cloud_from_disparity(pair.rig, disparity, left.uv, sigma=spread, sigma_map=pair.sigma)
    except InputError as error:
        raise type(error)(f"{pair.name}: {error}") from error
    if len(cloud) < _FEWEST:
        raise GeometryError(f"{pair.name}: {len(cloud)} places of the map are known, expected at least {_FEWEST}")
    known = sample_map(checked_map("disparity", disparity, pair.rig), left.uv)
    return Stereo(left, known, cloud, StereoQuality(0.0, 0.0, len(left.uv), 0, len(cloud), 0))


def _choose_matcher(matcher: Matcher | None, max_disparity: float | None, preset: str | None) -> Matcher:
    if preset not in (None, "paper"):
        raise InputError(f"preset is {preset!r}, expected 'paper' or None")
    if matcher is not None and (preset or max_disparity is not None):
        raise InputError("a matcher is given together with max_disparity or preset, expected the one or the other")
    if matcher is not None:
        return matcher
    if preset == "paper":
        return PAPER_MATCHER if max_disparity is None else replace(PAPER_MATCHER, max_disparity=max_disparity)
    return RowMatcher(max_disparity=max_disparity)


def _require_features(pair: PreparedPair, left: Features, right: Features) -> None:
    for features in (left, right):
        _check_features(features)
    if min(len(left.uv), len(right.uv)) < _FEWEST:
        raise GeometryError(
            f"{pair.name}: {len(left.uv)} left and {len(right.uv)} right keypoints, expected at least {_FEWEST} each; "
            f"the images have too little texture{_darkness(pair)}{_blindness(pair)}"
        )


def _check_features(features: Features) -> None:
    """Refuse what a detector of one's own gave, if its columns do not fit."""
    require(features, Features, "detector: result")
    shapes = {name: np.shape(getattr(features, name)) for name in ("uv", "descriptor", "score", "scale", "angle")}
    n = shapes["uv"][:1]
    expected = {"uv": (*n, 2), "score": n, "scale": n, "angle": n}
    if any(shapes[name] != shape for name, shape in expected.items()) or shapes["descriptor"][:-1] != n:
        found = ", ".join(f"{name} {shape}" for name, shape in shapes.items())
        raise InputError(f"detector: result has {found}, expected (N, 2), (N, D), (N,), (N,), (N,)")
    if not np.isfinite(features.uv).all():
        raise InputError("detector: result has a keypoint that is not finite, expected px")


def _check_matches(matches: Matches, left: Features, right: Features) -> None:
    """Refuse what a matcher of one's own gave, if its columns do not fit or name no keypoint."""
    require(matches, Matches, "matcher: result")
    i, j = np.asarray(matches.left_index), np.asarray(matches.right_index)
    if not i.shape == j.shape == np.shape(matches.disparity) == np.shape(matches.score) == (len(i),):
        raise InputError("matcher: result has columns of several lengths, expected (M,) each")
    is_whole = i.dtype.kind in "iu" and j.dtype.kind in "iu"
    if not is_whole or (
        len(i) and not (0 <= i.min() <= i.max() < len(left.uv) and -1 <= j.min() <= j.max() < len(right.uv))
    ):
        raise InputError("matcher: result names a keypoint that is not there, expected rows of left and right features")
    if len(np.unique(i)) < len(i):
        raise InputError("matcher: result has a left keypoint twice, expected each at most once")


def _darkness(pair: StereoPair) -> str:
    """Say that an image's 16-bit pixels fill so little of their range that they may use fewer bits; else nothing."""
    for side, image in (("left", pair.left), ("right", pair.right)):
        brightest = int(image.max()) if image.dtype == np.uint16 else 0
        if 0 < brightest < _DARK:
            return f": the brightest pixel of the {side} one is {brightest} of 65535; do they use fewer bits (--bits)?"
    return ""


def _blindness(pair: PreparedPair) -> str:
    """Say that most pixels are too near to some that no camera saw; else nothing."""
    share = 1.0 if pair.usable is None else float(pair.usable.mean())
    return f": {100 * share:.0f} % of their pixels are far enough from what no camera saw" if share < 0.5 else ""


def _quality(left: Features, right: Features, matches: Any, cloud: Cloud) -> StereoQuality:
    return StereoQuality(
        vertical_offset_px=matches.vertical_offset_px,
        vertical_offset_std_px=matches.vertical_offset_std_px,
        keypoints_left=len(left.uv),
        keypoints_right=len(right.uv),
        matched=len(cloud),
        by_row_search=int(np.count_nonzero(matches.right_index < 0)),
    )
