"""What a map is made of: keyframes, keypoints that may become landmarks, and a copy of it all at one moment."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...._brief import Brief
from ....types import FloatArray
from ...features.binary import Descriptors
from ...images import Pyramid


@dataclass(frozen=True, repr=False)
class Keyframe(Brief):
    """A frame that the map rests on, and the landmarks that it sees.

    Attributes
    ----------
    index : int
        Number of the frame, from 0.
    T_world_camera : (4, 4) float64
        Its pose.
    image : Pyramid or None
        Its left image, while landmarks are looked for in it.
    landmark : (K,) int64
        Rows of the map's landmarks.
    uv : (K, 2) float64
        Where it sees them, px.
    disparity : (K,) float64
        As measured, px; NaN where not known.
    sigma : (K,) float64
        Standard deviations of the disparities, px; of those that are not known, what they would have.
    is_start : bool
        Whether the map began anew with it: its pose against the one before is a guess.
    part : int
        Which part of the map it is in: how two parts stand to one another is a guess. The first keyframe is in part 0.
    """

    index: int
    T_world_camera: FloatArray
    image: Pyramid | None
    landmark: NDArray[np.int64]
    uv: FloatArray
    disparity: FloatArray
    sigma: FloatArray
    is_start: bool = False
    part: int = 0

    def at(self, T_world_camera: FloatArray) -> Keyframe:
        """Make the same keyframe at another pose; for thousands at once, a quarter of the time of `replace`.

        Parameters
        ----------
        T_world_camera : (4, 4) float64
            Its pose.

        Returns
        -------
        Keyframe
        """
        sights = self.landmark, self.uv, self.disparity, self.sigma
        return Keyframe(self.index, T_world_camera, self.image, *sights, self.is_start, self.part)


@dataclass(frozen=True)
class Keypoints:
    """Keypoints that may become landmarks.

    Attributes
    ----------
    uv : (N, 2) float64
        px.
    disparity : (N,) float64
        As measured, px; NaN where not known.
    descriptors : (N, P) uint64
        Binary descriptors.
    """

    uv: FloatArray
    disparity: FloatArray
    descriptors: Descriptors


@dataclass(frozen=True, repr=False)
class MapSnapshot(Brief):
    """The map at one moment, apart from what it becomes; frames and landmarks go by numbers that stay.

    Attributes
    ----------
    landmark_id : (M,) int64
        Numbers of the landmarks, ascending; a number is never given twice.
    xyz : (M, 3) float64
        Where they are, m.
    keyframe : (K,) int64
        Numbers of the frames that are keyframes, ascending.
    T_world_camera : (K, 4, 4) float64
        Their poses.
    start : (K + 1,) int64
        Observations of keyframe k are rows ``start[k]`` to ``start[k + 1]`` of what follows.
    observed_id : (O,) int64
        Which landmark.
    uv : (O, 2) float64
        Where, px.
    disparity : (O,) float64
        As measured, px; NaN where not known.
    merged : (R, 2) int64
        Pairs (merged, kept) of landmark numbers, in the order of their merging.
    """

    landmark_id: NDArray[np.int64]
    xyz: FloatArray
    keyframe: NDArray[np.int64]
    T_world_camera: FloatArray
    start: NDArray[np.int64]
    observed_id: NDArray[np.int64]
    uv: FloatArray
    disparity: FloatArray
    merged: NDArray[np.int64]
