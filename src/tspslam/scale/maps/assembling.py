"""The states of finished runs become that of one run: joined where places are shared, bent to agree, fused."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..._atomic import write_bytes
from ...run._checkpoint import write_checkpoint
from ...run.continuing import restore_odometry
from ...run.record import FrameRecord
from ...run.sequence import MADE_BY
from ...types import FloatArray
from ...vision.slam.back_end.map_joining import JoinedParts, join_maps
from ...vision.slam.locating.locator import covariance_against_keyframe
from ...vision.slam.locating.path_covariance import Links
from ...vision.slam.odometry import StereoOdometry
from ...vision.slam.places.shared_places import SharedPlaces
from ...vision.slam.pose import PoseEstimate
from ...vision.slam.tracking import refine_pose
from .joined_runs import JoinedRuns
from .states import concatenate_states, joined_reader, read_step


def assemble(
    joined: JoinedRuns,
    states: Sequence[Path],
    shared: Sequence[tuple[int, int, SharedPlaces]],
    target: Path,
    said: Path,
) -> None:
    """Write the checkpoint of a run of all recordings, which is still to be adjusted, and remarks on it.

    Parameters
    ----------
    joined : JoinedRuns
        The runs.
    states : sequence of Path
        Their checkpoints at the end of their paths.
    shared : sequence of (int, int, SharedPlaces)
        Keyframes of the second run as the first one has them.
    target : Path
        The checkpoint.
    said : Path
        A line each for the pairs of runs whose places were not believed.
    """
    read = [read_step(path) for path in states]
    rows = [row for r, (own, _) in enumerate(read) for row in joined.rows(r, own)]
    state = concatenate_states(joined, [state for _, state in read])
    state["stamps"] = np.array([row.stamp for row in rows if isinstance(row, FrameRecord)])
    odometry = restore_odometry(joined.rig, joined.runs[0].settings, state, joined_reader(joined, rows))
    try:
        found = _join(odometry, SharedPlaces.joined([_numbered(joined, i, j, one) for i, j, one in shared]))
        write_bytes(said, "".join(_refusals(joined, found.refused)).encode())
        write_checkpoint(target, MADE_BY, rows, odometry.state())
    finally:
        odometry.close()


def adjust(joined: JoinedRuns, before: Path, target: Path) -> None:
    """Write the checkpoint of a run of all recordings, adjusted.

    Parameters
    ----------
    joined : JoinedRuns
        The runs.
    before, target : Path
        What `assemble` wrote, and the checkpoint.
    """
    rows, state = read_step(before)
    odometry = restore_odometry(joined.rig, joined.runs[0].settings, state, joined_reader(joined, rows))
    try:
        odometry.adjust()
        write_checkpoint(target, MADE_BY, rows, odometry.state())
    finally:
        odometry.close()


def _numbered(joined: JoinedRuns, i: int, j: int, shared: SharedPlaces) -> SharedPlaces:
    """Shared places of runs i and j by the numbers of all."""
    return shared.moved(joined.first_tracked[j], joined.first_tracked[i], joined.first_id[i])


def _refusals(joined: JoinedRuns, refused: SharedPlaces) -> Iterator[str]:
    """Lines on places that two runs seem to share."""
    ends = zip(refused.keyframe.tolist(), refused.place.tolist(), strict=True)
    pairs = Counter(tuple(bisect_right(joined.first_tracked, frame) - 1 for frame in pair) for pair in ends)
    for (own, other), count in pairs.items():
        name, seen = (joined.names[joined.first[r]] for r in (own, other))
        yield (
            f"{name}: {count} of its keyframes look like places of {seen} that are not where other places have them: "
            "not believed\n"
        )


def _join(odometry: StereoOdometry, shared: SharedPlaces) -> JoinedParts:
    """Join the parts of the map; the path goes with its keyframes, and what joined them is noted."""
    map_, path, before = odometry.map, odometry.path, list(odometry.map.keyframes)
    found = join_maps(map_, shared, odometry.tracking.pose.sigma_uv, odometry.tracking.loops)
    path.follow(before, map_)
    path.pose = path.trajectory(map_).T_world_camera[-1]
    _note(odometry, found)
    return found


def _note(odometry: StereoOdometry, found: JoinedParts) -> None:
    """Note joins, loops, and how well frames are known by them; of several at a frame, the first."""
    mapper, shared = odometry.mapper, found.shared
    ends = zip(shared.keyframe.tolist(), shared.place.tolist(), shared.counts.tolist(), found.is_join, strict=True)
    joins, loops = {frame: (frame, at, n) for frame, at, n in mapper.joins}, dict(mapper.closures)
    for frame, place, count, is_join in ends:
        if is_join:
            joins.setdefault(frame, (frame, place, count))
        else:
            loops.setdefault(frame, place)
    mapper.joins = [joins[frame] for frame in sorted(joins)]
    mapper.closures = sorted(loops.items())
    mapper.loops = _links(odometry, found)


def _links(odometry: StereoOdometry, found: JoinedParts) -> Links:
    """How well frames are known against keyframes of places that they see again."""
    mapper, shared = odometry.mapper, found.shared
    known = {frame: row for row, frame in enumerate(mapper.loops.frame.tolist())}
    links = {frame: (int(mapper.loops.against[row]), mapper.loops.covariance[row]) for frame, row in known.items()}
    for frame, place in zip(shared.keyframe.tolist(), shared.place.tolist(), strict=True):
        link = None if frame in links else _link(odometry, frame, place)
        if link is not None:
            links[frame] = link
    frames = sorted(links)
    covariance = np.array([links[frame][1] for frame in frames]).reshape(-1, 6, 6)
    return Links(np.array(frames, np.int64), np.array([links[frame][0] for frame in frames], np.int64), covariance)


def _link(odometry: StereoOdometry, frame: int, place: int) -> tuple[int, FloatArray] | None:
    """How well a keyframe is known against another by what both see; None where that is too little."""
    map_, tracking = odometry.map, odometry.tracking.pose
    numbers = [keyframe.index for keyframe in map_.keyframes]
    seen, other = map_.keyframes[numbers.index(frame)], numbers.index(place)
    both = np.isin(seen.landmark, map_.keyframes[other].landmark)
    rows, sigma, unknown = seen.landmark[both], seen.sigma[both], np.full((6, 6), np.inf)
    estimate = PoseEstimate(seen.T_world_camera, rows, seen.uv[both], seen.disparity[both], unknown)
    found = refine_pose(map_.rig, estimate, map_.xyz, estimate.disparity, sigma, tracking)
    if not np.isfinite(found.covariance).all():
        return None
    order = np.argsort(rows)
    kept = sigma[order[np.searchsorted(rows[order], found.landmark)]]
    return covariance_against_keyframe(map_, found, tracking.sigma_uv, kept, odometry.mapper.bias.std, other)
