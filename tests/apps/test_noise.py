"""Noise of an image is found, whatever it shows."""

import numpy as np
import pytest
from skimage import data

from tspslam import InputError
from tspslam.apps.noise import estimate_noise
from tspslam.topology.texture import luminance


@pytest.mark.parametrize("sigma", [0.05, 0.1, 0.2])
@pytest.mark.parametrize("name", ["flat", "chelsea", "brick", "coins"])
def test_noise_is_found_to_a_tenth(name, sigma):
    plane = np.full((300, 400), 0.5) if name == "flat" else luminance(getattr(data, name)())
    noise = np.random.default_rng(0).normal(0, sigma, plane.shape)
    squeezed = 0.5 + (plane - 0.5 + noise) / 4  # inside [0, 1]
    assert 4 * estimate_noise(squeezed) == pytest.approx(sigma, rel=0.1)


def test_planes_and_steps_have_no_noise():
    plane = np.linspace(0, 0.5, 64) + np.linspace(0, 0.5, 48)[:, None]
    assert estimate_noise(plane) < 1e-12
    assert estimate_noise((plane > 0.4) * 0.5) < 1e-12


def test_an_image_of_whole_numbers_has_little():
    assert estimate_noise(data.chelsea()) < 0.004


def test_an_image_that_is_none_or_too_small_is_refused():
    with pytest.raises(InputError, match="image has 9 x 40 px, expected 10 or more"):
        estimate_noise(np.zeros((40, 9)))
    with pytest.raises(InputError):
        estimate_noise(np.zeros(7))


def test_a_black_border_tells_nothing():
    inside = 0.5 + np.random.default_rng(0).normal(0, 0.1, (200, 200))
    bordered = np.pad(np.clip(inside, 0, 1), 80)
    assert estimate_noise(bordered) == pytest.approx(0.1, rel=0.1)
    assert estimate_noise(np.zeros((40, 40))) == 0
    assert estimate_noise(np.ones((40, 40))) == 0
