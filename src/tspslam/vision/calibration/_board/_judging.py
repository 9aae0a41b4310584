"""What a calibration from a board is worth: errors of each view, what the views cover, and what they cannot tell."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ....errors import InputError
from ....types import BoolArray, FloatArray, RawRig
from ._adjustment import Seen, undistorted
from ._start import matrix_of_pose, place_board

CELLS = (8, 6)  # columns, rows of the grid in which coverage is counted
FEWEST_VIEWS = 5  # of both cameras: as many as Zhang (2000) calibrates real cameras with; three are the least in theory
ENOUGH_VIEWS = 10  # what OpenCV's tutorial asks for; in Zhang's Figure 3 more views change little
_LEAST_TURN, _ENOUGH_TURN = 10.0, 30.0  # degrees between planes; parallel ones tell nothing (Zhang 2000), 45 most
_LARGEST_SPREAD, _NOTED_SPREAD = 0.01, 0.003  # standard deviation of the focal length as a share of it
_LEAST_COVERAGE = 0.4  # of the cells; half of each image is seen by both cameras where their view is shared by half
_ONE_HALF = 0.95  # of the corners
_BASELINES = (0.005, 5.0)  # m
_LARGE_ERROR, _LARGE_EPIPOLAR = 0.5, 0.5  # px, root mean square; matches along rows are looked for within a pixel
_FACTOR, _DEVIATIONS = 2.5, 5.0  # of the median, and robust standard deviations above it: a view that is left out
_LEAST_LIMIT = 0.3  # px: a view below it spoils nothing
_BLUR_FACTOR, _BLUR_LEAST = 2.0, 5.0  # of the median blur; px, that of any focus that serves


class Judged(NamedTuple):
    """Numbers of one view: root mean squares of a side's errors and of rows, px, NaN where there is none; tilt, °."""

    left: float
    right: float
    rows: float
    tilt: float


def rms(vectors: FloatArray) -> float:
    """Root mean square length of (N, 2) vectors, or of (N,) numbers; NaN of none."""
    return float(np.sqrt(np.sum(vectors**2) / len(vectors))) if len(vectors) else float("nan")


def blurred(widths: FloatArray) -> BoolArray:
    """Mark the views whose edges are far wider than those of the others; (n,) bool."""
    known = widths[np.isfinite(widths)]
    limit = max(_BLUR_FACTOR * float(np.median(known)), _BLUR_LEAST) if len(known) else np.inf
    return np.asarray(np.nan_to_num(widths, nan=0.0) > limit)


def limit_of(errors: FloatArray) -> float:
    """Error of a view above which it does not belong to the others, px."""
    known = errors[np.isfinite(errors)]
    middle = float(np.median(known))
    return max(_LEAST_LIMIT, _FACTOR * middle, middle + _DEVIATIONS * 1.4826 * float(np.median(np.abs(known - middle))))


def why_bad(lens: str, cameras: Sequence[FloatArray], parts: Sequence[Seen], errors: Judged, limit: float) -> str:
    """Say why a view does not fit: its corners are off, or the board is elsewhere in the right image."""
    own = [place_board(lens, cameras[each.side], each)[1] for each in parts]
    if len(parts) == 2 and max(own) < limit:
        worst = np.nanmax(errors[:2])
        return f"left and right do not belong together: {worst:.2f} px off jointly, {max(own):.2f} px each alone"
    side = "left" if np.nan_to_num(errors.left) >= np.nan_to_num(errors.right) else "right"
    return f"corners of the {side} image are {np.nanmax(errors[:2]):.2f} px off, where {limit:.2f} px go"


def row_errors(lens: str, cameras: Sequence[FloatArray], rig: RawRig, left: Seen, right: Seen) -> FloatArray:
    """Differences of rows (N,) after rectification, px of the mean focal length, of corners seen by both cameras."""
    turns = rectifying_turns(rig)
    focal = float(np.mean([camera[:2].mean() for camera in cameras]))
    v = []
    for camera, turn, seen in zip(cameras, turns, (left, right), strict=True):
        rays = undistorted(lens, camera, seen.uv)
        turned = np.column_stack([rays, np.ones(len(rays))]) @ turn.T
        v.append(focal * turned[:, 1] / turned[:, 2])
    return v[0] - v[1]


def rectifying_turns(rig: RawRig) -> tuple[FloatArray, FloatArray]:
    """Rotations of both cameras after which their rows agree (Bouguet's); they hang on the pose alone."""
    import cv2

    eye, none, T = np.eye(3), np.zeros(5), rig.matrix
    size = (rig.left.width, rig.left.height)
    made = cv2.stereoRectify(eye, none, eye, none, size, T[:3, :3].copy(), T[:3, 3].copy())
    return np.asarray(made[0]), np.asarray(made[1])


