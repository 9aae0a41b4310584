"""The one map of a session or of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from .._checks import require, told
from .._files import PathLike, bad_input
from ..errors import InputError
from ..frame import Frame
from ..io import RunFolder, read_frame
from ..io.frames import read_frame_image, read_frame_valid, storable_image
from ..io.landmarks import read_landmarks
from ..mapping.build import make_map, map_of_frame
from ..mapping.settings import MappingSettings
from ..mapping.views import View, take_keyframes
from ..session import Session
from ..settings import Settings
from ..topological_map import TopologicalMap
from ..types import BoolArray, FloatArray, Image, Rig
from ..vision.slam.keyframes.keyframe import MapSnapshot
from .config import resolve


@dataclass(frozen=True, repr=False)
class Keyframes:
    """What a map is made of.

    Attributes
    ----------
    snapshot : MapSnapshot
        Landmarks; its keyframes go by any numbers.
    rig : Rig
        The cameras, with the offset of the disparities that the path found.
    index : dict of int to int
        Index of the frame of each keyframe that is there, by its number.
    image_of : callable, int -> image
        Left image of a keyframe.
    frame_of : callable, int -> Frame
        A keyframe.
    valid_of : callable, int -> (H, W) bool or None
        Pixels of that image that the cameras saw; None is all of them.
    """

    snapshot: MapSnapshot
    rig: Rig
    index: Mapping[int, int]
    image_of: Callable[[int], Image]
    frame_of: Callable[[int], Frame]
    valid_of: Callable[[int], BoolArray | None]


def build_map(source: Session | PathLike, mapping: MappingSettings | None = None) -> TopologicalMap:
    """Make one topological map of all keyframes: of a session so far, or of a finished run.

    Parameters
    ----------
    source : Session, str or path
        A session, which may go on afterwards, or a run folder.
    mapping : MappingSettings, optional
        How; as in the source's settings by default.

    Returns
    -------
    TopologicalMap
        Of a single keyframe, its own complex, signals and response.

    Raises
    ------
    InputError
        If the source is neither, has no keyframes or has not kept them, or a file of the run is missing or damaged.
    GeometryError
        If the landmarks of several keyframes span no surface.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> sequence = synthetic.SyntheticSequence(synthetic.corridor(2.0))
    >>> with Session(sequence.rig) as session:
    ...     for pair in sequence:
    ...         _ = session.process(pair)
    ...     made = build_map(session)
    >>> len(made) == len(made.landmark_id), bool((made.view_count.face > 1).any())
    (True, True)
    """
    if mapping is not None:
        require(mapping, MappingSettings, "mapping")
    if isinstance(source, Session):
        return join_keyframes(kept_keyframes(source), source.settings, mapping)
    if not isinstance(source, str | Path):
        raise InputError(f"source is {told(source)}, expected a Session or the path of a run folder")
    folder = RunFolder.open(source)
    settings = resolve(file=folder.path / "config.yaml").settings
    return join_keyframes(stored_keyframes(folder), settings, mapping)


def join_keyframes(given: Keyframes, settings: Settings, mapping: MappingSettings | None = None) -> TopologicalMap:
    """Make the map of keyframes.

    Parameters
    ----------
    given : Keyframes
        At least one.
    settings : Settings
        The filter, and how the map is made.
    mapping : MappingSettings, optional
        How the map is made, if otherwise.

    Returns
    -------
    TopologicalMap
    """
    snapshot = take_keyframes(given.snapshot, np.isin(given.snapshot.keyframe, list(given.index)))
    numbers, poses = snapshot.keyframe.tolist(), snapshot.T_world_camera
    mapping = mapping or settings.mapping
    if len(numbers) == 1:
        return map_of_frame(given.frame_of(numbers[0]), given.rig, poses[0], mapping.views)
    placed = zip(numbers, poses, strict=True)
    views = [
        View(given.index[number], T, partial(given.image_of, number), partial(given.valid_of, number))
        for number, T in placed
    ]
    return make_map(views, snapshot, given.rig, settings.filter, mapping)


def kept_keyframes(session: Session) -> Keyframes:
    """Find what a session has kept of its keyframes.

    Parameters
    ----------
    session : Session
        Which may go on.

    Returns
    -------
    Keyframes

    Raises
    ------
    InputError
        If it has kept none.
    """
    frames, snapshot, rig, path = session.capture()
    if not frames:
        raise InputError("session: has kept no keyframe, expected keep=True and a pair that was processed")
    if snapshot is None:
        if max(frames) >= len(path):
            raise InputError(f"odometry: its trajectory has {len(path)} poses, expected {max(frames) + 1} or more")
        snapshot = snapshot_of(frames, {number: path.T_world_camera[number] for number in frames})
    index = {number: frame.index for number, frame in frames.items()}
    if (np.diff(list(index.values())) <= 0).any():  # pairs without a number of their own
        index = {number: number for number in frames}
    return Keyframes(
        snapshot, rig, index, lambda number: _image(frames[number]), frames.__getitem__,
        lambda number: frames[number].valid,
    )  # fmt: skip


def _image(frame: Frame) -> Image:
    """The image, as a file of the frame would have it."""
    image = storable_image(frame)
    if image is None:
        raise InputError(f"{frame.name}: has no image, expected a keyframe with one")
    return image


def stored_keyframes(folder: RunFolder) -> Keyframes:
    """Find what a run folder has of its keyframes.

    Parameters
    ----------
    folder : RunFolder
        Of a run that is finished, or is about to be.

    Returns
    -------
    Keyframes
        Numbers are those of the frames.

    Raises
    ------
    InputError
        If it has no landmarks.
    """
    path = folder.landmarks_path
    if not path.exists():
        raise bad_input(path, "is not there", "that of a run of this version: tspslam run SOURCE --out NEW makes one")
    folder.check_unchanged(path)
    snapshot, rig = read_landmarks(path)
    stored = set(folder.stored_frames)
    return Keyframes(
        snapshot, rig, {number: number for number in snapshot.keyframe.tolist() if number in stored},
        lambda number: read_frame_image(folder.finished_frame(number)),
        lambda number: read_frame(folder.finished_frame(number)),
        lambda number: read_frame_valid(folder.finished_frame(number)),
    )  # fmt: skip


def snapshot_of(frames: Mapping[int, Frame], poses: Mapping[int, FloatArray]) -> MapSnapshot:
    """Make landmarks of all points of keyframes whose odometry has none.

    Parameters
    ----------
    frames : dict of int to Frame
        At least one, in order.
    poses : dict of int to (4, 4) float64
        Theirs, by the same numbers.

    Returns
    -------
    MapSnapshot
        Each point is seen by its own keyframe alone.
    """
    clouds = [frame.cloud for frame in frames.values()]
    T = np.array([poses[number] for number in frames])
    start = np.cumsum([0, *(len(cloud) for cloud in clouds)])
    ids = np.arange(start[-1])
    return MapSnapshot(
        landmark_id=ids,
        xyz=np.concatenate([cloud.xyz @ pose[:3, :3].T + pose[:3, 3] for cloud, pose in zip(clouds, T, strict=True)]),
        keyframe=np.array(list(frames), np.int64), T_world_camera=T, start=start, observed_id=ids,
        uv=np.concatenate([cloud.uv for cloud in clouds]),
        disparity=np.concatenate([cloud.disparity for cloud in clouds]), merged=np.empty((0, 2), np.int64),
    )  # fmt: skip
