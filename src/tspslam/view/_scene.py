"""The mesh of a frame as an interactive scene: one set of traces for each signal, all in one plotly figure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from .._brief import Brief
from ..frame import Frame
from ..types import BoolArray, FloatArray, one_channel
from ._frame import (
    Shown,
    depth,
    in_view,
    limits,
    log_magnitude,
    log_steps,
    on_faces,
    phase,
    phase_colours,
    phase_on_faces,
    wide,
)

MAX_FACES, MAX_EDGES = 150_000, 60_000  # beyond these a browser crawls: every k-th is shown, and the page says so
GREYS = [[0.0, "#101215"], [1.0, "#ffffff"]]
BARE, INK, GRID = "#8d97a3", "#7d8894", "#a9b3bd"  # legible on a light and on a dark page
CENTRE = {"x": 0.0, "y": 0.0, "z": -0.15}
LIGHTING = {
    "ambient": 0.74,
    "diffuse": 0.34,
    "specular": 0.0,
    "roughness": 1.0,
    "fresnel": 0.0,
    "facenormalsepsilon": 0.0,
    "vertexnormalsepsilon": 0.0,
}
LIGHT = {"x": -40000.0, "y": -90000.0, "z": 55000.0}
EYE = np.array([-0.42, -0.86, 0.3]) * 1.95  # behind the camera, to its left, above it, in radii of the scene

HOVER = "right %{x:.2f} m<br>forward %{y:.2f} m<br>up %{z:.2f} m<extra></extra>"
LUMINANCE, PHASE, LOG_DEPTH = "luminance", "arg r [rad]", "z [m], logarithmic"
Trace = Any  # go.Mesh3d or go.Scatter3d


@dataclass(frozen=True, repr=False)
class View(Brief):
    """What one button shows.

    Attributes
    ----------
    label : str
        The button's words.
    traces : tuple of traces
        Shown together while the button is pressed.
    """

    label: str
    traces: tuple[Trace, ...]


@dataclass(frozen=True, repr=False)
class Mesh(Brief):
    """The part of a frame's mesh that is shown: vertices in plotly's axes, faces into them."""

    xyz: NDArray[np.float32]  # x right, z forward, -y up
    vertices: NDArray[np.int64]  # rows of the cloud
    faces: NDArray[np.int32]  # into `vertices`
    rows: NDArray[np.int64]  # rows of the complex's faces


def scene_views(frame: Frame) -> list[View]:
    """Build the traces of each signal; without faces there are dots, without points there is no view."""
    keep = in_view(frame)
    if not keep.any():
        return []
    mesh = _mesh(frame, keep)
    views = _face_views(frame, mesh) if len(mesh.faces) else _dot_views(frame, mesh)
    edges = _edge_view(frame, keep)
    return [*views[:2], edges, *views[2:]] if edges else views


def scene_figure(views: list[View]) -> go.Figure:
    """Put every trace in one figure, the first view's visible, upright, with equal axes."""
    return figure_of([trace for view in views for trace in view.traces], len(views[0].traces), EYE)


def figure_of(traces: list[Trace], shown: int, eye: FloatArray) -> go.Figure:
    """Put traces in one figure, the first `shown` visible, upright, with equal axes, seen from `eye`."""
    for number, trace in enumerate(traces):
        trace.visible = number < shown
    axis = {
        "showbackground": False,
        "gridcolor": GRID,
        "gridwidth": 1,
        "zeroline": False,
        "showspikes": False,
        "nticks": 7,
    }
    names = {"xaxis": "x right [m]", "yaxis": "z forward [m]", "zaxis": "−y up [m]"}
    low, high = _bounds(traces)
    scene = {
        key: {**axis, "title": {"text": name}, "range": [float(low[k]), float(high[k])]}
        for k, (key, name) in enumerate(names.items())
    }
    size = (high - low) / (np.linalg.norm(high - low) / 2)
    camera = {"eye": dict(zip("xyz", eye.tolist(), strict=True)), "center": CENTRE}
    ratio = dict(zip("xyz", size.tolist(), strict=True))
    layout = go.Layout(
        scene={**scene, "aspectmode": "manual", "aspectratio": ratio, "camera": camera, "dragmode": "turntable"},
        margin={"l": 0, "r": 0, "t": 0, "b": 0},
        paper_bgcolor="rgba(0,0,0,0)",
        font={"color": INK, "size": 12, "family": "system-ui, sans-serif"},
        showlegend=False,
        template=go.layout.Template(),
    )
    return go.Figure(traces, layout)


