"""Pairs from a colour image and depths: undistorted, registered, without pixels that fly, each with its spread."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from .._files import one_line
from ..errors import InputError
from ..types import BoolArray, Camera, FloatArray, Image, RawRig, Rig, StereoPair
from ..vision.depth.registration import opencv_lens, register_depth
from ..vision.depth.sensor import DepthSensor, disparity_sigma, flying_pixels, virtual_rig
from ..vision.rig import check_pair
from ..vision.se3 import inverse
from ..vision.stereo.dense import checked_unit, known_values, sample_map
from ._levels import Levels

_LOOKED_AT = 9  # maps that tell whether depths make sense, evenly spread
_BEYOND = 3.0  # times the sensor's range in which the median depth must lie
_WIDE = 3.0  # times the sensor's spread, of neighbours' scatter, from which something is said
_FEW_KNOWN, _MANY_FLY = 0.2, 0.2  # shares of the pixels, of which something is said
_MANY_OUTSIDE = 0.25  # of the depths, outside of the sensor's range, of which something is said
_MANY_APART = 0.25  # of the interval between images, of which something is said


@dataclass(frozen=True, repr=False)
class DepthCameras(Brief):
    """The cameras of colour and depth.

    Attributes
    ----------
    colour : Camera
        What took the images.
    depth : Camera or None
        What took the depths; None where they are of the colour camera's pixels.
    T_colour_depth : (4, 4) float64 or None
        Maps points of the depth camera's frame to the colour camera's, m.
    origin : str
        Where they come from.
    """

    colour: Camera
    depth: Camera | None = None
    T_colour_depth: FloatArray | None = None
    origin: str = ""


def depth_cameras(cameras: Rig | RawRig, origin: str) -> DepthCameras:
    """Take a calibration for that of colour and depth: one camera, or colour as the left and depth as the right one."""
    if isinstance(cameras, RawRig):
        return DepthCameras(cameras.left, cameras.right, inverse(cameras.matrix), origin)
    shape = {name: getattr(cameras, name) for name in ("fx", "fy", "cx", "cy", "width", "height", "skew")}
    return DepthCameras(Camera(**shape), origin=origin)


class DepthReader:
    """Pairs of one virtual rig from colour images and depth maps.

    Parameters
    ----------
    cameras : DepthCameras
        Theirs.
    sensor : DepthSensor
        How the depths scatter.
    unit : float or None
        Metres in one step; whole numbers need it.
    colour, depth : callable
        Image and map by index, as they are stored.
    names : sequence of str
        What to call each pair.
    bits : int or None
        Of 16-bit images.
    """

    def __init__(
        self, cameras: DepthCameras, sensor: DepthSensor, unit: float | None, colour: Callable[[int], Image],
        depth: Callable[[int], NDArray[Any]], names: Sequence[str], bits: int | None = None,
    ) -> None:  # fmt: skip
        self.cameras, self.sensor, self.unit = cameras, sensor, unit if unit is None else checked_unit(unit)
        self._colour, self._depth, self._names = colour, depth, names
        self._levels = Levels(lambda k: iter([colour(k)]), len(names), bits)
        camera = cameras.colour
        plain = Rig(camera.fx, camera.fy, camera.cx, camera.cy, 0.0, camera.width, camera.height, camera.skew)
        self.rig = virtual_rig(plain, sensor)
        self._empty: set[int] = set()  # pairs that were read whose maps know no depth

    @cached_property
    def looked_at(self) -> list[tuple[float, ...]]:
        """Of a few maps: median depth (m), shares of known pixels, of these that fly, out of range; scatter."""
        count = len(self._names)
        found: list[tuple[float, ...]] = []
        for index in sorted({round(k) for k in np.linspace(0, count - 1, min(count, _LOOKED_AT))}):
            try:
                depth = self._metres(index)
            except InputError:  # said when its pair is read
                continue
            known = np.isfinite(depth)
            flies = flying_pixels(depth, self._focal, self.sensor)
            median = float(np.median(depth[known])) if known.any() else np.nan
            flown = float(flies.sum() / max(known.sum(), 1))
            outside = float(1 - self._in_range(depth[known]).mean()) if known.any() else np.nan
            found.append((median, float(known.mean()), flown, outside, scatter(depth, self.sensor)))
        return found

    def check(self, where: object) -> None:
        """Refuse depths that nothing knows, or that are in another unit."""
        if not self.looked_at:
            self._metres(0)  # says what is wrong
        medians = np.array([median for median, *_ in self.looked_at])
        if np.isnan(medians).all():
            raise InputError(one_line(f"{where}: no depth is known in {len(medians)} maps, expected some"))
        median, sensor = float(np.nanmedian(medians)), self.sensor
        if not sensor.nearest / _BEYOND <= median <= sensor.farthest * _BEYOND:
            unit = "metres" if self.unit is None else f"steps of {self.unit:g} m"
            wanted = f"{sensor.nearest:g} to {sensor.farthest:g} m: is the unit right (--unit 0.001 reads millimetres)?"
            raise InputError(
                one_line(f"{where}: depths, read as {unit}, have a median of {median:.4g} m, expected {wanted}")
            )

    def describe(self) -> dict[str, Any]:
        """What ``run.json`` says of the depths."""
        median, known, flown, outside, wide = (
            float(np.nanmean(column)) for column in zip(*self.looked_at, strict=True)
        )
        return {
            "sensor": dict(vars(self.sensor)),
            "unit_m": 1.0 if self.unit is None else self.unit,
            "calibration": self.cameras.origin,
            "is_registered_here": self.cameras.depth is not None,
            "virtual_baseline_m": self.rig.baseline,
            "known_share": known,
            "flying_share": flown,
            "median_m": median,
            "outside_share": outside,
            "scatter": wide,
        }

    def doubts(self) -> Iterator[dict[str, str]]:
        """What looks wrong with depths that can still be worked with, in a few maps and in those that were read."""
        found = self.describe()
        if self._empty:
            first = min(self._empty)
            said = f"no depth is known in {len(self._empty)} of the maps that were read, first in that of frame {first}"
            yield {"code": "depth_empty", "message": f"{said} ({one_line(str(self._names[first]))})"}
        if found["known_share"] < _FEW_KNOWN:
            said = (
                f"{100 * found['known_share']:.0f} % of the pixels have a depth: there are points in a part of the view"
            )
            yield {"code": "depth_holes", "message": said}
        if found["flying_share"] > _MANY_FLY:
            said = f"{100 * found['flying_share']:.0f} % of the depths belong to no surface: is the sensor another one?"
            yield {"code": "depth_flying", "message": said}
        if found["outside_share"] > _MANY_OUTSIDE:
            reach = f"{self.sensor.nearest:g} to {self.sensor.farthest:g} m that the sensor measures"
            said = f"{100 * found['outside_share']:.0f} % of the depths are outside of the {reach}"
            said += f" (median {found['median_m']:.4g} m): is the unit right, or the sensor another?"
            yield {"code": "depth_range", "message": said}
        if found["scatter"] > _WIDE:
            said = f"neighbouring depths scatter {found['scatter']:.1f} times as the sensor should: is it another?"
            yield {"code": "depth_sensor", "message": said}

    def read(self, index: int, stamp: float) -> StereoPair:
        """Read a pair; its right image is the left one."""
        name = one_line(str(self._names[index]))
        try:
            (image,) = self._levels([self._colour(index)])
            bits = self._levels.bits_of(image)
            disparity = self._disparity(index)
        except InputError as error:
            said = one_line(str(error))
            raise InputError(said if name in said else f"{name}: {said}") from error
        if np.isfinite(disparity).any():
            self._empty.discard(index)
        else:
            self._empty.add(index)
        image, disparity, valid = self._undistorted(name, image, disparity)
        step = 0.0 if self.unit is None else self.unit
        sigma = disparity_sigma(self.rig, disparity, self.sensor, step=step)
        pair = StereoPair(image, image, self.rig, stamp, index, name, disparity, bits, sigma=sigma, valid=valid)
        check_pair(pair)
        return pair

    def _in_range(self, depth: FloatArray) -> BoolArray:
        inside: BoolArray = (depth >= self.sensor.nearest) & (depth <= self.sensor.farthest)
        return inside

    @property
    def _focal(self) -> float:
        return (self.cameras.depth or self.cameras.colour).fx

    def _metres(self, index: int) -> FloatArray:
        """Depths as they were measured, m; NaN where not known."""
        values = self._depth(index)
        camera = self.cameras.depth or self.cameras.colour
        if values.shape != (camera.height, camera.width):
            size = f"{values.shape[1]} x {values.shape[0]} px"
            wanted = f"{camera.width} x {camera.height} as its camera's"
            if self.cameras.depth is None:
                wanted += ": depths of the colour camera's pixels, or a calibration of both cameras (colour left)"
            raise InputError(f"{self._names[index]}: depth map is {size}, expected {wanted}")
        if values.dtype.itemsize == 1 or values.dtype.kind not in "iuf":
            raise InputError(f"{self._names[index]}: depth map is {values.dtype}, expected 16 bits or floats")
        if values.dtype.kind in "iu" and self.unit is None:
            said = f"depth map is {values.dtype} without a unit"
            raise InputError(f"{self._names[index]}: {said}, expected metres in one step (--unit 0.001 for mm)")
        known = known_values(values, (65_535.0,) if values.dtype.kind in "iu" else ())
        with np.errstate(invalid="ignore"):
            depth = known * (1.0 if self.unit is None else self.unit)
            return np.where((depth > 1e-6) & (depth < 1e6), depth, np.nan)

    def _disparity(self, index: int) -> FloatArray:
        """Disparities of the colour image's pixels, still distorted as it is."""
        depth = self._metres(index)
        depth[flying_pixels(depth, self._focal, self.sensor)] = np.nan
        if self.cameras.depth is not None and self.cameras.T_colour_depth is not None:
            depth = register_depth(depth, self.cameras.depth, self.cameras.T_colour_depth, self.rig, self.sensor)
        with np.errstate(invalid="ignore"):
            disparity = self.rig.fx * self.rig.baseline / depth
            return np.where(disparity <= self.rig.width, disparity, np.nan)

    def _undistorted(
        self, name: str, image: Image, disparity: FloatArray
    ) -> tuple[Image, FloatArray, BoolArray | None]:
        """Image and disparities without the lens's distortion, and which pixels the camera saw."""
        camera = self.cameras.colour
        if image.shape[:2] != (camera.height, camera.width):
            size = f"{image.shape[1]} x {image.shape[0]}"
            raise InputError(f"{name}: image is {size} px, but its camera has {camera.width} x {camera.height} px")
        if not any(camera.distortion):
            return image, disparity, None
        import cv2

        u, v, valid = self._map
        made: Image = cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
        if made.dtype.kind == "f":
            np.clip(made, 0, 1, out=made)
        if self.cameras.depth is None:  # registered ones are of the pixels without distortion already
            moved = np.full(disparity.shape, np.nan)
            moved[valid] = sample_map(disparity, np.column_stack([u[valid], v[valid]]).astype(np.float64))
            disparity = moved
        return made, disparity, valid

    @cached_property
    def _map(self) -> tuple[NDArray[np.float32], NDArray[np.float32], BoolArray]:
        """Where each pixel without distortion lies in the image as it is stored, and whether it is inside."""
        import cv2

        camera = self.cameras.colour
        K, lens = opencv_lens(camera)
        make: Any = cv2.fisheye.initUndistortRectifyMap if camera.lens == "equidistant" else cv2.initUndistortRectifyMap
        u, v = make(K, lens, np.eye(3), K, (camera.width, camera.height), cv2.CV_32FC1)
        return u, v, (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)


def scatter(depth: FloatArray, sensor: DepthSensor) -> float:
    """Scatter of neighbouring depths over what the sensor's would be: 1 where each errs by itself, less where together.

    The second difference of 1 / z is 0 on a plane; the median of its size is not moved by edges.
    """
    near = 1 / depth
    second = near[:, :-2] - 2 * near[:, 1:-1] + near[:, 2:]
    off = np.abs(second) / (np.sqrt(6.0) * sensor.sigma(depth[:, 1:-1]) * near[:, 1:-1] ** 2)
    known = np.isfinite(off)
    return float(1.4826 * np.median(off[known])) if known.any() else 0.0


def clock_doubts(apart: FloatArray, interval: float) -> Iterator[dict[str, str]]:
    """Say that depths were taken long before or after their images; `apart` and the `interval` of images in s."""
    middle, most = float(np.median(np.abs(apart))), float(np.abs(apart).max())
    if middle > _MANY_APART * interval:
        said = (
            f"depths were taken {1000 * middle:.1f} ms from their images in the median, {1000 * most:.1f} ms at most, "
            f"with {1000 * interval:.1f} ms between images: edges of depth and image differ where the camera moves"
        )
        yield {"code": "depth_clock", "message": said}
