"""The offset of all disparities: what windows say of it, weighed."""

import numpy as np
import pytest

from tspslam.vision.slam.disparity_bias import DisparityBias


def test_the_offset_is_the_weighed_mean_of_the_windows():
    offset = DisparityBias(0.3, window=4)
    assert (offset.value, offset.std) == (0.0, pytest.approx(0.3))
    rng = np.random.default_rng(0)
    for _ in range(400):
        measured = 0.2 + rng.normal(0, 0.05)
        information = 0.05**-2 + 0.3**-2  # a window begins at the same 0 ± 0.3
        offset.update(measured * 0.05**-2 / information, information**-0.5)
    assert offset.value == pytest.approx(0.2, abs=0.01)
    assert offset.std == pytest.approx(0.05 * (4 / 400) ** 0.5, rel=0.05)
    offset.update(5.0, 0.3)  # a window that saw nothing
    assert offset.value == pytest.approx(0.2, abs=0.01)
