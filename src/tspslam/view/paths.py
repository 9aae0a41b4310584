"""A picture of a camera path beside the true one."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, Protocol

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from .._atomic import write_bytes
from .._files import bad_input
from ..types import BoolArray, FloatArray

_TRUE, _ESTIMATED = "#1b2430", "#d55e00"
_MIRRORED = {(2, 0), (0, 1), (2, 1)}  # axes (along, upwards) that show the world from below, or y, which is down, up
_INK, _SIZES = 8000.0, (0.4, 6.0)  # pt² of all points together; of one: few are seen, many are no blot
_SHARE = 0.9  # of a map's points that its picture shows: those far off are the least certain
# What a picture says of its making: nothing that varies with the day or the machine.
_METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"Creator": None, "Producer": None, "CreationDate": None},
    ".svg": {"Creator": None, "Date": None},
}


class PathErrors(Protocol):
    """What the picture needs of the errors of a path."""

    @property
    def estimate(self) -> FloatArray:
        """(M, 3) estimated positions, laid on the true ones, m."""

    @property
    def reference(self) -> FloatArray:
        """(M, 3) true positions, m."""

    @property
    def ate_m(self) -> FloatArray:
        """(M,) distances between them, m."""

    @property
    def ate_rmse_m(self) -> float:
        """Their root mean square, m."""


def write_path_picture(errors: PathErrors, path: str | Path) -> None:
    """Draw both paths from the side that shows most of them, and the error along the true one.

    Parameters
    ----------
    errors : TrajectoryErrors
        What `tspslam.evaluate_trajectory` gives.
    path : str or path
        The file to write: PNG, PDF or SVG, as its suffix says.

    Raises
    ------
    InputError
        If the suffix is another.
    OutputError
        If it cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in _METADATA:
        raise bad_input(path, f"has the suffix {suffix!r}", " or ".join(_METADATA))
    figure = Figure(figsize=(11, 4.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    plan, along = figure.subplots(1, 2)
    _draw_plan(plan, errors)
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(errors.reference, axis=0), axis=1))])
    along.plot(travelled, errors.ate_m, color=_ESTIMATED)
    along.axhline(errors.ate_rmse_m, color=_TRUE, lw=0.8, ls="--", label=f"root mean square: {errors.ate_rmse_m:.3g} m")
    along.set(xlabel="along the true path, m", ylabel="error of position, m", ylim=(0, None))
    along.legend()
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "tspslam"}):  # else its names of parts are random
        figure.savefig(buffer, format=suffix[1:], metadata=_METADATA[suffix])
    write_bytes(path, buffer.getvalue())


def write_plan_picture(positions: FloatArray, xyz: FloatArray, path: str | Path) -> None:
    """Draw a camera's whole path and the points beside it, over its longest axis and the widest other, as PNG.

    Parameters
    ----------
    positions : (T, 3) float64
        Of the camera, m.
    xyz : (N, 3) float64
        Points, m; the nine tenths that are nearest to the path are in the picture (`beside_path`).
    path : str or path
        The file to write.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    buffer = io.BytesIO()
    _plan_picture(positions, xyz).savefig(buffer, format="png", metadata={"Software": None})
    write_bytes(path, buffer.getvalue())


def _plan_picture(positions: FloatArray, xyz: FloatArray) -> Figure:
    """The picture that `write_plan_picture` writes, seen from above where the path is level."""
    figure = Figure(figsize=(10, 6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    near = xyz[beside_path(positions, xyz)]
    a = int(np.argmax(np.ptp(positions, axis=0)))
    spread = near.std(axis=0) if len(near) else np.ptp(positions, axis=0)
    b = max((axis for axis in range(3) if axis != a), key=lambda axis: float(spread[axis]))
    size = float(np.clip(_INK / max(len(near), 1), *_SIZES))
    ax.scatter(near[:, a], near[:, b], s=size, c="#8a94a0", linewidths=0, rasterized=True, label="points of keyframes")
    ax.plot(positions[:, a], positions[:, b], color=_ESTIMATED, lw=1.6, label="camera")
    ax.plot(*positions[0, [a, b]], "o", color=_TRUE, ms=5, label="start")
    ax.plot(*positions[-1, [a, b]], "s", color=_ESTIMATED, ms=5, label="end")
    ax.set(xlabel=f"{'xyz'[a]}, m", ylabel=f"{'xyz'[b]}, m", title="Camera path and map")
    ax.set_aspect("equal", adjustable="datalim")
    if (a, b) in _MIRRORED:
        ax.invert_yaxis()
    dot: Any = ax.legend(markerscale=1.5).legend_handles[0]
    dot.set_sizes(_SIZES[1:])
    return figure


def beside_path(positions: FloatArray, xyz: FloatArray) -> BoolArray:
    """Mark the nine tenths of points that are nearest to a path, wherever along it they are.

    Parameters
    ----------
    positions : (T, 3) float64
        Of the camera, m.
    xyz : (N, 3) float64
        Points, m.

    Returns
    -------
    (N,) bool

    Examples
    --------
    >>> street = np.stack([np.zeros(11), np.zeros(11), np.arange(11) * 10.0], axis=1)
    >>> beside = street + (4.0, 0.0, 0.0)
    >>> beside_path(street, np.vstack([beside, [[500.0, 0.0, 50.0]]])).tolist() == [True] * 11 + [False]
    True
    """
    from scipy.spatial import cKDTree

    if not len(xyz):
        return np.zeros(0, bool)
    away, _ = cKDTree(positions).query(xyz)
    return np.asarray(away <= np.quantile(away, _SHARE))


def _draw_plan(ax: Axes, errors: PathErrors) -> None:
    """Both paths over the two axes of space along which the true one is longest."""
    a, b = sorted(np.argsort(-np.ptp(errors.reference, axis=0), kind="stable")[:2].tolist())
    for positions, colour, label in ((errors.reference, _TRUE, "true"), (errors.estimate, _ESTIMATED, "estimated")):
        ax.plot(positions[:, a], positions[:, b], color=colour, lw=1.4, label=label)
    ax.plot(*errors.reference[0, [a, b]], "o", color=_TRUE, ms=5, label="start")
    ax.set(xlabel=f"{'xyz'[a]}, m", ylabel=f"{'xyz'[b]}, m")
    ax.set_aspect("equal", adjustable="datalim")
    ax.legend()
