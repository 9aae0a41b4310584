from __future__ import annotations

import subprocess
import sys

import numpy as np

from tspslam.datasets import motorcycle, motorcycle_truth
from tspslam.vision.rig import check_pair


def test_motorcycle_and_its_truth_fit_together() -> None:
    pair, truth = motorcycle(), motorcycle_truth()
    check_pair(pair)
    assert pair.name == "motorcycle"
    assert truth.shape == pair.left.shape[:2]
    known = np.isfinite(truth)
    assert np.isnan(truth[~known]).all()
    v, u = np.nonzero(known)
    rows = np.random.default_rng(0).choice(len(u), 20_000, replace=False)
    v, u = v[rows], u[rows]
    right = np.rint(u - truth[v, u]).astype(int)
    seen = right >= 0
    difference = pair.left[v[seen], u[seen]].astype(int) - pair.right[v[seen], right[seen]]
    assert np.median(np.abs(difference)) < 10


def test_importing_datasets_loads_nothing_heavy() -> None:
    heavy = ("skimage", "cv2", "numba", "scipy", "PIL")
    code = f"import sys, tspslam.datasets; print([m for m in {heavy} if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"
