"""How well a depth camera measures: the spread of its depths, the rig that stands for it, pixels that fly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..._settings import Checked, setting
from ...errors import InputError
from ...types import BoolArray, FloatArray, Rig

_SIGMA = 0.3  # px, what `Tracking.sigma_disparity` takes a disparity's spread to be: limits in px are made for that
_MIDDLE = 2.0  # m, where the virtual rig has that spread: the depth of a room
_LEAST_SIGMA = 1e-3  # px
_WIDEST_DISPARITY = 0.9  # of the image's width, at the nearest depth: larger ones are taken for a wrong unit
_STEEPEST = np.tan(np.radians(80.0))  # of a surface that one sees so flat that its depth is not believed
_SURE = 3.0  # standard deviations
_FEWEST_NEIGHBOURS = 2  # of eight on the same surface


@dataclass(frozen=True)
class DepthSensor(Checked, what="depth sensor"):
    """How a depth camera's depths scatter: ``σ_z = constant + linear z + quadratic z²``.

    `SENSORS` has three: structured light, time of flight, and active stereo.

    Parameters
    ----------
    constant : float
        The same at any depth.
    linear : float
        Share of the depth.
    quadratic : float
        As of what triangulates: constant in disparity.
    nearest : float
        Least depth that it measures.
    farthest : float
        Largest depth that it measures.

    Raises
    ------
    InputError
        If a parameter is out of its range, all three of the spread are 0, or the range is empty.

    Examples
    --------
    >>> round(float(SENSORS["structured_light"].sigma(2.0)), 4)
    0.0057
    """

    constant: float = setting(0.0, 0, 1, unit="m", source="none by default")
    linear: float = setting(0.0, 0, 1, unit="m per m", source="none by default")
    quadratic: float = setting(1.425e-3, 0, 1, unit="1 per m", source="Khoshelham and Elberink 2012, for Kinect")
    nearest: float = setting(0.4, 0.01, 100, unit="m", source="Kinect's, in near mode")
    farthest: float = setting(10.0, 0.1, 1000, unit="m", source="Kinect's")

    def __post_init__(self) -> None:
        """Check the ranges."""
        super().__post_init__()
        if not self.constant + self.linear + self.quadratic > 0:
            raise InputError("depth sensor: constant, linear and quadratic are 0, expected a spread of its depths")
        if not self.nearest < self.farthest:
            raise InputError(f"depth sensor: nearest is {self.nearest:g} m, expected less than {self.farthest:g} m")

    def sigma(self, depth: FloatArray | float) -> FloatArray:
        """Compute the standard deviation of depths.

        Parameters
        ----------
        depth : (...,) float64
            z, m.

        Returns
        -------
        (...,) float64
            m.
        """
        z = np.asarray(depth, np.float64)
        return np.asarray(self.constant + z * (self.linear + z * self.quadratic))


SENSORS = {
    "structured_light": DepthSensor(),
    "time_of_flight": DepthSensor(constant=1e-3, linear=5e-4, quadratic=0.0, nearest=0.3, farthest=8.0),
    "stereo": DepthSensor(quadratic=3.8e-3, nearest=0.3, farthest=10.0),
}
"""Depth sensors by their kind.

