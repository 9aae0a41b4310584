"""What a map or a frame can be coloured by: one layer for each quantity on its level, for pages, viewers and files."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import matplotlib
import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from .._brief import Brief
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..types import BoolArray, FloatArray, one_channel
from ._frame import Shown, depth, is_colour, limits, log_magnitude, log_steps, phase, phase_colours, wide

Level = Literal["vertex", "edge", "face"]
Scale = Literal["gray", "viridis", "cividis", "inferno", "phase", "rgb"]
BARE = np.array([146, 172, 200], np.uint8)  # of an element without a value: no colour of a scale, least of all a grey
COUNTED = "keyframes"  # a unit of whole numbers
_STEPS = 256


@dataclass(frozen=True, repr=False)
class Layer(Brief):
    """One quantity on one level of a complex, and how it is coloured.

    Attributes
    ----------
    name : str
        One word, such as ``face_signal``.
    label : str
        The words of its button.
    level : {"vertex", "edge", "face"}
        Whose values.
    values : (n,) float64, or (n, 3) float64 in [0, 1] where the scale is ``rgb``
        0 where there is none.
    ok : (n,) bool
        Where there is one.
    unit : str
        Unit, or what the number is; of a logarithmic scale of what stands on its ticks.
    scale : str
        Name of the colours; ``phase`` is cyclic, from -π to π; ``rgb`` has no scale.
    span : (2,) float
        Values of both ends of the scale.
    is_log : bool
        Whether `values` and `span` are decimal logarithms of what the legend says.
    note : str
        What it is, in a sentence.
    """

    name: str
    label: str
    level: Level
    values: FloatArray
    ok: BoolArray
    unit: str
    scale: Scale
    span: tuple[float, float]
    note: str
    is_log: bool = False


def layers_of_map(
    map_: TopologicalMap, regions: FloatArray | None = None, before: TopologicalMap | None = None
) -> list[Layer]:
    """List what a whole map can be coloured by, the face's luminance first; layers without a value are left out.

    Parameters
    ----------
    map_ : TopologicalMap
        The map.
    regions : (F, 3) float64, optional
        Colours of the faces by region, in [0, 1]: they come first.
    before : TopologicalMap, optional
        What a denoised map was, of the same complex: its luminance is there too.
    """
    made = [] if regions is None else [_plain("regions", "Regions", "face", regions, "Regions of like texture.")]
    now = list(_of_signals(map_))
    noisy = [] if before is None else list(_of_before(before, now))
    return [layer for layer in (*made, *now, *noisy, *_of_views(map_)) if layer.ok.any()]


def _of_before(map_: TopologicalMap, now: list[Layer]) -> Iterator[Layer]:
    """Luminance before denoising, on the scales of that after it."""
    for layer, denoised in zip(_of_signals(map_), now, strict=True):
        if layer.name.endswith("_signal"):
            label = f"{layer.label} as measured"
            yield replace(layer, name=f"{layer.name}_before", label=label, span=denoised.span)


def layers_of_frame(frame: Frame) -> list[Layer]:
    """List what a frame's mesh can be coloured by, the face's luminance first; layers without a value are left out."""
    arg = phase(frame)
    note = "arg r, eqs (12), (19)-(22): where luminance grows in the image, from dark to bright; v points down."
    made = [
        *_of_signals(frame),
        _depth(depth(frame), "Depth z of each point, from the left camera."),
        Layer("phase", "Phase", "vertex", arg.values, arg.ok, "arg r [rad]", "phase", (-np.pi, np.pi), note),
    ]
    return [layer for layer in made if layer.ok.any()]


def colours_of(layer: Layer) -> NDArray[np.uint8]:
    """Give each element its colour, (n, 3) uint8 sRGB; `BARE` where there is no value."""
    if layer.scale == "rgb":
        found = np.rint(255 * np.clip(layer.values, 0, 1)).astype(np.uint8)
    else:
        found = table(layer.scale)[steps_of(layer)]
    return np.where(layer.ok[:, None], found, BARE)


def steps_of(layer: Layer) -> NDArray[np.uint8]:
    """Place each value on a scale other than ``rgb``, (n,) uint8: 0 and 255 are its ends; 0 where there is none."""
    low, high = layer.span
    share = (layer.values - low) / (high - low)
    return np.where(layer.ok, np.clip(np.rint((_STEPS - 1) * share), 0, _STEPS - 1), 0).astype(np.uint8)


@cache
def table(scale: Scale) -> NDArray[np.uint8]:
    """Colours of a scale from its low to its high end, (256, 3) uint8."""
    if scale == "phase":
        rgb = phase_colours(_STEPS)
    else:
        rgb = np.asarray(matplotlib.colormaps[scale](np.arange(_STEPS)))[:, :3]
    made = np.rint(255 * rgb).astype(np.uint8)
    made.setflags(write=False)
    return made


def ticks_of(layer: Layer) -> list[tuple[float, str]]:
    """Choose what stands beside a scale: place in [0, 1] from its low end, and words; none beside plain colours.

    Examples
    --------
    >>> ok = np.ones(2, bool)
    >>> layer = Layer("depth", "Depth", "vertex", np.array([0.0, 2]), ok, "m", "viridis", (0.0, 2.0), "", is_log=True)
    >>> [words for _, words in ticks_of(layer)]
    ['1', '2', '5', '10', '20', '50', '100']
    """
    if layer.scale == "rgb":
        return []
    low, high = layer.span
    if layer.scale == "phase":
        return [(k / 4, words) for k, words in enumerate(("−π", "−π/2", "0", "π/2", "π"))]
    if layer.is_log:
        steps = log_steps(10**low, 10**high)
        chosen = steps if len(steps) > 1 else [10**low, 10**high]
        return [(float((np.log10(z) - low) / (high - low)), f"{z:.3g}") for z in chosen]
    found = MaxNLocator(5, steps=[1, 2, 2.5, 5, 10], integer=layer.unit == COUNTED).tick_values(low, high)
    values = [float(value) for value in found if low - 1e-9 <= value <= high + 1e-9]
    return [((value - low) / (high - low), f"{value:.3g}") for value in values]


def _of_signals(shown: Frame | TopologicalMap) -> Iterator[Layer]:
    """Luminance on every level, and the magnitude of the response."""
    signals = shown.signals
    note = "Mean over the pixels of each face, eq. (6)." if isinstance(shown, Frame) else "Mean over the keyframes."
    yield _luminance("face_signal", "Luminance of faces", "face", signals.face, signals.face_ok, note)
    note = "Mean over the pixels of each edge, eq. (5)." if isinstance(shown, Frame) else "Mean over the keyframes."
    yield _luminance("edge_signal", "Luminance of edges", "edge", signals.edge, signals.edge_ok, note)
    note = "Luminance of the pixel at each vertex." if isinstance(shown, Frame) else "Mean over the keyframes."
    yield _luminance("vertex_signal", "Luminance of vertices", "vertex", signals.vertex, signals.vertex_ok, note)
    size = log_magnitude(shown)[0]
    note = "|r|, eqs (12), (19)-(22): large where luminance changes around a vertex, small where it is flat."
    span = limits(size.values[size.ok])
    yield Layer("magnitude", "Magnitude", "vertex", size.values, size.ok, "|r|", "inferno", span, note, is_log=True)


def _of_views(map_: TopologicalMap) -> Iterator[Layer]:
    """What many keyframes tell that one frame cannot."""
    note = "Where luminance grows, along the surface; red: right, green: up, blue: forward, each from - to +."
    yield _plain("direction", "Direction", "vertex", 0.5 + 0.5 * map_.direction * (1, -1, 1), note, map_.defined)
    yield _depth(_map_depth(map_), "Depth z of each vertex from the keyframe that sees it best.")
    for level in ("face", "edge"):
        count = np.asarray(getattr(map_.view_count, level), np.float64)
        span = (1.0, max(float(count.max(initial=0)), 2.0))
        label, note = f"Views of {level}s", f"How many keyframes the luminance of each {level} is a mean of."
        yield Layer(f"{level}_views", label, level, count, count > 0, COUNTED, "cividis", span, note)
    variance = np.asarray(map_.view_variance.face, np.float64)
    spread, ok = np.sqrt(one_channel(variance)), np.asarray(map_.view_count.face) > 1
    note = "Standard deviation of a face's luminance over its keyframes: what shines, moves or is mismatched."
    span = (0.0, limits(spread[ok])[1])
    yield Layer("face_spread", "Difference between views", "face", spread, ok, "luminance", "inferno", span, note)


def _map_depth(map_: TopologicalMap) -> Shown:
    """Depth of each vertex in its best view, m."""
    view = np.asarray(map_.best_view.vertex)
    T = map_.T_world_camera[np.maximum(view, 0)]
    z = ((map_.xyz - T[:, :3, 3]) * T[:, :3, 2]).sum(axis=1)
    ok = (view >= 0) & (z > 0)
    return Shown(np.where(ok, z, 0.0), ok)


def _depth(shown: Shown, note: str) -> Layer:
    span = limits(shown.values[shown.ok])
    if not wide(*span):
        return Layer("depth", "Depth", "vertex", shown.values, shown.ok, "m", "viridis", span, note)
    logs = np.log10(np.where(shown.ok, shown.values, 1.0))
    return Layer("depth", "Depth", "vertex", logs, shown.ok, "m", "viridis", limits(logs[shown.ok]), note, is_log=True)


def _luminance(name: str, label: str, level: Level, signal: FloatArray, ok: BoolArray, note: str) -> Layer:
    """Grey, or the colours of a signal with three channels."""
    if is_colour(signal):
        return _plain(name, label, level, signal, note, ok)
    values: FloatArray = np.where(ok, one_channel(signal), 0.0)
    span = (0.0, max(limits(values[ok])[1], 1e-3))
    return Layer(name, label, level, values, ok, "luminance", "gray", span, note)


def _plain(name: str, label: str, level: Level, rgb: FloatArray, note: str, ok: BoolArray | None = None) -> Layer:
    """A layer that is its own colours."""
    known = np.ones(len(rgb), np.bool_) if ok is None else ok
    return Layer(name, label, level, np.clip(rgb, 0, 1), known, "", "rgb", (0.0, 1.0), note)
