"""What is shown of a frame: depth, luminance, log magnitude and phase, each with a mask of where it exists."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief
from .._checks import require
from ..errors import InputError
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..types import (
    REC601,
    UNIT_OF,
    BoolArray,
    FloatArray,
    Image,
    one_channel,
    phase_of,
)

FARTHEST_PX = 1e6  # projections beyond it are not drawn
LIGHTNESS, CHROMA = 0.74, 0.125  # of the phase circle in OKLCh: vivid, and inside sRGB at every hue
CLIP_PERCENT = (1.0, 99.0)
CLIP_MARGIN = 0.25  # of the kept range: a torus keeps its rim, a stray point at 500 m does not set the view


@dataclass(frozen=True, repr=False)
class Shown(Brief):
    """Values of one level of a complex, and where they exist.

    Attributes
    ----------
    values : (n,) float64
        0 where there is none.
    ok : (n,) bool
        Where there is one.
    """

    values: FloatArray
    ok: BoolArray


def check_frame(frame: Frame) -> None:
    """Refuse a frame whose parts do not belong together.

    Raises
    ------
    InputError
        If the image is empty or not an image, or lengths differ.
    """
    require(frame, Frame, "frame")
    shape = np.shape(image_of(frame))
    if len(shape) not in (2, 3) or 0 in shape or (len(shape) == 3 and shape[2] not in (1, 3, 4)):
        raise InputError(f"view: frame {frame.name!r} has an image of shape {shape}, expected (H, W) or (H, W, 3)")
    n, E, F = len(frame.cloud), len(frame.complex_.edges), len(frame.complex_.faces)
    signals = frame.signals
    lengths = {
        "complex_.n": (frame.complex_.n, n),
        "signals.vertex": (len(signals.vertex), n),
        "signals.edge": (len(signals.edge), E),
        "signals.face": (len(signals.face), F),
        "signals.vertex_ok": (len(signals.vertex_ok), n),
        "signals.edge_ok": (len(signals.edge_ok), E),
        "signals.face_ok": (len(signals.face_ok), F),
        "cloud.uv": (len(frame.cloud.uv), n),
        "response.z": (len(frame.response.z), n),
        "response.defined": (len(frame.response.defined), n),
    }
    for what, (seen, expected) in lengths.items():
        if seen != expected:
            raise InputError(f"view: frame {frame.name!r} has {what} of length {seen}, expected {expected}")


def image_of(frame: Frame) -> Image:
    """The left image, (H, W) or (H, W, 3); `InputError` if the frame has none, as one read from a file."""
    if frame.image is None:
        way = "expected one of Session.process(pair), or dataclasses.replace(frame, image=pair.left)"
        raise InputError(f"view: frame {frame.name!r} has no image, {way}")
    return frame.image


def grey(image: Image) -> FloatArray:
    """Luminance of an image for display, (H, W) in [0, 1]; values that are not finite become 0."""
    unit = UNIT_OF.get(image.dtype, 1.0)
    levels = np.nan_to_num(image.astype(np.float64) * unit, nan=0.0, posinf=1.0, neginf=0.0)
    if levels.ndim == 3:
        levels = levels[..., 0] if levels.shape[2] == 1 else levels[..., :3] @ REC601
    return np.clip(levels, 0, 1)


def is_colour(signal: FloatArray) -> bool:
    """Whether a signal has three channels, which are shown as red, green and blue."""
    return signal.ndim == 2 and signal.shape[1] == 3


def projected(frame: Frame) -> BoolArray:
    """(N,) where a vertex has a place in the image and a depth in front of the camera."""
    near = (np.abs(frame.cloud.uv) < FARTHEST_PX).all(axis=1)
    finite = near & np.isfinite(frame.cloud.xyz).all(axis=1)
    return finite & (np.where(finite, frame.cloud.xyz[:, 2], 0.0) > 0)


def depth(frame: Frame) -> Shown:
    """Depth z of each vertex, m."""
    ok = projected(frame)
    return Shown(np.where(ok, frame.cloud.xyz[:, 2], 0.0), ok)


def texture(signal: FloatArray) -> FloatArray:
    """Colours (n, 3) of a signal: itself if it has three channels, else the grey of their mean."""
    rgb = signal if is_colour(signal) else np.repeat(one_channel(signal)[:, None], 3, axis=1)
    return np.clip(0.08 + 0.92 * rgb, 0, 1)


def log_magnitude(frame: Frame | TopologicalMap) -> tuple[Shown, int]:
    """``log10 |r|`` of each vertex where r is defined and not 0, and the number of vertices where it is exactly 0.

    The filter is linear, so the mean over channels is the response to the mean signal.
    """
    magnitude = np.abs(one_channel(frame.response.z))
    defined = frame.response.defined & np.isfinite(magnitude)
    ok = defined & (magnitude > 0)
    return Shown(np.log10(np.where(ok, magnitude, 1.0)), ok), int((defined & (magnitude == 0)).sum())


def phase(frame: Frame) -> Shown:
    """``arg r`` of each vertex where r is defined and not 0, in (-π, π], rad."""
    z = one_channel(frame.response.z)
    ok = frame.response.defined & np.isfinite(z) & (z != 0)
    return Shown(phase_of(np.where(ok, z, 1.0)), ok)


def on_faces(faces: NDArray[np.int32], at_vertices: Shown) -> Shown:
    """Mean of each face over those of its vertices that have a value."""
    count = at_vertices.ok[faces].sum(axis=1)
    total = np.where(at_vertices.ok, at_vertices.values, 0.0)[faces].sum(axis=1)
    return Shown(total / np.maximum(count, 1), count > 0)


def phase_on_faces(faces: NDArray[np.int32], at_vertices: Shown) -> Shown:
    """Circular mean of the phase of each face: the direction of the sum of its vertices' unit phasors."""
    units = np.where(at_vertices.ok, np.exp(1j * at_vertices.values), 0.0)
    total = units[faces].sum(axis=1)
    ok = np.abs(total) > 1e-9
    return Shown(np.where(ok, phase_of(total), 0.0), ok)


