"""Calibration by a board beside OpenCV's own functions, on the same corners, without and with two bad views."""

from __future__ import annotations

import cv2
import numpy as np

from tests.vision.calibration.boards import BASELINE, CHESSBOARD, SIZE, exact_views
from tspslam.vision.calibration.board import BoardView, calibrate

NOISE = 0.1  # px


def measure(trials: int = 5) -> dict[str, dict[str, float]]:
    """Root mean square errors, in percent, of the focal length and the baseline."""
    moved = np.eye(4)
    moved[0, 3] = 0.01
    found = {}
    for name, motions in (("good views", {}), ("two bad views", {3: moved, 9: np.linalg.inv(moved)})):
        views = [exact_views(noise=NOISE, count=14, seed=seed, moved=motions) for seed in range(trials)]
        for kind, way in (("ours", ours), ("OpenCV", plain)):
            errors = np.array([way(each) for each in views]) / (530, BASELINE) - 1
            focal, baseline = 100 * np.sqrt(np.mean(errors**2, axis=0))
            found[f"{name}, {kind}"] = {"focal_percent": float(focal), "baseline_percent": float(baseline)}
    return found


def ours(views: list[BoardView]) -> tuple[float, float]:
    calibration = calibrate(CHESSBOARD, views)
    return calibration.rig.left.fx, calibration.baseline


def plain(views: list[BoardView]) -> tuple[float, float]:
    """``calibrateCamera`` of each side, then ``stereoCalibrate`` with their numbers held."""
    xyz = [CHESSBOARD.corners.astype(np.float32)] * len(views)
    sides = [[getattr(view, side).uv.astype(np.float32) for view in views] for side in ("left", "right")]
    lenses = [cv2.calibrateCamera(xyz, uv, SIZE, None, None, flags=cv2.CALIB_FIX_K3)[1:3] for uv in sides]
    made = cv2.stereoCalibrate(xyz, *sides, *lenses[0], *lenses[1], SIZE, flags=cv2.CALIB_FIX_INTRINSIC)
    return float(lenses[0][0][0, 0]), float(np.linalg.norm(made[6]))


if __name__ == "__main__":
    for row, numbers in measure().items():
        print(f"{row:<24}", "  ".join(f"{key} {value:.4f}" for key, value in numbers.items()))
