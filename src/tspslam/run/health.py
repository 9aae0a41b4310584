"""How each frame of a run went, and whether its calibration fits: what ``run.json`` says, judged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..types import Rig
from ..view._report_parts import Finding, FrameState, State, Verdict
from ..vision.slam.back_end.disparity_bias import LARGE_FOCAL, LARGE_OFFSET, SURE
from .offset_doubts import describe_depths
from .summary import THIN

_FEWEST = 30  # landmarks: twice what a pose needs by default (tracking.pose.min_matches)
_WILD = 1e9  # of a number that may be a stranger's
_TWICE = 2.0  # times a threshold of `summary`: beyond it a value is wrong, between the two it is to be looked at
_THIRDS = 3
_STOPS = 2.0  # that exposures differ at most: 1.2 in KITTI 05 and 2.0 in EuRoC V1_01, whose cameras regulate it


def frame_states(run: Mapping[str, Any]) -> list[FrameState]:
    """Tell how each frame of a run went.

    A frame is weak if fewer landmarks agree with its pose than 30, or than a fifth of the run's median. In KITTI and
    at camera rate none has less than 0.57 of it.

    Parameters
    ----------
    run : dict
        What ``run.json`` holds; rows that are none are left out.

    Returns
    -------
    list of FrameState
        By the places of the frames in their sequence.

    Examples
    --------
    >>> row = {"index": 0, "name": "a", "stamp": 0.0, "is_keyframe": True, "is_lost": False, "landmarks_seen": 90}
    >>> [one.state for one in frame_states({"per_frame": [row], "skipped": [1]})]
    ['keyframe', 'skipped']
    """
    rows = {row["index"]: row for row in _rows(run.get("per_frame"))}
    seen = [_count(row) for row in rows.values() if not row.get("is_lost")]
    least = max(_FEWEST, THIN * float(np.median(seen))) if seen else 0.0
    loops = {pair[0] for pair in _rows(run.get("loop_closures"), kind=list) if pair and type(pair[0]) is int}
    states = {k: FrameState(k, "", None, "skipped", None) for k in _rows(run.get("skipped"), kind=int)}
    for k, row in rows.items():
        state = _state_of(row, least, is_loop=k in loops)
        states[k] = FrameState(k, str(row.get("name", "")), row.get("stamp"), state, _count(row))
    return [states[k] for k in sorted(states)]


def judge_calibration(calibration: Mapping[str, Any], rig: Rig | None, gain: ArrayLike | None) -> list[Finding]:
    """Judge what a run found of its cameras.

    Parameters
    ----------
    calibration : dict
        As ``run.json`` has it; what is missing, or is no number, is not known.
    rig : Rig or None
        The cameras, where they are known.
    gain : (K,) float64 or None
        Exposure gains of a map's keyframes.

    Returns
    -------
    list of Finding

    Examples
    --------
    >>> [finding.verdict for finding in judge_calibration({"vertical_offset_px": 0.1}, None, None)]
    ['fine', 'not known']
    """
    depths, more = [_depths(calibration, rig)], (_over_time, _lens)
    return [*_rows_level(calibration), *depths, *(each for one in more for each in one(calibration)), *_exposures(gain)]


def _rows(value: Any, kind: type = dict) -> list[Any]:
    return [each for each in value if type(each) is kind] if isinstance(value, list) else []


def _count(row: Mapping[str, Any]) -> int:
    value = row.get("landmarks_seen")
    return value if type(value) is int and 0 <= value < _WILD else 0


def _state_of(row: Mapping[str, Any], least: float, *, is_loop: bool) -> State:
    if row.get("is_lost"):
        return "lost"
    if _count(row) < least:
        return "weak"
    if is_loop:
        return "loop"
    return "keyframe" if row.get("is_keyframe") else "tracked"


def _number(values: Mapping[str, Any], name: str) -> float | None:
    value = values.get(name)
    if not isinstance(value, int | float) or isinstance(value, bool):
        return None
    return float(value) if abs(value) < _WILD else None


def _verdict(size: float, most: float) -> Verdict:
    return "fine" if size <= most else "look at it" if size <= _TWICE * most else "wrong"


def _rows_level(calibration: Mapping[str, Any]) -> Iterator[Finding]:
    """Whether the two images have the same rows."""
    offset, std = (_number(calibration, f"vertical_offset_{name}") for name in ("px", "std_px"))
    if offset is None:
        return
    spread = "" if std is None else f" (spread {std:.2g} px)"
    ends = {
        "fine": "the pair is well rectified.",
        "look at it": "the matcher takes it out, but the rectification could be better.",
        "wrong": "the pair is not rectified as its calibration says; calibrate it anew.",
    }
    verdict = _verdict(abs(offset), LARGE_OFFSET)
    words = f"A point is {abs(offset):.2f} px {'lower' if offset > 0 else 'higher'} in the right image{spread}: "
    yield Finding("Rows of left and right", verdict, words + ends[verdict])


def _depths(calibration: Mapping[str, Any], rig: Rig | None) -> Finding:
    """Whether all disparities share an offset, and what it does to depth."""
    offset, std = (_number(calibration, f"disparity_offset_{name}") for name in ("px", "std_px"))
    if offset is None or std is None:
        words = "One frame cannot tell whether all disparities are off by the same; a camera that moves can."
        return Finding("Disparities", "not known", words)
    reasons = [each for each in _listed(calibration, "unexplained") if isinstance(each, str)]
    said = f"All disparities are off by {offset:+.2f} ± {std:.2g} px, as the camera's motion tells"
    if reasons:
        words = f"{said}, but one offset does not explain what was seen: {'; '.join(reasons)}. It is not used."
        return Finding("Disparities", "wrong", words.replace("-", "\N{MINUS SIGN}"))
    verdict = _verdict(abs(offset), max(LARGE_OFFSET, SURE * std))
    is_fixed = bool(_number(calibration, "offset_taken_off_frames_px"))
    seen = "" if rig is None or is_fixed else f" In the points of frames, {describe_depths(rig, offset)}."
    end = "" if verdict == "fine" else " Does the calibration belong to these images, and to their size?"
    words = f"{said}.{seen} {'Frames, path' if is_fixed else 'Path'} and map have it taken off.{end}"
    return Finding("Disparities", verdict, words.replace("-", "\N{MINUS SIGN}"))


def _listed(values: Mapping[str, Any], name: str) -> list[Any]:
    value = values.get(name)
    return value if isinstance(value, list) else []


def _over_time(calibration: Mapping[str, Any]) -> Iterator[Finding]:
    """Whether the offsets of the thirds of the path agree."""
    thirds = [_listed(calibration, f"disparity_offset_thirds_{name}") for name in ("px", "std_px")]
    pairs = [pair for pair in zip(*thirds, strict=False) if all(isinstance(x, int | float) for x in pair)]
    drift, std = (_number(calibration, f"disparity_offset_drift_{name}") for name in ("px", "std_px"))
    if len(pairs) < _THIRDS or drift is None or std is None:
        return
    step = _number(calibration, "disparity_offset_step_px")  # there where it is large and certain
    verdict = _verdict(abs(drift), max(LARGE_OFFSET, SURE * std)) if not step else _verdict(abs(step), LARGE_OFFSET)
    said = ", ".join(f"{value:+.2f} ± {spread:.2g}" for value, spread in pairs)
    end = "they agree." if verdict == "fine" else "they do not agree; was the rig knocked, or is more of it wrong?"
    words = f"Over the first, middle and last third of the path disparities are off by {said} px: {end}"
    yield Finding("Over time", verdict, words.replace("-", "\N{MINUS SIGN}"))


def _lens(calibration: Mapping[str, Any]) -> Iterator[Finding]:
    """Whether the focal length fits, where turns tell."""
    error, std = (_number(calibration, f"focal_length_error_{name}") for name in ("percent", "std_percent"))
    if error is None or std is None:
        return
    most, limits = 100 * LARGE_FOCAL, "A wrong baseline scales everything alike: no stereo path can tell."
    if SURE * std > most:
        words = f"The camera turned too little to tell (±{std:.2g} %). {limits}"
        yield Finding("Focal length", "not known", words)
        return
    verdict = _verdict(abs(error), max(most, SURE * std))
    words = f"As turns of the camera tell, the focal length is off by {error:+.2g} ± {std:.1g} %. {limits}"
    yield Finding("Focal length", verdict, words.replace("-", "\N{MINUS SIGN}"))


def _exposures(gain: ArrayLike | None) -> Iterator[Finding]:
    """Whether the keyframes are about equally bright."""
    values = np.zeros(0) if gain is None else np.asarray(gain, np.float64)
    if len(values) < 2 or not (np.isfinite(values) & (values > 0)).all():
        return
    ratio = float(values.max() / values.min())
    verdict = _verdict(float(np.log2(ratio)), _STOPS)
    end = "" if verdict == "fine" else " Fix the camera's exposure if you can: what is over- or underexposed is lost."
    words = f"The brightest keyframe is exposed {ratio:.2f} times as much as the darkest; the map evens that out.{end}"
    yield Finding("Exposure", verdict, words)
