"""The state of an odometry as arrays, and whether it is one that it can have given: shapes, ranges, agreement."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._checks import is_rigid
from ..._npz import Arrays, check_shapes
from ...errors import InputError
from ...types import FloatArray, Image, Rig
from ..images import build_pyramid
from ..rig import project
from ..se3 import inverse
from .keyframes.keyframe import Keyframe
from .keyframes.map import Map

# Letters are lengths that must agree: t frames, k keyframes, s observations of landmarks, n landmarks, r that
# were merged, c loops, j joins of parts of the map, b recordings but the first, m frames of two motions, l landmarks of
# the loop that is being closed, q keyframes that are not settled, d 64-bit parts of a descriptor; g keyframes and h
# landmarks of the map that a loop is being closed of, i keyframes that will not be settled then.
SCHEMA: dict[str, tuple[str, tuple[int | str, ...]]] = {
    "stamps": ("<f8", ("t",)),
    "anchors": ("<i8", ("t",)),
    "anchored": ("<f8", ("t", 4, 4)),
    "links": ("<i8", ("t",)),
    "linked": ("<f8", ("t", 6, 6)),
    "poses": ("<f8", (2, 4, 4)),
    "counts": ("<i8", (5,)),
    "closures": ("<i8", ("c", 2)),
    "loops": ("<i8", ("e", 2)),
    "looped": ("<f8", ("e", 6, 6)),
    "joins": ("<i8", ("j", 3)),
    "begun": ("<i8", ("b",)),
    "doubted": ("<i8", ("m", 3)),
    "doubt": ("<f8", (6, 6)),
    "row_offset": ("<f8", ()),
    "keyframe_index": ("<i8", ("k",)),
    "keyframe_pose": ("<f8", ("k", 4, 4)),
    "keyframe_part": ("<i8", ("k",)),
    "keyframe_observations": ("<i8", ("k",)),
    "landmark": ("<i8", ("s",)),
    "uv": ("<f8", ("s", 2)),
    "disparity": ("<f8", ("s",)),
    "sigma": ("<f8", ("s",)),
    "xyz": ("<f8", ("n", 3)),
    "landmark_id": ("<i8", ("n",)),
    "next_id": ("<i8", ()),
    "added": ("<i8", ()),
    "merged": ("<i8", ("r", 2)),
    "descriptors": ("<u8", ("n", "d")),
    "bias": ("<f8", (2,)),
    "loop_pose": ("<f8", (4, 4)),
    "loop_landmark": ("<i8", ("l",)),
    "loop_seen": ("<f8", ("l", 4)),
    "unsettled": ("<i8", ("q",)),
    "correction_keyframe": ("<i8", ("g",)),
    "correction_motions": ("<f8", ("g", 4, 4)),
    "correction_landmark_id": ("<i8", ("h",)),
    "correction_holder": ("<i8", ("h",)),
    "correction_unsettled": ("<i8", ("i",)),
}
_MAY_BE_NAN = frozenset({"disparity", "linked", "loop_seen"})
_NO_OBSERVATIONS: Arrays = {"landmark": np.empty(0, np.int64), "uv": np.empty((0, 2))} | dict.fromkeys(
    ("disparity", "sigma"), np.empty(0)
)
_UNDER_WAY = 3  # place in `counts`: 1 for an adjustment, 2 for a loop that is being closed, 3 for both
_CORRECTING = 2
_LARGEST = 1e9  # of any value; positions in m
_LATEST = 1e10  # s, of a stamp: in the year 2286, if it counts from 1970
_ROUNDING = 1e-6  # m per m, of a product of poses
_NEAREST_TOTAL = 1.5  # px of disparity + doffs, below which no landmark is made by default: how far a camera sees
_LONGEST_STEP = 10.0  # of that distance, from a frame to the next: a camera that is tracked moves much less
# Of the image's width, in the median over a keyframe, from where its landmarks should be seen: runs have less than
# 0.001, and 0.007 right after a frame was placed wrongly.
_MAX_OFF = 0.1
_FINEST = 1e-9  # px, of a standard deviation: a thousandth of what the last bits of a 32-bit disparity leave open
_MAX_WIDE = 0.01  # likewise, of disparities from those of the landmarks' depths: runs have less than 0.001


def map_state(map_: Map) -> dict[str, NDArray[Any]]:
    """Collect all of a map but its images, as arrays.

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.

    Returns
    -------
    dict of arrays
    """
    frames, gaps = map_.keyframes, map_.gaps
    columns = map_.observations()
    row = np.cumsum(np.bincount(gaps, minlength=len(map_.xyz)) == 0) - 1  # without the gaps
    return columns | {
        "landmark": row[columns["landmark"]],
        "keyframe_index": np.array([frame.index for frame in frames], np.int64),
        "keyframe_pose": np.array([frame.T_world_camera for frame in frames]).reshape(-1, 4, 4),
        "keyframe_part": np.array([frame.part for frame in frames], np.int64),
        "keyframe_observations": np.array([len(frame.landmark) for frame in frames], np.int64),
        "xyz": np.delete(map_.xyz, gaps, axis=0),
        "descriptors": np.delete(map_.descriptors, gaps, axis=0),
        "landmark_id": np.delete(map_.landmark_id, gaps, axis=0),
        "next_id": np.array(map_.next_id),
        "added": np.array(map_.added),
        "merged": map_.merged,
        **_loop_state(map_),
    }


def _loop_state(map_: Map) -> dict[str, NDArray[Any]]:
    """The loop that is being closed, and what earlier ones have left to adjust."""
    loop = map_.loop
    return {
        "loop_pose": np.eye(4) if loop is None else loop.T_world_camera,
        "loop_landmark": np.empty(0, np.int64) if loop is None else loop.landmark,
        "loop_seen": np.empty((0, 4)) if loop is None else np.column_stack([loop.uv, loop.disparity, loop.sigma]),
        "unsettled": np.array(sorted(map_.unsettled), np.int64),
    }


def restore_map(map_: Map, state: Mapping[str, NDArray[Any]], image_of: Callable[[int], Image]) -> None:
    """Restore a map from a state that was checked.

    Parameters
    ----------
    map_ : Map
        Changed.
    state : dict of arrays
        As `map_state` gave it.
    image_of : callable
        Left image of a frame by its number.
    """
    last = map_.settings.references
    map_.xyz, map_.descriptors = state["xyz"], state["descriptors"]
    map_.landmark_id, map_.next_id = state["landmark_id"], int(state["next_id"])
    map_.merged, map_.added = state["merged"], int(state["added"])
    map_.unsettled = set(state["unsettled"].tolist())
    ends = np.cumsum(state["keyframe_observations"])
    map_.keyframes, parts = [], state["keyframe_part"].tolist()
    for k, index in enumerate(state["keyframe_index"].tolist()):
        rows = slice(ends[k] - state["keyframe_observations"][k], ends[k])
        map_.images.add_elsewhere(index, image_of)
        image = build_pyramid(image_of(index)) if k >= len(ends) - last else None
        landmark, uv, disparity, sigma = (state[name][rows] for name in ("landmark", "uv", "disparity", "sigma"))
        T, is_start = state["keyframe_pose"][k], k > 0 and parts[k] != parts[k - 1]
        map_.keyframes.append(Keyframe(index, T, image, landmark, uv, disparity, sigma, is_start, parts[k]))
    if len(state["loop_landmark"]):
        u, v, disparity, sigma = state["loop_seen"].T.copy()
        T, landmark, uv = state["loop_pose"], state["loop_landmark"], np.column_stack([u, v])
        map_.loop = Keyframe(int(state["closures"][-1, 0]), T, None, landmark, uv, disparity, sigma)
    map_.note_sightings()


def check_state(state: Mapping[str, NDArray[Any]], rig: Rig) -> None:
    """Check the arrays of `Odometry.state`, which may come from a file that something else has changed.

    Values that a path of this rig cannot have are found; small changes cannot be.

    Raises
    ------
    InputError
        With the first thing that is wrong.
    """
    try:
        fault = next(_faults(_NO_OBSERVATIONS | dict(state), rig), None)
    except InputError as error:
        fault = str(error)
    if fault:
        raise InputError(f"odometry: the state does not hold together ({fault}), expected what `state` gave")


def _faults(state: Arrays, rig: Rig) -> Iterator[str]:
    """What is wrong, one fault after another: each check relies on those before it."""
    yield from _wrong_types(state)
    check_shapes({name: state[name] for name in SCHEMA}, SCHEMA, {})
    yield from _wild_numbers(state, rig)
    yield from _wrong_numbers_of_frames(state, rig)
    yield from _wrong_observations(state, rig)
    yield from _wrong_loop(state)
    yield from _wrong_ids(state)
    yield from _broken_path(state, rig)
    yield from _landmarks_elsewhere(state, rig)


def _wrong_types(state: Arrays) -> Iterator[str]:
    for name, (kind, _) in SCHEMA.items():
        if name not in state:
            yield f"it has no array {name}"
        elif state[name].dtype != np.dtype(kind):
            yield f"array {name} has type {state[name].dtype}"


def _wild_numbers(state: Arrays, rig: Rig) -> Iterator[str]:
    for name, (kind, _) in SCHEMA.items():
        values, most = state[name], _LATEST if name == "stamps" else _LARGEST
        if kind == "<f8" and not ((np.abs(values) < most) | (np.isnan(values) & (name in _MAY_BE_NAN))).all():
            yield f"array {name} holds a value that is not finite or too large"
    for name in ("anchored", "poses", "keyframe_pose", "loop_pose", "correction_motions"):
        if not is_rigid(state[name]):
            yield f"array {name} holds a pose that is no rigid motion"
    offset, information = state["bias"]
    if not (abs(offset) < rig.width and abs(state["row_offset"]) <= rig.height):
        yield "an offset is larger than the image"
    if not _LARGEST**-2 < information < _FINEST**-2:
        yield "the offset has a spread that cannot be"


def _wrong_numbers_of_frames(state: Arrays, rig: Rig) -> Iterator[str]:
    count, keyframes, anchors = len(state["stamps"]), state["keyframe_index"], state["anchors"]
    if (np.diff(state["stamps"]) < 0).any():
        yield "stamps fall"
    if bool(count) != bool(len(keyframes)) or (np.diff(keyframes) <= 0).any():
        yield "keyframes are not in order"
    if not len(keyframes) <= state["added"] <= count:
        yield "more keyframes are there than were added"
    if len(keyframes) and not (keyframes[0] >= 0 and keyframes[-1] < count):
        yield "a keyframe is no frame"
    if not np.isin(anchors, keyframes).all() or (anchors > np.arange(count)).any():
        yield "a frame hangs on no keyframe"
    links = state["links"]
    if (links < 0).any() or (links[1:] >= np.arange(1, count)).any() or links[:1].any():
        yield "a frame was located against one that is not before it"
    wanted, lost, unsolved, asked, unplaced = state["counts"].tolist()
    if not (
        0 <= wanted <= rig.width * rig.height and min(lost, unsolved) >= 0 and 0 <= asked <= 3 and 0 <= unplaced <= lost
    ):
        yield "a count is negative or too large"
    if max(lost, unsolved, len(state["closures"])) > count:
        yield "more was lost or closed than there are frames"
    frame, earlier = state["closures"].T
    if (np.diff(frame) <= 0).any() or not ((earlier >= 0) & (earlier < frame) & (frame < count)).all():
        yield "a loop was closed at a frame that is none, or out of order"
    frame, earlier = state["loops"].T
    if (np.diff(frame) <= 0).any() or not ((earlier >= 0) & (earlier < frame) & (frame < count)).all():
        yield "a place was seen again at a frame that is none, or out of order"
    yield from _wrong_parts(state)


def _wrong_parts(state: Arrays) -> Iterator[str]:
    count, part, begun = len(state["stamps"]), state["keyframe_part"], state["begun"]
    if part.size and not (part[0] == 0 and part.min() == 0 and part.max() < count):
        yield "a keyframe is in a part of the map that cannot be"
    if (np.diff(begun) <= 0).any() or not ((begun > 0) & (begun <= count)).all():
        yield "a recording begins with a frame that is none, or out of order"
    frame, earlier, landmarks = state["joins"].T
    is_right = (np.diff(frame) > 0).all() and ((earlier >= 0) & (earlier < frame) & (frame < count)).all()
    if not (is_right and (landmarks > 0).all()):
        yield "parts of the map became one at a frame that is none, or out of order"
    frame, agree, other = state["doubted"].T
    is_right = (np.diff(frame) > 0).all() and ((frame > 0) & (frame < count)).all()
    if not (is_right and (np.minimum(agree, other) > 0).all()):
        yield "two motions were seen in a frame that is none, or out of order"


def _wrong_observations(state: Arrays, rig: Rig) -> Iterator[str]:
    observations, landmark, count = state["keyframe_observations"], state["landmark"], len(state["xyz"])
    if (observations < 0).any() or (observations > len(landmark)).any() or observations.sum() != len(landmark):
        yield "keyframes do not share the observations"
        return
    if landmark.size and not (landmark.min() >= 0 and landmark.max() < count):
        yield "a landmark is seen that is not there"
    frame = np.repeat(np.arange(len(observations)), observations)
    if len(np.unique(frame * count + landmark)) < len(landmark):
        yield "a landmark is seen twice in a keyframe"
    u, v = state["uv"].T
    if ((u < -1) | (u > rig.width) | (v < -1) | (v > rig.height)).any():
        yield "a landmark is seen outside the image"
    if not (state["sigma"] > _FINEST).all():
        yield "a disparity has no spread"


def _wrong_loop(state: Arrays) -> Iterator[str]:
    landmark, (u, v, _, sigma) = state["loop_landmark"], state["loop_seen"].T
    if not ((landmark >= 0) & (landmark < state["next_id"])).all():
        yield "a loop is closed by a landmark that never was"
    if len(np.unique(landmark)) < len(landmark) or not (len(state["keyframe_index"]) > 1 or not landmark.size):
        yield "a loop is closed by a landmark twice, or to no keyframe"
    if np.isnan(u).any() or np.isnan(v).any() or not (sigma > _FINEST).all():
        yield "a loop is closed by a landmark that is seen nowhere"
    if landmark.size and not state["counts"][_UNDER_WAY]:
        yield "a loop is left that nothing closes"
    if landmark.size and not (len(state["closures"]) and state["closures"][-1, 0] in state["keyframe_index"]):
        yield "a loop is closed by a frame that is no keyframe"
    if state["counts"][_UNDER_WAY] >= _CORRECTING and not landmark.size:
        yield "a loop is being closed that is none"
    yield from _wrong_correction(state)


def _wrong_correction(state: Arrays) -> Iterator[str]:
    """What a loop's closing would move."""
    keyframe, ids, holder = (state[f"correction_{name}"] for name in ("keyframe", "landmark_id", "holder"))
    if len(keyframe) and state["counts"][_UNDER_WAY] < _CORRECTING:
        yield "a loop moves keyframes that is not being closed"
    if (np.diff(keyframe) <= 0).any() or (np.diff(ids) <= 0).any() or (len(keyframe) and not len(ids)):
        yield "numbers of what a loop moves do not ascend"
    if ids.size and not (0 <= holder.min() <= holder.max() < len(keyframe)):
        yield "a loop moves a landmark with a keyframe that is none"
    own, rows = state["keyframe_index"], state["landmark_id"]
    if len(keyframe) and not (
        np.isin(own[own <= keyframe[-1]], keyframe).all() and np.isin(rows[rows <= ids[-1]], ids).all()
    ):
        yield "a loop does not move a keyframe or a landmark that is older"


