"""What other values of a setting do to the cloud of Motorcycle: the figures that sources of defaults name.

``python -m benchmarks.settings`` halves and doubles every number of the detectors and matchers;
``python -m benchmarks.settings detector.count=500 matcher.kind=sgbm`` tries what is given, each by itself.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

import tspslam
from tspslam.run.config import resolve
from tspslam.settings import KINDS


def score(pair: tspslam.StereoPair, truth: np.ndarray, assignments: list[str]) -> str:
    """Points, and how many of those with a true disparity have it to 1 px."""
    try:
        settings = resolve(assignments=assignments).settings
        cloud = tspslam.reconstruct(pair, detector=settings.detector, matcher=settings.matcher)
    except tspslam.TspSlamError as error:
        return str(error)
    column, row = np.floor(cloud.uv + 0.5).astype(int).T
    error_px = np.abs(cloud.disparity - truth[row, column])
    error_px = error_px[np.isfinite(error_px)]
    return f"{len(cloud):5} points, {(error_px <= 1).mean():6.1%} right to 1 px, median {np.median(error_px):.3f} px"


def trials() -> Iterator[list[str]]:
    """Each kind of detector and matcher as it is, then with each of its numbers halved and doubled."""
    for row in tspslam.list_settings():
        stage = row.name.split(".")[0]
        if stage not in ("detector", "matcher") or row.kind == "onnx":
            continue
        if not row.kind:
            yield from ([f"{stage}.kind={kind}"] for kind in KINDS[stage] if kind != "onnx")
        elif isinstance(row.default, int | float):
            for value in (type(row.default)(row.default / 2), type(row.default)(row.default * 2)):
                yield [f"{stage}.kind={row.kind}", f"{row.name}={value}"]


def main() -> None:
    pair, truth = tspslam.datasets.motorcycle(), tspslam.datasets.motorcycle_truth()
    given = [[assignment] for assignment in sys.argv[1:]]
    for assignments in given or [[], *trials()]:
        print(f"{' '.join(assignments) or 'defaults':<60}  {score(pair, truth, assignments)}")


if __name__ == "__main__":
    main()