def _bounds(traces: list[Trace]) -> tuple[FloatArray, FloatArray]:
    """Corners of the box around everything, no side less than a hundredth of the longest."""
    places = [[np.asarray(trace[axis], np.float64) for axis in "xyz"] for trace in traces]
    low = np.array([[np.nanmin(c) for c in place] for place in places]).min(axis=0)
    high = np.array([[np.nanmax(c) for c in place] for place in places]).max(axis=0)
    pad = np.maximum(0.01 * max(float((high - low).max()), 1e-3) - (high - low), 0) / 2
    return low - pad, high + pad


def thinned(frame: Frame) -> str:
    """Say what the interactive scene leaves out, for its caption; empty if nothing."""
    keep = in_view(frame)
    hidden = int((~keep).sum())
    words = f" Points not shown, far off or unseen: {hidden}." if hidden else ""
    for what, elements, most in (
        ("face", frame.complex_.faces, MAX_FACES),
        ("edge", frame.complex_.edges, MAX_EDGES),
    ):
        step = _step(int(keep[elements].all(axis=1).sum()), most)
        words += f" Only one {what} in {step} is shown." if step > 1 else ""
    return words


def _step(count: int, most: int) -> int:
    return max(1, -(-count // most))


def _mesh(frame: Frame, keep: BoolArray) -> Mesh:
    faces = frame.complex_.faces
    rows = np.flatnonzero(keep[faces].all(axis=1))
    rows = rows[:: _step(len(rows), MAX_FACES)]
    vertices = np.unique(faces[rows]).astype(np.int64) if len(rows) else np.flatnonzero(keep)
    renumbered = np.searchsorted(vertices, faces[rows]).astype(np.int32)
    xyz = frame.cloud.xyz[vertices]
    return Mesh(upright(xyz), vertices, _towards_camera(xyz, renumbered), rows)


def _towards_camera(xyz: FloatArray, faces: NDArray[np.int32]) -> NDArray[np.int32]:
    """Wind every face the same way as the camera sees it, so that neighbours are lit alike."""
    a, b, c = (xyz[faces[:, k]] for k in range(3))
    away = (np.cross(b - a, c - a) * a).sum(axis=1) > 0
    return np.where(away[:, None], faces[:, [0, 2, 1]], faces)


def upright(xyz: FloatArray) -> NDArray[np.float32]:
    """Places in plotly's axes."""
    return np.stack([xyz[:, 0], xyz[:, 2], -xyz[:, 1]], axis=1).astype(np.float32)


def _levels(frame: Frame) -> list[tuple[str, str, Shown, Any]]:
    """Label, unit, values at the vertices, and colour scale of what vertices carry."""
    luminance = Shown(one_channel(frame.signals.vertex), frame.signals.vertex_ok)
    cyclic = ["#" + "".join(f"{c:02x}" for c in rgb) for rgb in np.rint(255 * phase_colours(25)).astype(int)]
    return [
        ("Vertex signal", LUMINANCE, luminance, GREYS),
        ("Depth", *_depth(frame), "Viridis"),
        ("Magnitude", "log₁₀ |r|", log_magnitude(frame)[0], "Inferno"),
        ("Phase", PHASE, phase(frame), cyclic),
    ]


def _depth(frame: Frame) -> tuple[str, Shown]:
    shown = depth(frame)
    if not wide(*limits(shown.values[shown.ok])):
        return "z [m]", shown
    return LOG_DEPTH, Shown(np.log10(np.where(shown.ok, shown.values, 1.0)), shown.ok)


def _face_views(frame: Frame, mesh: Mesh) -> list[View]:
    faces = frame.complex_.faces
    luminance = Shown(one_channel(frame.signals.face), frame.signals.face_ok)
    views = [View("Face signal", _coloured(mesh, luminance, LUMINANCE, GREYS))]
    for label, unit, shown, scale in _levels(frame):
        if label == "Vertex signal":
            views.append(View(label, _smooth(mesh, shown, unit, scale)))
        else:
            at_faces = (phase_on_faces if label == "Phase" else on_faces)(faces, shown)
            views.append(View(label, _coloured(mesh, at_faces, unit, scale)))
    return views


def _coloured(mesh: Mesh, at_faces: Shown, unit: str, scale: Any) -> tuple[Trace, ...]:
    """Faces in one colour each; those without a value in plain grey."""
    values, ok = at_faces.values[mesh.rows], at_faces.ok[mesh.rows]
    traces = []
    if ok.any():
        traces.append(_trace(mesh, mesh.faces[ok], values[ok], "cell", unit, scale))
    if not ok.all():
        traces.append(bare(mesh, mesh.faces[~ok]))
    return tuple(traces)


def _smooth(mesh: Mesh, at_vertices: Shown, unit: str, scale: Any) -> tuple[Trace, ...]:
    """Faces shaded between their vertices; those with a vertex without a value in plain grey."""
    values, ok = at_vertices.values[mesh.vertices], at_vertices.ok[mesh.vertices][mesh.faces].all(axis=1)
    traces = []
    if ok.any():
        traces.append(_trace(mesh, mesh.faces[ok], values, "vertex", unit, scale))
    if not ok.all():
        traces.append(bare(mesh, mesh.faces[~ok]))
    return tuple(traces)


def _trace(mesh: Mesh, faces: NDArray[np.int32], values: FloatArray, mode: str, unit: str, scale: Any) -> Trace:
    low, high = _range(values, unit)
    return go.Mesh3d(
        **geometry(mesh, faces),
        intensity=values.astype(np.float32),
        intensitymode=mode,
        colorscale=scale,
        cmin=low,
        cmax=high,
        colorbar=colour_bar(unit, low, high),
        hovertemplate=HOVER,
    )


def bare(mesh: Mesh, faces: NDArray[np.int32]) -> Trace:
    """Faces without a value."""
    return go.Mesh3d(**geometry(mesh, faces), color=BARE, opacity=0.4, hoverinfo="skip")


def geometry(mesh: Mesh, faces: NDArray[np.int32]) -> dict[str, Any]:
    """Where faces are, and how they are lit."""
    x, y, z = (np.ascontiguousarray(c) for c in mesh.xyz.T)
    i, j, k = (np.ascontiguousarray(c) for c in faces.T)
    return {
        "x": x,
        "y": y,
        "z": z,
        "i": i,
        "j": j,
        "k": k,
        "flatshading": True,
        "lighting": LIGHTING,
        "lightposition": LIGHT,
    }


def _range(values: FloatArray, unit: str) -> tuple[float, float]:
    if unit == PHASE:
        return -np.pi, np.pi
    return (0.0, 1.0) if unit == LUMINANCE else limits(values)


def colour_bar(unit: str, low: float, high: float) -> dict[str, Any]:
    """The scale beside a scene."""
    title = {"text": unit, "side": "right"}
    bar: dict[str, Any] = {"title": title, "thickness": 12, "len": 0.7, "outlinewidth": 0, "x": 1}
    if unit == LOG_DEPTH:
        depths = log_steps(10**low, 10**high)
        bar |= {"tickvals": np.log10(depths).tolist(), "ticktext": [f"{z:g}" for z in depths]}
    if unit == PHASE:
        ticks = [-np.pi, -np.pi / 2, 0, np.pi / 2, np.pi]
        bar |= {"tickvals": ticks, "ticktext": ["−π", "−π/2", "0", "π/2", "π"]}
    return bar


def _dot_views(frame: Frame, mesh: Mesh) -> list[View]:
    views = []
    for label, unit, shown, scale in _levels(frame):
        ok = shown.ok[mesh.vertices]
        values = shown.values[mesh.vertices][ok]
        if len(values):
            low, high = _range(values, unit)
            marker = {"size": 3, "color": values.astype(np.float32), "colorscale": scale, "cmin": low, "cmax": high}
            marker |= {"colorbar": colour_bar(unit, low, high)}
            x, y, z = (np.ascontiguousarray(c) for c in mesh.xyz[ok].T)
            views.append(
                View(label, (go.Scatter3d(x=x, y=y, z=z, mode="markers", marker=marker, hovertemplate=HOVER),))
            )
    return views


def _edge_view(frame: Frame, keep: BoolArray) -> View | None:
    """Edges with a signal, as lines in its colour."""
    signals, edges = frame.signals, frame.complex_.edges
    rows = np.flatnonzero(signals.edge_ok & keep[edges].all(axis=1))
    if not len(rows):
        return None
    rows = rows[:: _step(int(keep[edges].all(axis=1).sum()), MAX_EDGES)]
    ends = upright(frame.cloud.xyz[edges[rows].ravel()]).reshape(-1, 2, 3)
    x, y, z = ([c for a, b in ends[:, :, axis].tolist() for c in (a, b, None)] for axis in range(3))
    values = np.repeat(one_channel(signals.edge)[rows], 3).astype(np.float32)
    line = {"color": values, "colorscale": "Viridis", "cmin": 0.0, "cmax": 1.0, "width": 3}
    line |= {"colorbar": colour_bar(LUMINANCE, 0.0, 1.0)}
    return View("Edge signal", (go.Scatter3d(x=x, y=y, z=z, mode="lines", line=line, hoverinfo="skip"),))
