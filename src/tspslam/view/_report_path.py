"""A run's path beside the true one: figures, and the error along the way."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..types import FloatArray
from ._html import shown_value, tiles
from ._report_chart import chart
from ._report_parts import PathErrors

FIGURES = {
    "ate_rmse_m": "error of position (ATE), m",
    "ate_sim3_rmse_m": "ATE with the scale fitted too, m",
    "rpe_translation_m_frame": "error a frame (RPE), m",
    "rpe_rotation_deg_frame": "error a frame (RPE), degrees",
    "rpe_translation_percent_10m": "error over 10 m, %",
    "rpe_rotation_deg_10m": "error over 10 m, degrees",
}


_WILD = 1e12  # of a figure that may be a stranger's


def path_section(evaluation: Mapping[str, Any] | None, errors: PathErrors | None) -> str:
    """Make the section of the true path, where it is known; else nothing."""
    if not isinstance(evaluation, Mapping) or not evaluation:
        return ""
    numbers = [(words, _rounded(evaluation.get(name))) for name, words in FIGURES.items()]
    matched, total = (shown_value(evaluation.get(name)) for name in ("matched", "total"))
    return (
        '<section aria-labelledby="truth"><h2 id="truth">Path against the truth</h2>'
        f'<p class="quiet">{matched} of {total} poses have a true one. ATE and RPE '
        "are root mean squares; the ATE is what is left after the best rigid motion of the whole path.</p>"
        f"{tiles([(name, value) for name, value in numbers if value is not None])}"
        f"{'' if errors is None else _charts(errors)}</section>"
    )


def true_path(errors: PathErrors | None) -> list[tuple[str, FloatArray]]:
    """Lay the true positions into the world of the run, for its scene."""
    if errors is None or not len(errors.reference):
        return []
    T = np.asarray(errors.T_reference_estimate)
    return [("True path", (np.asarray(errors.reference) - T[:3, 3]) @ T[:3, :3])]


def _charts(errors: PathErrors) -> str:
    """Errors over the way along the true path."""
    if len(errors.ate_m) < 3:
        return ""
    steps = np.diff(errors.reference, axis=0)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    apart = np.linalg.norm(np.diff(errors.estimate, axis=0) - steps, axis=1)
    rmse = float(np.sqrt(np.mean(np.square(errors.ate_m))))
    along = "m along the true path"
    return (
        f"{chart(way, errors.ate_m, 'Error of position after alignment', 'm', along, level=rmse)}"
        f"{chart(way[1:], apart, 'Error of the step from one pose to the next', 'm', along)}"
        '<p class="quiet">Dashed: root mean square. A step is compared as a vector, after the same alignment.</p>'
    )


def _rounded(value: Any) -> float | None:
    is_number = isinstance(value, int | float) and abs(value) < _WILD
    return float(f"{value:.3g}") if is_number else None
