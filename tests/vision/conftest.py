"""Scenes that the vision tests share."""

from __future__ import annotations

import numpy as np
import pytest

from tspslam.datasets import motorcycle
from tspslam.types import Rig, StereoPair


@pytest.fixture(scope="session")
def pair() -> StereoPair:
    return motorcycle()


@pytest.fixture
def rig() -> Rig:
    return Rig(fx=500, fy=480, cx=320.5, cy=239, baseline=0.1, width=640, height=480, skew=1.5, doffs=2.0)


@pytest.fixture
def plain_rig() -> Rig:
    return Rig(fx=500, fy=500, cx=80, cy=60, baseline=0.1, width=160, height=120)


def noise(height: int = 120, width: int = 160, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width), np.uint8)