def coverage(uv: FloatArray, size: tuple[int, int]) -> float:
    """Share of the cells of a grid over the image that have a corner in them."""
    counts, _, _ = np.histogram2d(uv[:, 0], uv[:, 1], bins=CELLS, range=((0, size[0]), (0, size[1])))
    return float(np.mean(counts > 0))


def half_of(uv: FloatArray, size: tuple[int, int]) -> str:
    """Name the half of the image that has nearly all corners; empty if none has."""
    u, v = uv[:, 0] < size[0] / 2, uv[:, 1] < size[1] / 2
    shares = {"left": u.mean(), "right": (~u).mean(), "upper": v.mean(), "lower": (~v).mean()}
    return max(shares, key=lambda name: shares[name]) if max(shares.values()) >= _ONE_HALF else ""


def largest_turn(places: Sequence[FloatArray]) -> float:
    """Largest angle between the planes of two views, degrees."""
    normals = np.array([matrix_of_pose(place)[:3, 2] for place in places])
    return float(np.degrees(np.arccos(np.clip((normals @ normals.T).min(), -1, 1))))


def check_determined(turn: float, spreads: Sequence[float], halves: Sequence[str]) -> None:
    """Refuse views that leave the focal length open; `spreads` are its standard deviations as shares of it."""
    worst = max(spreads)
    if turn >= _LEAST_TURN and worst <= _LARGEST_SPREAD:
        return
    said = f"board: the views leave the focal length open (standard deviation {100 * worst:.2g} %)"
    if turn < _ENOUGH_TURN:
        raise InputError(
            f"{said}: planes of the board differ by {turn:.0f}° at most, expected views tilted by up to 45° each way"
        )
    half = next((f": corners lie in the {each} half of an image" for each in halves if each), "")
    raise InputError(f"{said}{half}, expected at most 1 %: views that are nearer, tilted, and all over the images")


def check_pose(T: FloatArray) -> None:
    """Refuse a right camera that is on the left, or at a distance that no rig has."""
    centre = -T[:3, :3].T @ T[:3, 3]
    distance = float(np.linalg.norm(centre))
    if not _BASELINES[0] <= distance <= _BASELINES[1]:
        raise InputError(
            f"board: the cameras are {distance:.3g} m apart, expected {_BASELINES[0]:g} to {_BASELINES[1]:g} m; "
            "is --square in metres?"
        )
    if centre[0] < -abs(centre[1]):
        raise InputError(
            f"board: the right camera is {-centre[0]:.3g} m to the left of the left one, expected LEFT before RIGHT"
        )
    if centre[0] <= abs(centre[1]):
        raise InputError(
            f"board: the right camera is at ({centre[0]:.3g}, {centre[1]:.3g}, {centre[2]:.3g}) m from the left one, "
            "expected it beside it, x > |y|: turn the images"
        )


def doubts(
    count: int, turn: float, spreads: Sequence[float], shares: Sequence[float], halves: Sequence[str],
    errors: Sequence[float], rows: float,
) -> dict[str, str]:  # fmt: skip
    """Warnings by their code: what to do better next time."""
    found = {}
    if count < ENOUGH_VIEWS:
        found["few_views"] = f"{count} views of both cameras are used, {ENOUGH_VIEWS} or more are good"
    if turn < _ENOUGH_TURN:
        found["little_tilt"] = f"planes of the board differ by {turn:.0f}° at most: tilt it by 30° to 45° each way"
    for side, share, half in zip(("left", "right"), shares, halves, strict=True):
        if half:
            found["one_half"] = f"corners lie in the {half} half of the {side} image: show the board in the other too"
        elif share < _LEAST_COVERAGE:
            cells = f"{CELLS[0]} x {CELLS[1]} cells of the {side} image"
            found["coverage"] = f"corners lie in {share:.0%} of the {cells}: show the board at its borders too"
    if max(spreads) > _NOTED_SPREAD:
        found["focal_spread"] = f"the focal length is known to {max(spreads):.2%} only: add near and tilted views"
    if max(errors) > _LARGE_ERROR:
        found["reprojection"] = f"corners are {max(errors):.2f} px off: is the board flat, is nothing blurred?"
    if rows > _LARGE_EPIPOLAR:
        found["rows_differ"] = f"rows differ by {rows:.2f} px after rectification: were both taken at one moment?"
    return found
