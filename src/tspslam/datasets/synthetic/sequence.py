"""A stereo camera driven through a scene, with the faults of a real one."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...types import FloatArray, Rig, StereoPair
from .render import Geometry, Renderer
from .shapes import Scene, finite, pose_at
from .texture import check_seed

PAPER_RIG = Rig(fx=387.77, fy=387.77, cx=257.446, cy=197.718, baseline=0.24, width=512, height=384)
"""The camera of the paper's data."""


@dataclass(frozen=True)
class Faults:
    """What keeps a real camera from being perfect.

    Attributes
    ----------
    noise : float
        Standard deviation of white noise, luminance.
    blur : float
        Standard deviation of a Gaussian blur, px.
    exposure : float or (T,) floats
        Gain of both images, stops: of each frame, or the standard deviation of a random one.
    dropped : tuple of int
        Frames that were lost; the others keep their index and stamp.
    right_turn : (3,) floats
        Rotation vector by which the right camera is turned against what the rig says, rad.
    right_shift : (2,) floats
        How far the right image is shifted against what the rig says, px right and down.
    eight_bit : bool
        Whether images are uint8; float32 otherwise.

    Raises
    ------
    InputError
        If a value is out of its range: noise up to 1, blur up to 50 px, exposure up to 10 stops.

    Examples
    --------
    >>> Faults(noise=0.01).blur
    0.0
    """

    noise: float = 0.0
    blur: float = 0.0
    exposure: float | tuple[float, ...] = 0.0
    dropped: tuple[int, ...] = ()
    right_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    right_shift: tuple[float, float] = (0.0, 0.0)
    eight_bit: bool = True

    def __post_init__(self) -> None:
        stops = finite(np.atleast_1d(self.exposure), "faults: exposure", (None,))
        if not (0 <= self.noise <= 1 and 0 <= self.blur <= 50 and (np.abs(stops) <= 10).all()):
            raise InputError(
                f"faults: noise, blur, exposure are {self.noise}, {self.blur}, {self.exposure}, "
                "expected 0 to 1, 0 to 50 px and at most 10 stops"
            )
        finite(self.right_turn, "faults: right_turn", (3,))
        finite(self.right_shift, "faults: right_shift", (2,))


class SyntheticSequence:
    """Pairs that a stereo camera takes along the path of a scene, and the truth behind them.

    Parameters
    ----------
    scene : Scene
        The world and the path.
    rig : Rig, optional
        The cameras; the paper's by default.
    faults : Faults, optional
        None by default.
    seed : int
        Of noise and random exposure; frames do not depend on the order in which they are asked for.
    rate : float
        Frames a second.

    Attributes
    ----------
    rig : Rig
        What the camera is said to be; `faults` may turn and shift the right one.
    scene : Scene
        The world.
    indices : (n,) int64
        Places on the path of the frames that were not dropped.
    stamps : (n,) float64
        Their times, s.
    truth : (n, 4, 4) float64
        ``T_world_camera`` of the left camera.
    name : str
        The scene's.

    Raises
    ------
    InputError
        If every frame is dropped, a dropped one is not on the path, exposure has another length than the path, or the
        rate is not positive.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> wall = synthetic.Scene((synthetic.plane(8, 6).at(0, 0, 4),))
    >>> sequence = SyntheticSequence(wall)
    >>> sequence[0].left.shape, float(sequence.geometry(0).depth.max().round(9))
    ((384, 512), 4.0)
    """

    rig: Rig
    scene: Scene
    indices: NDArray[np.int64]
    stamps: FloatArray
    truth: FloatArray

    def __init__(
        self, scene: Scene, rig: Rig = PAPER_RIG, faults: Faults | None = None, *, seed: int = 0, rate: float = 10.0
    ) -> None:
        self.scene, self.rig, self.faults, self._seed = scene, rig, faults or Faults(), seed
        check_seed(seed, "sequence")
        if not 1e-3 <= rate <= 1e6:
            raise InputError(f"sequence: rate is {rate}, expected frames a second, 1e-3 to 1e6")
        count = len(scene.path)
        dropped = set(self.faults.dropped)
        if not dropped <= set(range(count)) or len(dropped) == count:
            raise InputError(f"sequence: dropped frames {sorted(dropped)[:3]} ..., expected some of 0 to {count - 1}")
        stops = np.atleast_1d(self.faults.exposure)
        if np.ndim(self.faults.exposure) and len(stops) != count:
            raise InputError(f"sequence: exposure has {len(stops)} values, expected one for each of {count} frames")
        self.indices = np.array([k for k in range(count) if k not in dropped], np.int64)
        self.stamps = self.indices / rate
        self.truth = np.asarray(scene.path, np.float64)[self.indices]

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.scene.name

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, place: int) -> StereoPair:
        """Render pair `place` of those that were not dropped; IndexError past the end."""
        place = range(len(self))[place]
        index = int(self.indices[place])
        with ThreadPoolExecutor(2) as pool:
            left, right = pool.map(lambda side: self._take(place, side), (0, 1))
        return StereoPair(left, right, self.rig, float(self.stamps[place]), index, f"{self.name}_{index:06d}")

    def __iter__(self) -> Iterator[StereoPair]:
        """Render one pair after another."""
        return (self[place] for place in range(len(self)))

    def geometry(self, place: int) -> Geometry:
        """Tell the truth behind each pixel of the left image of pair `place`: depth, normal, label, disparity."""
        place = range(len(self))[place]
        return self._renderer.geometry(self.rig, self.truth[place], float(self.stamps[place]))

    @cached_property
    def _renderer(self) -> Renderer:
        return Renderer(self.scene)

    def _take(self, place: int, side: int) -> NDArray[Any]:
        """One image of a pair, with its faults; 0 is left."""
        rig, pose, cx = self.rig, self.truth[place], self.rig.cx
        if side == 1:
            shift = self.faults.right_shift
            cx += rig.doffs + shift[0]
            rig = replace(rig, cy=rig.cy + shift[1])
            pose = pose @ pose_at((rig.baseline, 0, 0), self.faults.right_turn)
        clean = self._renderer.image(rig, pose, float(self.stamps[place]), cx)
        return self._spoil(clean, int(self.indices[place]), side)

    def _spoil(self, image: FloatArray, index: int, side: int) -> NDArray[Any]:
        """Blur, expose, add noise, and round."""
        faults = self.faults
        if faults.blur:
            from scipy.ndimage import gaussian_filter

            image = gaussian_filter(image, faults.blur, mode="nearest")
        image = image * 2.0 ** self._stops(index)
        if faults.noise:
            image += np.random.default_rng((self._seed, index, side)).normal(0, faults.noise, image.shape)
        image = np.clip(image, 0, 1)
        return np.floor(image * 255 + 0.5).astype(np.uint8) if faults.eight_bit else image.astype(np.float32)

    def _stops(self, index: int) -> float:
        exposure = self.faults.exposure
        if np.ndim(exposure):
            return float(np.asarray(exposure)[index])
        return float(np.random.default_rng((self._seed, index, 2)).normal(0, exposure)) if exposure else 0.0
