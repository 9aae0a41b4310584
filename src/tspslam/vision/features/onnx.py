"""Keypoints of a learnt network: an ONNX file, run by OpenCV."""

from __future__ import annotations

import functools
import hashlib
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._files import one_line, open_input, read_bytes
from ..._settings import Checked, copy_setting, setting
from ...errors import InputError
from ...types import Features
from ._onnx_probe import load_network, run_network, trouble_of
from .orb import OrbDetector
from .spread import check_plane, choose_evenly, no_features

_EXPECTED = "an ONNX network from an image (1, 1, H, W) to scores (1, 1, H, W) and descriptors (1, D, h, w)"
_running = threading.Lock()  # a network holds its own buffers, and a pair is detected in two threads
_STEP = 8  # px: sides are padded to a multiple, as networks with pooling need


@dataclass(frozen=True)
class OnnxDetector(Checked, what="onnx"):
    """A network as detector: from a grey image (1, 1, H, W) in [0, 1] to scores and dense descriptors.

    Its two outputs, in either order, are keypoint scores (1, 1, H, W) or (1, H, W), larger is better, and descriptors
    (1, D, h, w) with D > 1, which are sampled at the keypoints and made of unit length. Peaks of the scores are
    keypoints. A file is first loaded and run in a process of its own, once for each size of image; one that crashes
    there or keeps its weights in other files is refused. Anything else is a function of your own: grey image (H, W)
    uint8 -> `Features`.

    Attributes
    ----------
    path : str
        The ONNX file.
    count : int
        Keypoints wanted.
    threshold : float
        Least score.
    radius : int
        A peak is the largest score within this distance, px.
    per_cell : float
        Keypoints a cell of the image holds in the mean; smaller spreads more evenly.
    spacing : float
        Least distance of two keypoints, as a share of sqrt(H W / count), the distance in a regular grid.

    Raises
    ------
    InputError
        If a setting is out of its range, or, when it is called, the file is no such network.

    Examples
    --------
    >>> from tspslam import Settings
    >>> Settings(detector=OnnxDetector("superpoint.onnx", count=1000)).detector.threshold
    0.005
    """

    path: str = setting("", unit="", source="none: yours")
    count: int = copy_setting(OrbDetector, "count")
    threshold: float = setting(
        0.005, 0.0, 1e9, unit="score", source="SuperPoint's as SuperGlue's authors run it (Sarlin et al. 2020)"
    )
    radius: int = setting(4, 1, 100, unit="px", source="SuperPoint's demo (DeTone et al. 2018)")
    per_cell: float = copy_setting(OrbDetector, "per_cell")
    spacing: float = copy_setting(OrbDetector, "spacing")

    @property
    def fingerprint(self) -> str:
        """SHA-256 of the file, hexadecimal: what a result depends on besides the settings."""
        with open_input(self.path or "detector.path", _EXPECTED) as handle:
            return hashlib.sha256(handle.read()).hexdigest()

    def __call__(self, grey: NDArray[np.uint8]) -> Features:
        """Detect keypoints in an (H, W) uint8 image."""
        check_plane("onnx", grey)
        scores, dense = self._run(grey)
        uv = _peaks(scores, self.radius, self.threshold)
        strength = scores[uv[:, 1], uv[:, 0]]
        rows = choose_evenly(
            uv.astype(np.float64), strength, grey.shape, self.count, per_cell=self.per_cell, spacing=self.spacing
        )
        if len(rows) == 0:
            return no_features(dense.shape[0], np.float32)
        places = uv[rows].astype(np.float64)
        ones = np.ones(len(rows), np.float32)
        return Features(places, _sampled(dense, places, grey.shape), strength[rows], ones, 0 * ones)

    def _run(self, grey: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Scores (H, W) and descriptors (D, h, w) of the padded image."""
        import cv2

        height, width = grey.shape
        padded = np.pad(grey, [(0, -side % _STEP) for side in grey.shape], mode="edge")
        try:
            with _running:
                outputs = run_network(_load(self.path, padded.shape), padded)
        except cv2.error as error:
            reason = one_line(str(error))[-120:]
            raise InputError(f"{self.path}: cannot be run ({reason}), expected {_EXPECTED}") from error
        scores = [each.reshape(padded.shape) for each in outputs if each.size == padded.size]
        dense = [each[0] for each in outputs if each.ndim == 4 and each.shape[1] > 1]
        if len(outputs) != 2 or len(scores) != 1 or len(dense) != 1:
            shapes = [each.shape for each in outputs]
            raise InputError(f"{self.path}: gives {shapes} for an image {padded.shape}, expected {_EXPECTED}")
        if not (np.isfinite(scores[0]).all() and np.isfinite(dense[0]).all()):
            raise InputError(f"{self.path}: gives values that are not finite, expected finite scores and descriptors")
        return scores[0][:height, :width].astype(np.float32), dense[0].astype(np.float32)


@functools.lru_cache(maxsize=4)
def _load_version(path: str, version: tuple[int, int], shape: tuple[int, ...]) -> tuple[Any, str]:
    """The network, or what is wrong with it, of one version of a file, tried out on images of that shape."""
    model = read_bytes(path, _EXPECTED)
    trouble = trouble_of(model, shape)
    return (None, trouble) if trouble else (load_network(model), "")


def _load(path: str, shape: tuple[int, ...]) -> Any:
    """The network of a file; read again when the file has changed, tried out again for images of another shape."""
    with open_input(path or "detector.path", _EXPECTED):
        status = Path(path).stat()
    net, trouble = _load_version(path, (status.st_mtime_ns, status.st_size), shape)
    if trouble:
        raise InputError(f"{path}: {trouble}, expected {_EXPECTED}")
    return net


def _peaks(scores: NDArray[np.float32], radius: int, threshold: float) -> NDArray[np.int64]:
    """Pixels (u, v) with the largest score around them."""
    import cv2

    around = cv2.dilate(scores, np.ones((2 * radius + 1, 2 * radius + 1), np.uint8))
    row, column = np.nonzero((scores == around) & (scores > threshold))
    return np.column_stack([column, row])


def _sampled(dense: NDArray[np.float32], uv: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Unit descriptors (N, D) at pixels of an image of that shape, bilinear between the cells' centres."""
    import cv2

    sides = [side + -side % _STEP for side in shape]
    scale = np.array([dense.shape[2] / sides[1], dense.shape[1] / sides[0]])
    u, v = ((uv + 0.5) * scale - 0.5).astype(np.float32).T
    planes = [
        cv2.remap(plane, u[None], v[None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)[0] for plane in dense
    ]
    found = np.stack(planes, axis=1)
    return found / np.maximum(np.linalg.norm(found, axis=1, keepdims=True), np.float32(1e-12))
