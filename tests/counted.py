# ruff: noqa: E402
"""Work of the topology wing's kernels as executed lines: ``python -m tests.counted`` prints them as JSON.

The kernels run as plain Python here, so that each line that runs can be counted: the same on every machine.
"""

import collections
import json
import sys
import warnings

from tspslam import _jit

_jit.kernel = _jit.reassociated_kernel = _jit.inlined = lambda function: function
_jit.prefetch = lambda *_: None

import numpy as np
from scipy.spatial import Delaunay

import tspslam
from tspslam.topology import _bank, _harmonics, _kernels, _locality, _pixels

warnings.simplefilter("ignore")  # of unsigned numbers that wrap around, as they do in the compiled kernels
KERNELS = {module.__file__ for module in (_bank, _harmonics, _kernels, _locality, _pixels)}


def lines(job):
    """How many lines of each kernel a job runs."""
    found = collections.Counter()

    def line(frame, event, _):
        found[frame.f_code.co_name] += event == "line"
        return line

    sys.settrace(lambda frame, *_: line if frame.f_code.co_filename in KERNELS else None)
    try:
        job()
    finally:
        sys.settrace(None)
    return dict(found)


def counts(n, scale=1):
    """Lines of each step on a random mesh of n vertices, on an image with so many times the pixels along a side."""
    rng = np.random.default_rng(0)
    uv, image = rng.random((n, 2)) * (63, 47), rng.integers(0, 256, (48, 64), np.uint8)
    faces = Delaunay(uv).simplices.astype(np.int32)
    uv, image = uv * scale, np.kron(image, np.ones((scale, scale), np.uint8))
    complex_ = tspslam.build_complex(faces, n)
    rows = int(sum(matrix.nnz for matrix in complex_.neighbours()))
    signals = tspslam.sample_signals(image, uv, complex_)
    return {
        "neighbours": rows,
        "construction": lines(lambda: tspslam.build_complex(faces, n).neighbours()),
        "signals": lines(lambda: tspslam.sample_signals(image, uv, complex_)),
        "none": lines(lambda: tspslam.tmahf(complex_, uv, signals, centering="none")),
        "harmonic": lines(lambda: tspslam.tmahf(complex_, uv, signals, centering="harmonic")),
        "bank": lines(lambda: tspslam.tmahf_bank(complex_, uv, signals, (1, 2, 3, 4))),
    }


if __name__ == "__main__":
    print(json.dumps({"small": counts(200), "large": counts(800), "fine": counts(200, scale=4)}))
