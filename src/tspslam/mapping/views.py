"""Keyframes as the map looks at them: where they stood, their image, their keypoints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief, brief
from ..types import BoolArray, FloatArray, Image, Rig
from ..vision.se3 import inverse
from ..vision.slam.keyframes.keyframe import MapSnapshot

Rows = NDArray[np.int64]


@dataclass(frozen=True, repr=False)
class View(Brief):
    """One keyframe.

    Attributes
    ----------
    number : int
        Of the frame.
    T_world_camera : (4, 4) float64
        Its pose, as all that was seen since has refined it.
    given : (H, W) or (H, W, 3) array, or callable that gives one
        The left image; a function is called each time, so that not all images are in memory at once.
    seen : callable that gives an (H, W) bool array or None, optional
        Which of its pixels the cameras saw; None is all of them.
    """

    number: int
    T_world_camera: FloatArray
    given: Image | Callable[[], Image]
    seen: Callable[[], BoolArray | None] | None = None

    @property
    def image(self) -> Image:
        """The left image."""
        return self.given() if callable(self.given) else self.given

    @property
    def valid(self) -> BoolArray | None:
        """Pixels that the cameras saw, (H, W); None is all of them."""
        return None if self.seen is None else self.seen()


class Sightings(NamedTuple):
    """Landmarks as keyframes see them, one row each.

    Attributes
    ----------
    landmark, keyframe : (O,) int64
        Rows of the landmarks, and of the keyframes.
    uv : (O, 2) float64
        Where, px.
    disparity : (O,) float64
        px; NaN where not known.
    """

    landmark: Rows
    keyframe: Rows
    uv: FloatArray
    disparity: FloatArray

    def __repr__(self) -> str:
        return brief(self)

    def take(self, rows: Rows | BoolArray | slice) -> Sightings:
        """Return some of the rows.

        Parameters
        ----------
        rows : (P,) int64, (O,) bool or slice
            Which.

        Returns
        -------
        Sightings
        """
        columns: tuple[Any, ...] = self
        return Sightings(*(column[rows] for column in columns))

    def split(self, count: int) -> list[Sightings]:
        """Return the rows of each keyframe; they must stand in the order of keyframes.

        Parameters
        ----------
        count : int
            How many keyframes there are.

        Returns
        -------
        list of Sightings
        """
        ends = np.searchsorted(self.keyframe, np.arange(count + 1))
        return [self.take(slice(a, b)) for a, b in pairwise(ends)]


NOTHING = Sightings(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 2)), np.empty(0))


def join_sightings(parts: Sequence[Sightings]) -> Sightings:
    """Put sightings one after another.

    Parameters
    ----------
    parts : sequence of Sightings
        There may be none.

    Returns
    -------
    Sightings
    """
    return Sightings(*(np.concatenate(columns) for columns in zip(NOTHING, *parts, strict=True)))


def take_keyframes(snapshot: MapSnapshot, rows: Rows | BoolArray) -> MapSnapshot:
    """Return a snapshot with some of its keyframes, in the order asked for, and what these see.

    Parameters
    ----------
    snapshot : MapSnapshot
        K keyframes.
    rows : (L,) int64 or (K,) bool
        Which of them.

    Returns
    -------
    MapSnapshot
    """
    chosen = np.arange(len(snapshot.keyframe))[rows]
    seen = np.concatenate([np.empty(0, np.int64), *(np.arange(*snapshot.start[k : k + 2]) for k in chosen)])
    return replace(
        snapshot, keyframe=snapshot.keyframe[chosen], T_world_camera=snapshot.T_world_camera[chosen],
        start=np.cumsum([0, *np.diff(snapshot.start)[chosen]]), observed_id=snapshot.observed_id[seen],
        uv=snapshot.uv[seen], disparity=snapshot.disparity[seen],
    )  # fmt: skip


def to_camera(xyz: FloatArray, T_world_camera: FloatArray) -> FloatArray:
    """Move points of the world into a camera's frame.

    Parameters
    ----------
    xyz : (N, 3) float64
        Points, m.
    T_world_camera : (4, 4) float64
        The camera's pose.

    Returns
    -------
    (N, 3) float64
    """
    T = inverse(T_world_camera)
    points: FloatArray = xyz @ T[:3, :3].T + T[:3, 3]
    return points


def calibration_matrix(rig: Rig, step: int = 1) -> FloatArray:
    """Matrix K of eq. (2) for an image of which every `step`-th pixel is looked at.

    Parameters
    ----------
    rig : Rig
        The cameras.
    step : int
        1 is every pixel.

    Returns
    -------
    (3, 3) float64
        ``K X`` is (u z, v z, z).
    """
    K = np.array([[rig.fx, rig.skew, rig.cx], [0, rig.fy, rig.cy], [0, 0, 1]])
    K[:2] /= step
    return K
