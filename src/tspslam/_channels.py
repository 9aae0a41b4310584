"""Numbers that pictures and files show of a signal or a response."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def phase_of(z: NDArray[np.complex128]) -> NDArray[np.float64]:
    """``arg z`` in (-π, π], rad, same shape as z: -π is mapped to π."""
    angle = np.angle(z)
    return np.where(angle == -np.pi, np.pi, angle)


def one_channel(values: NDArray[Any]) -> NDArray[Any]:
    """Mean over the channels of an (n,) or (n, C) signal or response, (n,)."""
    return values if values.ndim == 1 else values.mean(axis=1)
