"""What must stay fast does little work: counted, since times hang on the machine. Ratios of times: `make bench`."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tspslam
from tspslam.topology import solvers
from tspslam.topology.spectral import _half_bound, heat_series
from tspslam.vision import images
from tspslam.vision.slam import odometry

from .sequences import DETECTOR, RIG, corridor

ROOT = Path(__file__).parents[1]
LINES_OF_APPEND = 4  # in `_harmonics._append`, which takes one element to a vertex


@pytest.fixture(scope="module")
def work():
    done = subprocess.run([sys.executable, "-m", "tests.counted"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize(
    ("step", "most"), [("construction", 520), ("signals", 600), ("none", 1100), ("harmonic", 800), ("bank", 2800)]
)
def test_work_for_a_vertex_does_not_grow_with_the_mesh(work, step, most):
    """Lines of kernels for a vertex. Measured: 444, 513, 485, 665 and 2340; quadratic work would be fourfold.

    Construction in one bucket took 328, and twice the time for a large mesh in random order: lines are not memory.
    """
    small, large = (sum(work[mesh][step].values()) / n for mesh, n in (("small", 200), ("large", 800)))
    assert large < 1.1 * small
    assert max(small, large) < most


@pytest.mark.parametrize("step", ["harmonic", "bank"])
def test_a_filter_and_a_bank_of_four_take_each_neighbour_once(work, step):
    assert work["large"][step]["_append"] == LINES_OF_APPEND * work["large"]["neighbours"]


def test_four_responses_share_their_neighbourhoods(work):
    bank, one = (sum(work["large"][step].values()) for step in ("bank", "harmonic"))
    assert bank < 3.6 * one


def test_the_cost_of_a_face_is_its_height_not_its_area(work):
    """Sixteen times the pixels, four times the lines; only the sums along rows go over each pixel."""
    fine, plain = dict(work["fine"]["signals"]), dict(work["small"]["signals"])
    assert fine.pop("prefix_sums") < 17 * plain.pop("prefix_sums")
    assert sum(fine.values()) < 4 * sum(plain.values())


def calls(job):
    """Python functions that a job enters."""
    entered = 0

    def note(_frame, event, _argument):
        nonlocal entered
        entered += event == "call"

    sys.setprofile(note)
    try:
        job()
    finally:
        sys.setprofile(None)
    return entered


def strip(n):
    """Triangles between two rows of vertices."""
    k = np.arange(n - 2)
    return np.column_stack([k, k + 1, k + 2])


def test_construction_makes_no_object_a_simplex():
    """It enters as many functions for a hundred times the mesh."""

    def made(n):
        complex_ = tspslam.build_complex(strip(n), n)
        return complex_.B1, complex_.B2, complex_.L0, complex_.L1

    made(50)
    assert abs(calls(lambda: made(10_000)) - calls(lambda: made(100))) < 50


def test_heat_takes_some_tens_of_products():
    """43 terms where SciPy's exponential takes 219 products, at t = 10 on this mesh."""
    half = _half_bound(tspslam.build_complex(strip(500), 500).L0)
    assert len(heat_series(half, 10.0, 1e-10)) < 100


def test_a_decomposition_with_few_cycles_factors_one_laplacian_once(monkeypatch):
    prepared, prepare = [], solvers.Solver.prepare
    monkeypatch.setattr(solvers.Solver, "prepare", lambda L, *rest: (prepared.append(L.shape), prepare(L, *rest))[1])
    complex_ = tspslam.build_complex(strip(300), 300)
    for seed in range(3):
        tspslam.hodge_decompose(complex_, np.random.default_rng(seed).normal(size=len(complex_.edges)))
    assert prepared == [(300, 300)]


def test_a_frame_that_is_followed_is_not_searched_for_keypoints(monkeypatch):
    """Both images of a keyframe are, and the second frame, whose motion nobody knows. Each image is made grey levels of once, each left one a pyramid."""
    detected, pyramids, greys, halved, levels = [], [], [], images._halved, images.luminance_levels
    monkeypatch.setattr(images, "_halved", lambda *given: (pyramids.append(1), halved(*given))[1])
    monkeypatch.setattr(images, "luminance_levels", lambda *given: (greys.append(1), levels(*given))[1])
    ours = odometry.StereoOdometry(RIG, detector=lambda grey: (detected.append(1), DETECTOR(grey))[1])
    walk = corridor(6.0)
    tracked = [ours.process(pair) for pair in walk]
    keyframes = sum(one.is_keyframe for one in tracked)
    assert 0 < keyframes < len(walk)
    assert len(detected) == 2 * keyframes + 1
    assert len(pyramids) == len(walk)
    assert len(greys) <= 2 * len(walk)


@pytest.mark.parametrize("job", ["import tspslam", "--help"])
def test_help_and_import_load_no_package_of_numbers_or_pictures(job):
    code = (
        job
        if job.startswith("import")
        else "import sys; sys.argv = ['tspslam', '--help']; import runpy\n"
        + ("try: runpy.run_module('tspslam', run_name='__main__')\nexcept SystemExit: pass")
    )
    code += "\nimport sys; print('loaded', *{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split("loaded ")[1].split())
    heavy = {"numpy", "scipy", "numba", "llvmlite", "cv2", "PIL", "skimage", "matplotlib", "yaml"}
    assert "tspslam" in loaded
    assert not loaded & heavy
