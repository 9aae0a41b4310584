"""A stereo camera driven through a scene, with the faults of a real one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._threads import both
from ...errors import InputError
from ...types import FloatArray, Rig, StereoPair, real_array
from ...vision.rig import LARGEST_AREA, LARGEST_SIDE
from .._pairing import checked_index
from ._checks import finite, instance, keep, number, refused, whole
from .render import Geometry, Renderer
from .shapes import Scene, pose_at

_MAX_STOPS = 10.0

PAPER_RIG = Rig(fx=387.77, fy=387.77, cx=257.446, cy=197.718, baseline=0.24, width=512, height=384)
"""The camera of the paper's data."""


@dataclass(frozen=True)
class Faults:
    """How a real camera departs from a perfect one.

    Attributes
    ----------
    noise : float
        Standard deviation of white noise, luminance.
    blur : float
        Standard deviation of a Gaussian blur, px.
    exposure : float or (T,) floats
        Gain of both images, stops: the standard deviation of a random one, not negative, or the gain of each frame.
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
        keep(
            self,
            noise=number(self.noise, "faults: noise", 0, 1),
            blur=number(self.blur, "faults: blur", 0, 50, "px"),
            exposure=_exposure(self.exposure),
            dropped=_dropped(self.dropped),
            right_turn=tuple(finite(self.right_turn, "faults: right_turn", (3,)).tolist()),
            right_shift=tuple(finite(self.right_shift, "faults: right_shift", (2,)).tolist()),
            eight_bit=instance(bool, self.eight_bit, "faults: eight_bit"),
        )


def _exposure(values: Any) -> float | tuple[float, ...]:
    if np.ndim(real_array(values, "faults: exposure", "a number, or one of each frame")) == 0:
        return number(values, "faults: exposure", 0, _MAX_STOPS, "stops")
    return tuple(finite(values, "faults: exposure", (None,), _MAX_STOPS).tolist())


def _dropped(values: Any) -> tuple[int, ...]:
    numbers = real_array(values, "faults: dropped", "(n,) frames")
    if numbers.ndim != 1 or (numbers.size and numbers.dtype.kind not in "iu"):
        raise refused("faults: dropped", values, "a tuple of numbers of frames")
    return tuple(int(each) for each in numbers)


def _drawable(rig: Any) -> Rig:
    """Return a rig whose images are not too large."""
    width, height = instance(Rig, rig, "sequence: rig").width, rig.height
    if max(width, height) > LARGEST_SIDE or width * height > LARGEST_AREA:
        wanted = f"at most {LARGEST_SIDE} a side and {LARGEST_AREA} in all"
        raise InputError(f"sequence: the rig is for {width} x {height} px, expected {wanted}")
    return rig


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
        If every frame is dropped, a dropped one is not on the path, exposure has another length than the path, the
        rate is not positive, or the rig's images are larger than 64 megapixels.

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
        self.scene, self.rig = instance(Scene, scene, "sequence: scene"), _drawable(rig)
        self.faults = Faults() if faults is None else instance(Faults, faults, "sequence: faults")
        self._seed = whole(seed, "sequence: seed", 0)
        count = len(scene.path)
        dropped = set(self.faults.dropped)
        if not dropped <= set(range(count)) or len(dropped) == count:
            raise InputError(f"sequence: dropped frames {sorted(dropped)[:3]} ..., expected some of 0 to {count - 1}")
        stops = self.faults.exposure
        if isinstance(stops, tuple) and len(stops) != count:
            raise InputError(f"sequence: exposure has {len(stops)} values, expected one for each of {count} frames")
        self.indices = np.array([k for k in range(count) if k not in dropped], np.int64)
        self.stamps = self.indices / number(rate, "sequence: rate", 1e-3, 1e6, "frames a second")
        self.truth = scene.path[self.indices]

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.scene.name

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self.indices)

    def __getitem__(self, place: int) -> StereoPair:
        """Render pair `place` of those that were not dropped; IndexError past the end."""
        place = checked_index(place, len(self))
        index = int(self.indices[place])
        left, right = both(lambda side: self._take(place, side), (0, 1))
        return StereoPair(left, right, self.rig, float(self.stamps[place]), index, f"{self.name}_{index:06d}")

    def __iter__(self) -> Iterator[StereoPair]:
        """Render one pair after another."""
        return (self[place] for place in range(len(self)))

    def geometry(self, place: int) -> Geometry:
        """Tell the truth behind each pixel of the left image of pair `place`: depth, normal, label, disparity.

        Parameters
        ----------
        place : int
            Number of the pair, from 0.

        Returns
        -------
        Geometry
        """
        place = checked_index(place, len(self))
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
        if isinstance(exposure, tuple):
            return exposure[index]
        return float(np.random.default_rng((self._seed, index, 2)).normal(0, exposure)) if exposure else 0.0