def limits(values: FloatArray, low: float = 1.0, high: float = 99.0) -> tuple[float, float]:
    """Choose a colour range: two percentiles of the values, a little around a single value, (0, 1) for none.

    Examples
    --------
    >>> limits(np.arange(101.0))
    (1.0, 99.0)
    >>> limits(np.empty(0))
    (0.0, 1.0)
    """
    if not len(values):
        return 0.0, 1.0
    bottom, top = (float(x) for x in np.percentile(values, [low, high]))
    least = max(1e-3 * max(abs(bottom), abs(top)), 1e-9)
    return (bottom, top) if top - bottom > least else (bottom - least, top + least)


def log_steps(low: float, high: float) -> list[float]:
    """List 1, 2 and 5 times the powers of ten in a range, 0 < low < high: the ticks of a logarithmic scale.

    Examples
    --------
    >>> log_steps(3, 60)
    [5.0, 10.0, 20.0, 50.0]
    """
    powers = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    return [float(f"{m}e{k}") for k in powers for m in (1, 2, 5) if low <= float(f"{m}e{k}") <= high]


def wide(low: float, high: float) -> bool:
    """Tell whether a range of depth is so wide that a linear scale would show only its far end."""
    return low > 0 and high / low > 8


def in_view(frame: Frame) -> BoolArray:
    """Mark the vertices, (N,), that a view in space shows: in the 1-99 % range of each axis, a quarter wider."""
    keep = projected(frame)
    if keep.any():
        xyz = np.where(keep[:, None], frame.cloud.xyz, 0.0)
        low, high = np.percentile(xyz[keep], CLIP_PERCENT, axis=0)
        margin = CLIP_MARGIN * (high - low) + 1e-9
        keep &= ((xyz >= low - margin) & (xyz <= high + margin)).all(axis=1)
    return keep


def phase_colours(count: int) -> FloatArray:
    """Make a cyclic colour map, (count, 3) sRGB in [0, 1]: the hue circle of OKLCh at one lightness, from -π to π.

    Equal steps of phase look equally large, and no phase looks brighter than another, as it would in HSV.
    """
    hue = np.linspace(-np.pi, np.pi, count) + np.deg2rad(250)
    a, b = CHROMA * np.cos(hue), CHROMA * np.sin(hue)
    lms = np.stack(
        [
            LIGHTNESS + 0.3963377774 * a + 0.2158037573 * b,
            LIGHTNESS - 0.1055613458 * a - 0.0638541728 * b,
            LIGHTNESS - 0.0894841775 * a - 1.2914855480 * b,
        ]
    )
    to_rgb = np.array(
        [
            [4.0767416621, -3.3077115913, 0.2309699292],
            [-1.2684380046, 2.6097574011, -0.3413193965],
            [-0.0041960863, -0.7034186147, 1.7076147010],
        ]
    )
    linear = np.clip(to_rgb @ lms**3, 0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055).T
