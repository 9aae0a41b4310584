"""How right and how fast the path of an RGB-D camera is, beside frame-to-frame odometry from OpenCV's parts.

``python -m benchmarks.rgbd [--frames N] [--data FOLDER]... [--docs docs]``. OpenCV's own RGB-D odometry is in its
contributed modules, which the wheel does not have. The room is rendered with the noise of each sensor; times are
medians over frames, in one run.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tests.datasets.rgbd_folders import Noise, room, write_tum_folder
from tspslam import StereoOdometry, StereoPair, Trajectory, evaluate_trajectory
from tspslam.datasets import RgbdSequence
from tspslam.types import FloatArray
from tspslam.vision.depth.sensor import SENSORS

from .naive import Naive

NOISES: tuple[Noise, ...] = ("none", "structured_light", "time_of_flight")


class NaiveDepth(Naive):
    """ORB, matches to the last frame, and a pose from that frame's depths by random samples."""

    def _points(self, pair: StereoPair) -> tuple[np.ndarray, np.ndarray, FloatArray, np.ndarray]:
        keypoints, descriptors = self.orb.detectAndCompute(pair.left, None)
        uv = cv2.KeyPoint.convert(keypoints).astype(np.float64)
        u, v = np.rint(uv.T).astype(int)
        assert pair.disparity is not None
        disparity = pair.disparity[v, u]
        known = np.flatnonzero(np.isfinite(disparity))
        z = self.rig.fx * self.rig.baseline / disparity[known]
        rays = (uv[known] - (self.rig.cx, self.rig.cy)) / (self.rig.fx, self.rig.fy)
        return descriptors, uv, np.column_stack([rays, np.ones(len(z))]) * z[:, None], known


@dataclass
class Found:
    """Error of a path, m; its length, m; frames lost; median time of a frame, ms."""

    ate: float
    length: float
    lost: int
    ms: float


def sequences(frames: int, data: list[Path]) -> Iterator[tuple[str, RgbdSequence]]:
    with tempfile.TemporaryDirectory() as folder:
        for noise in NOISES:
            sensor = SENSORS["time_of_flight" if noise == "none" else noise]
            path = write_tum_folder(Path(folder) / noise, room(frames), noise)
            yield f"room, {noise.replace('_', ' ')}", RgbdSequence(path, sensor=sensor)
    for path in data:
        yield path.name, RgbdSequence(path)


def followed(sequence: RgbdSequence, process: Callable[[StereoPair], object]) -> tuple[list[object], float]:
    found, times = [], []
    for pair in sequence:
        started = time.perf_counter()
        found.append(process(pair))
        times.append(1000 * (time.perf_counter() - started))
    return found, float(np.median(times))


def scored(sequence: RgbdSequence, path: Trajectory, lost: int, ms: float) -> Found:
    truth = sequence.truth
    assert truth is not None
    known = truth[np.isfinite(truth[:, 0, 0]), :3, 3]
    length = float(np.linalg.norm(np.diff(known, axis=0), axis=1).sum())
    errors = evaluate_trajectory(path, Trajectory(sequence.stamps, truth))
    return Found(errors.ate_rmse_m, length, lost, ms)


def ours(sequence: RgbdSequence) -> Found:
    odometry = StereoOdometry(sequence.rig)
    tracked, ms = followed(sequence, odometry.process)
    odometry.finish()
    odometry.close()
    return scored(sequence, odometry.trajectory, sum(each.is_lost for each in tracked), ms)  # type: ignore[attr-defined]


def naive(sequence: RgbdSequence) -> Found:
    poses, ms = followed(sequence, NaiveDepth(sequence.rig).process)
    return scored(sequence, Trajectory(sequence.stamps, np.array(poses)), 0, ms)


def table(rows: list[tuple[str, Found, Found]]) -> str:
    lines = [
        ".. list-table::",
        "   :header-rows: 1",
        "",
        "   * - recording",
        "     - path, m",
        "     - error, mm (share)",
        "     - frame-to-frame, mm",
        "     - ratio of times",
    ]
    for name, one, other in rows:
        lines += [
            f"   * - {name}",
            f"     - {one.length:.1f}",
            f"     - {1000 * one.ate:.1f} ({100 * one.ate / one.length:.2f} %)",
            f"     - {1000 * other.ate:.1f}",
            f"     - {one.ms / other.ms:.2f}",
        ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--data", type=Path, action="append", default=[])
    parser.add_argument("--docs", type=Path)
    given = parser.parse_args()
    rows = []
    for name, sequence in sequences(given.frames, given.data):
        ours(sequence) if not rows else None  # kernels are compiled and warm
        rows.append((name, ours(sequence), naive(sequence)))
        print(name, *rows[-1][1:], flush=True)
    print(said := table(rows))
    if given.docs:
        head = (
            f"A walk through a synthetic room, {given.frames} frames of 320 x 240 px (``python -m benchmarks.rgbd``): "
            "error of the path (ATE),\nours and of frame-to-frame PnP on ORB (OpenCV's parts), and how much longer a "
            "frame takes than there.\n\n"
        )
        (given.docs / "rgbd_numbers.inc").write_text(head + said)


if __name__ == "__main__":
    main()
