"""Where a frame was taken: near a motion that goes on, or, where nothing says how the camera moved, by descriptors first."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...types import Features, FloatArray
from ..features.binary import Descriptors, binary_descriptors, match_descriptors
from ..features.detecting import detect_usable
from ..images import PreparedImage
from ..rig import project
from .keyframes.keyframe import Keyframe
from .keyframes.map import Map
from .places.loop_closing import PlaceRecognition
from .pose import PoseEstimate, solve_pnp_of_each
from .tracking import TrackingSettings, choose_pose, choose_widest, is_clear, track_pose
from .uncertainty import Sources, pose_covariance

_HELD = 0.5  # share of the landmarks from which the last keyframe is the one that a pose is held by
_MOTIONS = 2  # that descriptors may show: the world's, and that of something large before the camera


@dataclass(frozen=True)
class Locator:
    """Finds the pose of a frame in a map.

    Attributes
    ----------
    map_ : Map
        Keyframes and landmarks.
    places : PlaceRecognition
        Finds places seen before.
    settings : TrackingSettings
        How landmarks are tracked, and when a pose is believed.
    detect : callable
        Grey image -> `Features`.
    """

    map_: Map
    places: PlaceRecognition
    settings: TrackingSettings
    detect: Callable[[NDArray[np.uint8]], Features]

    def follow(self, image: PreparedImage, predicted: FloatArray) -> PoseEstimate | None:
        """Find a pose near the one that a steady motion leads to; by descriptors where that is not clear.

        Parameters
        ----------
        image : PreparedImage
            The left image.
        predicted : (4, 4) float64
            Where the motion leads.

        Returns
        -------
        PoseEstimate or None
            Without disparities; None if no pose is believed.
        """
        tracked = self._track(image, predicted)
        if tracked is not None and is_clear(tracked, self.map_.xyz, predicted, self.settings):
            return tracked
        relocalized = self.places.relocalize(image.pyramid, *self._describe(image))
        return choose_pose(tracked, relocalized, self.map_.xyz, self.settings)

    def find(self, image: PreparedImage, guess: FloatArray) -> PoseEstimate | None:
        """Find a pose wherever it is: by descriptors of the last keyframes, then near a guess, then in the whole map.

        Each is tried by patches; the next one where the poses so far are not clear. A second motion that descriptors
        show is always tried: the first may be that of something large that moves.

        Parameters
        ----------
        image : PreparedImage
            The left image.
        guess : (4, 4) float64
            A pose that the camera may have.

        Returns
        -------
        PoseEstimate or None
            Without disparities; None if no pose is believed.
        """
        found: list[PoseEstimate] = []
        described = self._describe(image)
        for estimates in self._attempts(image, guess, described):
            found += estimates
            best = choose_widest(self.map_.rig, found, self.map_.xyz, self.settings)
            if best is not None and best.share >= self.settings.clear_share:
                return best
        return choose_widest(self.map_.rig, found, self.map_.xyz, self.settings)

    def _attempts(
        self, image: PreparedImage, guess: FloatArray, described: tuple[FloatArray, Descriptors]
    ) -> Iterator[list[PoseEstimate]]:
        """Poses found in one way after another."""
        near = [self._track(image, T) for T in self._recognised(*described)]
        yield [one for one in near if one is not None]
        tracked = self._track(image, guess)
        yield [] if tracked is None else [tracked]
        relocalized = self.places.relocalize(image.pyramid, *described)
        yield [] if relocalized is None else [relocalized]

    def _describe(self, image: PreparedImage) -> tuple[FloatArray, Descriptors]:
        features = detect_usable(image, self.detect)
        return features.uv, binary_descriptors(features.descriptor)

    def _track(self, image: PreparedImage, T: FloatArray) -> PoseEstimate | None:
        map_ = self.map_
        return track_pose(map_.rig, image.pyramid, map_.references(), map_.xyz, T, self.settings)

    def _recognised(self, uv: FloatArray, descriptors: Descriptors) -> list[FloatArray]:
        """Poses from descriptors of the landmarks that are tracked."""
        map_, loops = self.map_, self.places.loops
        rows = np.concatenate([reference.landmark for reference in map_.references()])
        keypoint, known = match_descriptors(
            descriptors, map_.descriptors[rows], max_hamming=loops.max_hamming, ratio=loops.ratio
        )
        return solve_pnp_of_each(
            map_.rig, map_.xyz[rows[known]], uv[keypoint],
            max_error=loops.pnp_error, min_matches=self.settings.min_matches, most=_MOTIONS,
        )  # fmt: skip


def covariance_against_keyframe(
    map_: Map, estimate: PoseEstimate, sigma_uv: float, sigma_disparity: FloatArray, offset_std: float
) -> tuple[int, FloatArray]:
    """Find the covariance of a pose against the keyframe that measured its landmarks (`pose_covariance`).

    Parameters
    ----------
    map_ : Map
        Keyframes and landmarks.
    estimate : PoseEstimate
        The pose, refined by disparities.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    sigma_disparity : (K,) float64
        Standard deviations of disparities, px.
    offset_std : float
        Standard deviation of the offset that all disparities have in common, px.

    Returns
    -------
    (int, (6, 6) float64)
        Number of that keyframe's frame: the last one, unless it saw less than half; and the covariance.
    """
    recent = map_.keyframes[-map_.window :]
    is_seen = np.array([np.isin(estimate.landmark, frame.landmark) for frame in recent])
    holder = recent[-1]
    if is_seen[-1].mean() < _HELD:
        holder = max(map_.keyframes, key=lambda frame: int(np.isin(estimate.landmark, frame.landmark).sum()))
    views, pull = np.maximum(is_seen.sum(axis=0), 1), _pull(map_, holder, estimate.landmark)
    sources = Sources(holder.T_world_camera, pull, views, sigma_uv, sigma_disparity, offset_std)
    return holder.index, pose_covariance(map_.rig, estimate, map_.xyz, sources)


def _pull(map_: Map, frame: Keyframe, landmark: NDArray[np.int64]) -> FloatArray:
    """How far from where its pose has them a keyframe saw landmarks, (K, 3) px; 0 where it did not."""
    pull, (_, rows, own) = np.zeros((len(landmark), 3)), np.intersect1d(landmark, frame.landmark, return_indices=True)
    rig, T = map_.rig, frame.T_world_camera
    camera = (map_.xyz[landmark[rows]] - T[:3, 3]) @ T[:3, :3]
    expected = np.column_stack([project(rig, camera), rig.fx * rig.baseline / camera[:, 2] - rig.doffs])
    pull[rows] = np.nan_to_num(np.column_stack([frame.uv[own], frame.disparity[own]]) - expected)
    return pull
