"""The synthetic scanner: points lie on the shapes, on their beams, and nothing is before them."""

import numpy as np
import pytest

from tspslam import InputError
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.scanner import AXES

SCANNER = synthetic.Scanner(beams=12, columns=90, lowest=-60, highest=50)


def test_each_beam_meets_the_nearest_triangle():
    """Against a plain intersection of every beam with every triangle."""
    scene = synthetic.room(frames=8)
    pose = scene.path[2] @ AXES
    found = synthetic.scan(scene, pose, SCANNER)
    beams = np.linalg.norm(found.xyz, axis=1)
    assert len(beams) == 12 * 90  # a room is closed
    corners = np.concatenate([shape.world_vertices()[shape.faces] for shape in scene.shapes])
    ends = found.xyz @ pose[:3, :3].T + pose[:3, 3]
    rng = np.random.default_rng(0)
    for k in rng.choice(len(beams), 40, replace=False):
        ray = ends[k] - pose[:3, 3]
        a, p, q = corners[:, 0] - pose[:3, 3], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        h = np.cross(ray, q)
        with np.errstate(divide="ignore", invalid="ignore"):
            det = np.einsum("fi,fi->f", p, h)
            u = np.einsum("fi,fi->f", -a, h) / det
            w = np.cross(-a, p)
            v, t = w @ ray / det, np.einsum("fi,fi->f", q, w) / det
            t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))] = np.inf
        assert t.min() == pytest.approx(1.0, abs=1e-6)


def test_points_stand_ring_by_ring_on_their_beams():
    found = synthetic.scan(synthetic.Scene((synthetic.sphere(7.0, rows=200),)), AXES, SCANNER)
    assert (np.diff(found.ring) >= 0).all()
    elevation = np.degrees(np.arcsin(found.xyz[:, 2] / np.linalg.norm(found.xyz, axis=1)))
    np.testing.assert_allclose(elevation, np.linspace(50, -60, 12)[found.ring], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.xyz, axis=1), 7.0, rtol=1e-3)


def test_noise_is_along_the_beams_and_hangs_on_the_seed():
    wall = synthetic.Scene((synthetic.plane(30, 30).at(0, 0, 5),))
    still, noisy, again, other = (
        synthetic.scan(wall, AXES, synthetic.Scanner(beams=12, columns=900, noise=noise), seed=seed).xyz
        for noise, seed in ((0.0, 0), (0.05, 0), (0.05, 0), (0.05, 1))
    )
    np.testing.assert_array_equal(noisy, again)
    assert (noisy != other).any()
    off = np.linalg.norm(noisy, axis=1) - np.linalg.norm(still, axis=1)
    assert np.std(off) == pytest.approx(0.05, rel=0.1)
    np.testing.assert_allclose(np.cross(noisy, still), 0, atol=1e-9)


def test_what_is_too_far_sends_nothing_back():
    wall = synthetic.Scene((synthetic.plane(30, 30).at(0, 0, 5),))
    assert not len(synthetic.scan(wall, AXES, synthetic.Scanner(beams=12, columns=90, farthest=4.9)).xyz)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (lambda wall: synthetic.scan(None, AXES), "scan: scene is None"),
        (lambda wall: synthetic.scan(wall, 2 * AXES), "scan: T_world_scan is off a rigid motion"),
        (lambda wall: synthetic.scan(wall, AXES, 3), "scan: scanner is 3"),
        (lambda wall: synthetic.Scanner(beams=0), "scanner: beams is 0"),
    ],
)
def test_bad_input_is_refused(given, said):
    with pytest.raises(InputError, match=said):
        given(synthetic.Scene((synthetic.plane(1, 1).at(0, 0, 5),)))
