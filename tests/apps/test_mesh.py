import numpy as np
import pytest

from tspslam import InputError
from tspslam.apps.mesh import denoise_mesh


def test_a_noise_free_plane_stays():
    i, j = np.divmod(np.arange(100), 10)
    flat = np.column_stack([i, j, 0 * i]).astype(float)
    here = np.flatnonzero((i < 9) & (j < 9))
    faces = np.concatenate([np.stack([here, here + 10, here + 11], 1), np.stack([here, here + 11, here + 1], 1)])
    assert np.abs(denoise_mesh(flat, faces) - flat).max() < 1e-9


def test_points_that_are_not_finite_are_refused():
    with pytest.raises(InputError, match="at vertex 1, expected finite"):
        denoise_mesh([[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]], [[0, 1, 2]])
