"""Work of the topology wing's kernels as executed lines: ``python -m tests.counted`` prints them as JSON.

The kernels run as plain Python there, so that each line that runs can be counted: the same on every machine. To import
this file changes nothing.
"""

import collections
import json
import sys
import warnings


def compile_nothing():
    """Make kernels plain functions; before any is imported."""
    from tspslam import _jit

    _jit.kernel = _jit.reassociated_kernel = _jit.inlined = lambda function: function
    _jit.prefetch = lambda *_: None
    warnings.simplefilter("ignore")  # of unsigned numbers that wrap around, as they do in the compiled kernels


def lines(job):
    """How many lines of each kernel a job runs."""
    from tspslam.topology import _bank, _harmonics, _kernels, _locality, _pixels, _stars

    kernels = {module.__file__ for module in (_bank, _harmonics, _kernels, _locality, _pixels, _stars)}
    found = collections.Counter()

    def line(frame, event, _):
        found[frame.f_code.co_name] += event == "line"
        return line

    sys.settrace(lambda frame, *_: line if frame.f_code.co_filename in kernels else None)
    try:
        job()
    finally:
        sys.settrace(None)
    return dict(found)


def counts(n, scale=1):
    """Lines of each step on a random mesh of n vertices, on an image with so many times the pixels along a side."""
    import numpy as np
    from scipy.spatial import Delaunay

    import tspslam

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
    compile_nothing()
    print(json.dumps({"small": counts(200), "large": counts(800), "fine": counts(200, scale=4)}))
