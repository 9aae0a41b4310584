"""Two cameras with lenses driven through a scene: raw pairs with truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..._threads import both
from ...types import Camera, FloatArray, Image, RawRig, Rig, StereoPair
from ...vision.calibration.lenses import unproject
from ...vision.se3 import inverse
from .._pairing import checked_index
from .._reader import Reader
from ._checks import instance, number
from .render import Renderer
from .shapes import Scene

_FARTHEST = 75.0  # degrees from the axis: what a lens sees beyond is black, as a plane shows it 15 times as large
_FINER = 1.5  # pixels of the plane to one of the lens, on the axis
_INNER = (np.arange(4) - 1.5) / 4  # px, both ways: 16 samples of the plane make a pixel of the lens
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


class RawSequence:
    """Pairs that two cameras with any lenses take along the path of a scene, and the truth behind them.

    Each lens looks at a picture of a pinhole camera that sees up to 75° from the axis; farther out, its image is black.

    Parameters
    ----------
    scene : Scene
        The world, and the path of the left camera as it is before rectification.
    cameras : RawRig
        The cameras.
    rate : float
        Frames a second.

    Attributes
    ----------
    rig : Rig
        The rectified cameras.
    cameras, scene
        As given.
    name : str
        The scene's.
    names : list of str
        What each pair is called.
    unpaired : list of str
        Nothing.
    stamps : (n,) float64
        Times, s.
    truth : (n, 4, 4) float64
        ``T_world_camera`` of the rectified left camera.

    Raises
    ------
    InputError
        If the cameras cannot be rectified, or the rate is not positive.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> T_right_left = ((1, 0, 0, -0.1), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    >>> lens = Camera(40, 40, 31.5, 23.5, 64, 48, (0.0, 0.0, 0.0, 0.0), lens="equidistant")
    >>> wall = synthetic.Scene((synthetic.plane(8, 6).at(0, 0, 4),))
    >>> sequence = RawSequence(wall, RawRig(lens, lens, T_right_left))
    >>> left, right = sequence.images(0)
    >>> left.shape, sequence[0].left.shape
    ((48, 64), (48, 64))
    """

    rig: Rig

    def __init__(self, scene: Scene, cameras: RawRig, *, rate: float = 10.0) -> None:
        self.scene = instance(Scene, scene, "sequence: scene")
        self.cameras = instance(RawRig, cameras, "sequence: cameras")
        self.stamps = np.arange(len(scene.path)) / number(rate, "sequence: rate", 1e-3, 1e6, "frames a second")
        self.name, self.unpaired = scene.name, list[str]()
        self.names = [f"{self.name}_{index:06d}" for index in range(len(self))]
        self._reader = Reader(cameras, self.images, self.names)
        self.rig = self._reader.rig
        assert self._reader.rectify is not None
        turned = np.eye(4)
        turned[:3, :3] = self._reader.rectify.R_left.T
        self.truth = scene.path @ turned

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[StereoPair]:
        """Render and rectify one pair after another."""
        return (self[place] for place in range(len(self)))

    def __getitem__(self, place: int) -> StereoPair:
        """Render and rectify a pair; IndexError past the end."""
        place = checked_index(place, len(self))
        return replace(self._reader.read(place), stamp=float(self.stamps[place]))

    def images(self, index: int) -> Iterator[Image]:
        """Render the left and the right image of a pair as the cameras take them.

        Parameters
        ----------
        index : int
            Number of the pair, from 0.

        Returns
        -------
        iterator of (H, W) uint8
            Left, then right.
        """
        pose = self.scene.path[checked_index(index, len(self))]
        poses = pose, pose @ inverse(self.cameras.matrix)
        stamp = float(self.stamps[index])
        return iter(both(lambda side: self._lenses[side].take(self._renderer, poses[side], stamp), (0, 1)))

    @cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self.scene)

    @cached_property
    def _lenses(self) -> tuple[_Lens, _Lens]:
        return _Lens(self.cameras.left), _Lens(self.cameras.right)


class _Lens:
    """A lens before a plane that a pinhole camera has drawn."""

    def __init__(self, camera: Camera) -> None:
        v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
        rays = [unproject(camera, np.column_stack([(u + a).ravel(), (v + b).ravel()])) for b in _INNER for a in _INNER]
        self._shape = u.shape
        self._plane, self._maps = _plane_and_maps(camera, rays)

    def take(self, renderer: Renderer, pose: FloatArray, stamp: float) -> NDArray[np.uint8]:
        """Draw the image at a pose."""
        import cv2

        drawn = renderer.image(self._plane, pose, stamp, self._plane.cx).astype(np.float32)
        total = np.zeros(self._shape)
        for u, v in self._maps:
            total += cv2.remap(drawn, u.reshape(self._shape), v.reshape(self._shape), cv2.INTER_LINEAR)
        return np.floor(np.clip(total / len(self._maps), 0, 1) * 255 + 0.5).astype(np.uint8)


def _plane_and_maps(camera: Camera, rays: list[FloatArray]) -> tuple[Rig, list[Maps]]:
    """The pinhole camera that sees all rays up to the farthest, and where it sees them; -10 where it does not."""
    f, least = _FINER * camera.fx, np.cos(np.radians(_FARTHEST))
    seen = [ray[:, 2] >= least for ray in rays]
    with np.errstate(divide="ignore", invalid="ignore"):
        places = [f * ray[:, :2] / ray[:, 2:] for ray in rays]
    inside = np.concatenate([place[ok] for place, ok in zip(places, seen, strict=True)])
    low = np.floor(inside.min(axis=0)) - 2
    width, height = (np.ceil(inside.max(axis=0)) + 3 - low).astype(int).tolist()
    plane = Rig(f, f, float(-low[0]), float(-low[1]), width=width, height=height)
    uv = [np.where(ok[:, None], place - low, -10).astype(np.float32) for place, ok in zip(places, seen, strict=True)]
    return plane, [(each[:, 0].copy(), each[:, 1].copy()) for each in uv]