Structured light is Kinect's: Khoshelham and Elberink, Sensors 12 (2012), ``σ_z = 1.425e-3 z²``. Time of flight is
Kinect v2's at right angles: within 1.5 mm of ``1.5 - 0.5 z + 0.3 z²`` mm (Fankhauser et al., ICAR 2015) from 0.5 to
4 m. Stereo is an active one of 50 mm and 425 px whose disparities scatter by 0.08 px, as Intel gives it for D4xx.
"""


def virtual_rig(camera: Rig, sensor: DepthSensor) -> Rig:
    """Choose the pair of cameras that stands for a depth camera: its disparities scatter as those of a stereo camera.

    Limits that the path and the map have in px of disparity then mean for depths what they mean for stereo: at 2 m the
    baseline is the one at which ``σ_d = fx · baseline · σ_z / z²`` is 0.3 px, if no disparity at the nearest depth is
    wider than 0.9 of the image then.

    Parameters
    ----------
    camera : Rig
        The camera whose pixels have depths; its baseline and offset are not looked at.
    sensor : DepthSensor
        What measures the depths.

    Returns
    -------
    Rig

    Examples
    --------
    >>> camera = Rig(fx=525, fy=525, cx=319.5, cy=239.5, width=640, height=480)
    >>> round(virtual_rig(camera, SENSORS["structured_light"]).baseline, 3)
    0.401
    """
    wanted = _SIGMA * _MIDDLE**2 / (camera.fx * float(sensor.sigma(_MIDDLE)))
    most = _WIDEST_DISPARITY * camera.width * sensor.nearest / camera.fx
    return replace(camera, baseline=float(min(wanted, most)), doffs=0.0)


def disparity_sigma(rig: Rig, disparity: FloatArray, sensor: DepthSensor, *, step: float = 0.0) -> FloatArray:
    """Compute the standard deviation of each disparity of a depth camera's virtual rig, ``σ_z d / z``.

    Parameters
    ----------
    rig : Rig
        As `virtual_rig` gives it.
    disparity : (...,) float64
        px; NaN where not known.
    sensor : DepthSensor
        What measured the depths.
    step : float
        Metres in one step of depths that were rounded; adds ``step² / 12`` to the variance.

    Returns
    -------
    (...,) float64
        px; NaN where the disparity is.

    Examples
    --------
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.4, width=640, height=480)
    >>> disparity_sigma(rig, np.array([100.0]), SENSORS["structured_light"]).round(3).tolist()
    [0.285]
    """
    z = rig.fx * rig.baseline / disparity
    spread = np.sqrt(sensor.sigma(z) ** 2 + step**2 / 12)
    return np.asarray(np.fmax(spread * disparity / z, np.where(np.isnan(z), np.nan, _LEAST_SIGMA)))


def neighbour_step(depth: FloatArray, fx: float, sensor: DepthSensor) -> FloatArray:
    """Tell by how much the depths of two neighbours on one surface may differ, as `flying_pixels` has it.

    Parameters
    ----------
    depth, fx, sensor
        As `flying_pixels`.

    Returns
    -------
    (H, W) float64
        m; NaN where the depth is.
    """
    return depth * (_STEEPEST / fx) + _SURE * np.sqrt(2) * sensor.sigma(depth)


def flying_pixels(depth: FloatArray, fx: float, sensor: DepthSensor) -> BoolArray:
    """Find depths that belong to no surface: those between a near and a far one at an edge, and those that stand alone.

    Two neighbours are on one surface if their depths differ by at most ``z tan(80°) / fx``, as on a surface seen at 80°
    from its normal, and 3 standard deviations of their difference. A pixel flies if it is between two opposite
    neighbours of which neither is on its surface, or if fewer than two of its eight neighbours are.

    Parameters
    ----------
    depth : (H, W) float64
        z, m; NaN where not known.
    fx : float
        Focal length, px.
    sensor : DepthSensor
        What measured the depths.

    Returns
    -------
    (H, W) bool

    Examples
    --------
    >>> edge = np.tile([1.0, 1.0, 1.0, 1.6, 3.0, 3.0, 3.0], (5, 1))
    >>> flying_pixels(edge, 500.0, SENSORS["structured_light"])[2].tolist()
    [False, False, False, True, False, False, False]
    """
    known, step = np.isfinite(depth), neighbour_step(depth, fx, sensor)
    padded = np.pad(depth, 1, constant_values=np.nan)
    height, width = depth.shape
    beside = {
        (r, c): padded[1 + r : 1 + r + height, 1 + c : 1 + c + width] - depth
        for r in (-1, 0, 1)
        for c in (-1, 0, 1)
        if (r, c) != (0, 0)
    }
    with np.errstate(invalid="ignore"):
        same = sum((np.abs(gap) <= step).astype(np.int8) for gap in beside.values())
        flies = known & (np.asarray(same) < _FEWEST_NEIGHBOURS)
        for r, c in ((0, 1), (1, 0), (1, 1), (1, -1)):
            one, other = beside[r, c], beside[-r, -c]
            flies |= ((one > step) & (other < -step)) | ((one < -step) & (other > step))
    return flies
