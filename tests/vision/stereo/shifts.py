"""Pairs of real texture with a known fraction of a pixel between them."""

from __future__ import annotations

import numpy as np

from tspslam.types import Rig, StereoPair

_PAD = 64


def shifted_left(image: np.ndarray, shift: float) -> np.ndarray:
    """Image whose content moved left by `shift` px, by the Fourier shift theorem; edges are mirrored."""
    padded = np.pad(image.astype(np.float64), ((0, 0), (_PAD, _PAD)), mode="reflect")
    frequency = np.fft.rfftfreq(padded.shape[1])
    moved = np.fft.rfft(padded, axis=1) * np.exp(2j * np.pi * frequency * shift)
    return np.fft.irfft(moved, padded.shape[1], axis=1)[:, _PAD:-_PAD]


def pair_with_disparity(large: np.ndarray, disparity: float, *, reduce: int, rows: int = 0) -> StereoPair:
    """Pair of an image reduced by area, whose right view sees it `disparity` px further left and `rows` / reduce lower.

    The shift is made at full size, so that the reduced images hold the aliasing of a real sensor and no trace of it.
    """
    left, right = large.astype(np.float64), np.roll(shifted_left(large, disparity * reduce), rows, axis=0)
    height, width = (side // reduce for side in large.shape)
    rig = Rig(fx=500, fy=500, cx=width / 2, cy=height / 2, baseline=0.1, width=width, height=height)
    return StereoPair(_reduced(left, reduce), _reduced(right, reduce), rig, name=f"shift {disparity}")


def _reduced(image: np.ndarray, by: int) -> np.ndarray:
    height, width = (side // by for side in image.shape)
    blocks = image[: height * by, : width * by].reshape(height, by, width, by)
    return np.clip(np.rint(blocks.mean(axis=(1, 3))), 0, 255).astype(np.uint8)