def _wrong_ids(state: Arrays) -> Iterator[str]:
    ids = state["landmark_id"]
    if (np.diff(ids) <= 0).any() or (ids.size and not 0 <= ids[0] <= ids[-1] < state["next_id"]):
        yield "numbers of landmarks do not ascend, or go beyond the next one"
    if not 0 <= state["next_id"] < _LARGEST:
        yield "landmarks have numbers that no run comes to"
    gone, kept = state["merged"].T
    if not ((gone >= 0) & (gone < state["next_id"]) & (kept >= 0) & (kept < state["next_id"]) & (gone != kept)).all():
        yield "a landmark was merged that never was"
    if len(np.unique(gone)) < len(gone):
        yield "a landmark was merged twice"


def _broken_path(state: Arrays, rig: Rig) -> Iterator[str]:
    if not len(state["stamps"]):
        return
    keyframes, (pose, motion) = state["keyframe_index"], state["poses"]
    path = state["keyframe_pose"][np.searchsorted(keyframes, state["anchors"])] @ state["anchored"]
    if np.abs(path[-1] - pose).max() > _ROUNDING * (1 + np.abs(pose).max()):
        yield "the last pose is not that of the path"
    apart = np.linalg.norm(np.diff(path[:, :3, 3], axis=0), axis=1)
    apart[state["begun"][state["begun"] < len(path)] - 1] = 0  # anywhere
    steps = [*apart, np.linalg.norm(motion[:3, 3])]
    if max(steps) > _LONGEST_STEP * rig.fx * rig.baseline / _NEAREST_TOTAL:
        yield "a step is farther than the camera sees"


def _landmarks_elsewhere(state: Arrays, rig: Rig) -> Iterator[str]:
    """Keyframes half of whose landmarks, or their disparities, are far from where they were seen."""
    if not len(state["keyframe_pose"]):
        return
    ends = np.cumsum(state["keyframe_observations"])[:-1]
    columns = (np.split(state[name], ends) for name in ("landmark", "uv", "disparity"))
    for k, (T, landmark, uv, disparity) in enumerate(zip(state["keyframe_pose"], *columns, strict=True)):
        T_camera_world = inverse(T)
        points = state["xyz"][landmark] @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
        off = np.linalg.norm(project(rig, points) - uv, axis=1)
        with np.errstate(divide="ignore"):
            expected = rig.fx * rig.baseline / points[:, 2] - rig.doffs + state["bias"][0]
        wide = np.abs(disparity - expected)[~np.isnan(disparity)]
        if not (_are_within(off, _MAX_OFF * rig.width) and _are_within(wide, _MAX_WIDE * rig.width)):
            yield f"keyframe {k} does not see its landmarks where they are"


def _are_within(off: FloatArray, most: float) -> bool:
    """Whether at least half of the distances are at most that; NaN is not."""
    return bool((off <= most).sum() >= len(off) / 2)
