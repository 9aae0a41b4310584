"""What ``run.json`` says of the calibration that a path was seen with, and what is to be doubted of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import FloatArray, Rig
from ..vision.slam.back_end.disparity_bias import LARGE_FOCAL, LARGE_OFFSET, SURE, CalibrationHealth, DisparityBias
from ..vision.slam.least_squares.offsets import Estimate

NEAR, FAR, _FARTHEST = 10.0, 30.0, 1e4  # m: depths that are told as examples, and the most that is said of them
_MEDIAN = 1.2533  # standard deviation of a median over that of a mean, of normal values
_FEWEST = 2  # keyframes for a standard deviation of their offsets

Warning_ = dict[str, str]


def depth_seen(rig: Rig, offset: float, depth: float = NEAR) -> float:
    """Depth at which a point is seen where all disparities are off.

    Parameters
    ----------
    rig : Rig
        The cameras.
    offset : float
        Measured less true disparity, px.
    depth : float
        Where the point is, m.

    Returns
    -------
    float
        m.
    """
    beyond = rig.fx * rig.baseline
    return float(beyond / max(beyond / depth + offset, beyond / _FARTHEST))


def describe_depths(rig: Rig, offset: float) -> str:
    """Say what an offset of all disparities does to depth.

    Parameters
    ----------
    rig : Rig
        The cameras.
    offset : float
        Measured less true disparity, px.

    Returns
    -------
    str

    Examples
    --------
    >>> rig = Rig(fx=700, fy=700, cx=600, cy=180, baseline=0.5, width=1200, height=360)
    >>> describe_depths(rig, -1.0)
    '10 m come out as 10.3 m (+2.9 %), 30 m as 32.8 m (+9.4 %)'
    """
    seen = [(depth, depth_seen(rig, offset, depth)) for depth in (NEAR, FAR)]
    near, far = (f"as {s:.3g} m ({100 * (s / d - 1):+.2g} %)" for d, s in seen)
    return f"{NEAR:g} m come out {near}, {FAR:g} m {far}"


def rows_offset(offsets: Sequence[float] | FloatArray) -> Estimate | None:
    """Median of the keyframes' row differences, with the standard deviation that their scatter gives.

    Parameters
    ----------
    offsets : (K,) float64
        Median of v_right - v_left of each keyframe, px.

    Returns
    -------
    Estimate or None
        None of fewer than two.

    Examples
    --------
    >>> rows_offset([0.1, 0.3, 0.2]).value
    0.2
    """
    if len(offsets) < _FEWEST:
        return None
    std = _MEDIAN * float(np.std(offsets, ddof=1)) / len(offsets) ** 0.5
    return Estimate(float(np.median(offsets)), std)


def thirds_of(offsets: Sequence[float]) -> tuple[Estimate | None, ...]:
    """Find the same over the first, middle and last third of the keyframes.

    Parameters
    ----------
    offsets : (K,) float64
        px, in the order of the keyframes.

    Returns
    -------
    tuple of 3 Estimate or None
        As `rows_offset` gives them.
    """
    return tuple(rows_offset(part) for part in np.array_split(np.asarray(offsets, np.float64), 3))


def describe_health(
    rows: Sequence[float], bias: DisparityBias | None, *, is_fixed: bool, frames: Sequence[int] | None = None
) -> dict[str, Any]:
    """What ``run.json`` says of a path's calibration besides its offsets.

    Parameters
    ----------
    rows : (K,) float64
        Row differences of the stored frames, px.
    bias : DisparityBias or None
        Of the path; None where poses come from elsewhere.
    is_fixed : bool
        Whether frames have the offset taken off.
    frames : sequence of int, optional
        Index of the pair of each frame of the path; the frames' own numbers by default.

    Returns
    -------
    dict
        Plain values, fit for JSON; None for what is not known.
    """
    found: dict[str, Any] = {}
    whole = rows_offset(rows)
    found["vertical_offset_error_px"] = None if whole is None else whole.std
    found |= _listed("vertical_offset_thirds", thirds_of(rows))
    if bias is None or bias.health is None:
        return found
    health, used = _by_pairs(bias.health, frames), bias.value if bias.is_used else 0.0
    found |= _listed("disparity_offset_thirds", health.thirds)
    for name, each in (("drift", health.drift), ("far_near", health.far_near), ("right_left", health.right_left)):
        found |= _pair(f"disparity_offset_{name}", each)
    step = health.sure_step
    found |= _pair("disparity_offset_step", None if step is None else step.size)
    found["disparity_offset_step_frames"] = None if step is None else [step.before, step.after]
    percent = Estimate(100 * health.focal.value, 100 * health.focal.std)
    found |= {"focal_length_error_percent": percent.value, "focal_length_error_std_percent": percent.std}
    found["unexplained"] = _reasons(health)
    return found | {"offset_taken_off_path_px": used, "offset_taken_off_frames_px": used if is_fixed else 0.0}


def _by_pairs(health: CalibrationHealth, frames: Sequence[int] | None) -> CalibrationHealth:
    """The same, with the frames of its step by the indices of their pairs."""
    step = health.step
    if step is None or frames is None:
        return health
    return replace(health, step=replace(step, before=frames[step.before], after=frames[step.after]))


def _pair(name: str, found: Estimate | None) -> dict[str, Any]:
    value, std = (None, None) if found is None else (found.value, found.std)
    return {f"{name}_px": value, f"{name}_std_px": std}


def _listed(name: str, found: Sequence[Estimate | None]) -> dict[str, Any]:
    return {
        f"{name}_px": [None if each is None else each.value for each in found],
        f"{name}_std_px": [None if each is None else each.std for each in found],
    }


def offset_doubts(
    rig: Rig, bias: DisparityBias, *, is_fixed: bool, frames: Sequence[int] | None = None
) -> Iterator[Warning_]:
    """What is to be doubted of the offset of all disparities.

    Parameters
    ----------
    rig : Rig
        The cameras as calibrated.
    bias : DisparityBias
        Of a finished path.
    is_fixed : bool
        Whether frames have the offset taken off.
    frames : sequence of int, optional
        As for `describe_health`.

    Yields
    ------
    dict of str to str
        A ``code`` and a ``message``.
    """
    found = Estimate(bias.value, bias.std)
    said = f"disparities are off by {found.value:+.2f} ± {found.std:.2g} px, as the motion tells"
    health = None if bias.health is None else _by_pairs(bias.health, frames)
    if health is not None and health.unexplained:
        reasons = "; ".join(_reasons(health))
        kept = "It is not used, and frames stay as they are" if is_fixed else "It is not used"
        message = (
            f"{said}, but one offset does not explain it: {reasons}. {kept}: was the rig knocked, or is more "
            f"of its calibration wrong? By the largest difference {describe_depths(rig, _largest(health))}"
        )
        yield {"code": "offset_unexplained", "message": message}
    elif found.exceeds(LARGE_OFFSET, SURE):
        depths = describe_depths(rig, found.value)
        end = (
            f"From frames, path and map it is taken off ({depths})"
            if is_fixed
            else f"In the frames' points {depths}; in path and map it is taken off (--fix-offset: in frames too)"
        )
        message = f"{said}; expected less than {LARGE_OFFSET:g}: is the calibration of these images? {end}"
        yield {"code": "disparity_offset", "message": message}
    if health is not None and health.focal.exceeds(LARGE_FOCAL, SURE):
        message = (
            f"the focal length seems {100 * health.focal.value:+.1f} ± {100 * health.focal.std:.1g} % off, as turns "
            f"tell; expected less than {100 * LARGE_FOCAL:g}: is the calibration of these images, and of their size?"
        )
        yield {"code": "focal_length", "message": message}


def _reasons(health: CalibrationHealth) -> list[str]:
    """What one offset does not explain, in words."""
    return [
        f"it differs by {each.value:+.2f} ± {each.std:.2g} px between {words}" for words, each in health.unexplained
    ]


def _largest(health: CalibrationHealth) -> float:
    """The largest of the differences that are not explained, px."""
    return max((each.value for _, each in health.unexplained), key=abs)


def border_doubts(bias: DisparityBias, recording: NDArray[np.int64], names: Sequence[str]) -> Iterator[Warning_]:
    """Doubt that two recordings of a run have one calibration: the offset steps where one ends and the next begins.

    Parameters
    ----------
    bias : DisparityBias
        Of a finished path.
    recording : (T,) int64
        Which recording each frame of the path is of.
    names : sequence of str
        What these are called.

    Yields
    ------
    dict of str to str
        As `offset_doubts`.
    """
    step = None if bias.health is None else bias.health.sure_step
    if step is None or recording[step.before] == recording[step.after]:
        return
    before, after = (names[int(recording[frame])] for frame in (step.before, step.after))
    message = (
        f"{after} and {before} seem to have other calibrations: disparities of {after} are off by "
        f"{step.size.value:+.2f} ± {step.size.std:.2g} px more"
    )
    yield {"code": "offsets_differ", "message": message}


def rows_doubts(offsets: Sequence[float], lone_std: float = np.inf) -> Iterator[Warning_]:
    """Doubt the rows of both images: an offset, or one that drifts.

    Parameters
    ----------
    offsets : (K,) float64
        Row differences of the stored frames, px.
    lone_std : float
        Standard deviation of that of a single frame, px; several tell it by their scatter.

    Yields
    ------
    dict of str to str
        As `offset_doubts`.
    """
    whole, thirds = rows_offset(offsets), thirds_of(offsets)
    if whole is None and len(offsets):
        whole = Estimate(float(offsets[0]), lone_std)
    first, last = thirds[0], thirds[-1]
    drift = None if first is None or last is None else last.less(first)
    if drift is not None and drift.exceeds(LARGE_OFFSET, SURE):
        said = f"the right image's rows have moved by {drift.value:+.2f} ± {drift.std:.2g} px from the first third to "
        yield {"code": "vertical_offset", "message": f"{said}the last: was the rig knocked?"}
    elif whole is not None and whole.exceeds(LARGE_OFFSET, SURE):
        said = f"rows of the right image are off by {whole.value:+.2f} ± {whole.std:.2g} px; expected less than "
        end = "matches are searched along the moved rows, so depths are not wrong by that"
        yield {"code": "vertical_offset", "message": f"{said}{LARGE_OFFSET:g}: {end}"}
