"""Counts of a store are those of the whole mesh."""

import numpy as np
import pytest

from tspslam.scale import write_store
from tspslam.scale.stores.counting import count_store
from tspslam.scale.stores.sources import of_arrays
from tspslam.topology.diagnosis import diagnose_surface

from .meshes import tangled


@pytest.mark.parametrize("chunk", [1, 7, 1000])
def test_counts_by_chunks_are_those_of_the_whole(tmp_path, chunk):
    one, other = tangled(31, 30), tangled(32, 25)
    xyz = np.concatenate([one[0], other[0]])
    faces = np.concatenate([one[1], other[1] + 30])
    counts = count_store(write_store(tmp_path / "a.zarr", of_arrays(xyz, faces), chunk=chunk).mesh)
    whole = diagnose_surface(faces, xyz)
    for name in ("boundary_edges", "nonmanifold_edges", "components", "euler"):
        assert getattr(counts, name) == getattr(whole, name)
    assert (counts.edges, counts.used) == (whole.n_edges, len(xyz) - len(whole.unused))
    assert counts.components == 2
    assert counts.nonmanifold_edges > 0


def test_a_torus_in_chunks_has_no_border_and_euler_0(tmp_path):
    k = 12
    i, j = np.mgrid[0:k, 0:k].reshape(2, -1)
    at = lambda a, b: (a % k) * k + b % k  # noqa: E731
    faces = np.concatenate([np.stack([at(i, j), at(i + 1, j), at(i, j + 1)], axis=1),
                            np.stack([at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], axis=1)])  # fmt: skip
    u, v = 2 * np.pi * i / k, 2 * np.pi * j / k
    xyz = np.stack([(2 + np.cos(v)) * np.cos(u), (2 + np.cos(v)) * np.sin(u), np.sin(v)], axis=1)
    counts = count_store(write_store(tmp_path / "a.zarr", of_arrays(xyz, faces), chunk=10).mesh)
    assert (counts.euler, counts.boundary_edges, counts.nonmanifold_edges, counts.components) == (0, 0, 0, 1)
