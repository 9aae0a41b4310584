from __future__ import annotations

import numpy as np
import pytest

from tspslam.errors import InputError
from tspslam.types import StereoPair
from tspslam.vision.features import OrbDetector, grey_levels, luminance_levels

from .conftest import noise


def test_grey_is_rounded_once_from_the_weighted_sum() -> None:
    image = np.random.default_rng(0).integers(0, 256, (40, 50, 3), np.uint8)
    exact = image @ np.array([0.299, 0.587, 0.114])
    assert np.abs(grey_levels(image) - exact).max() <= 0.5 + 1e-4
    np.testing.assert_allclose(luminance_levels(image), exact, atol=1e-4)


def test_every_dtype_gives_the_same_grey() -> None:
    levels = noise(30, 40)
    for image in (levels, levels.astype(np.uint16) * 257, levels / np.float32(255), levels / 255.0):
        np.testing.assert_array_equal(grey_levels(image), levels)


@pytest.mark.parametrize("image", [np.zeros((2, 2), np.int8), np.zeros((2, 2, 4), np.uint8), np.zeros(3, np.uint8)])
def test_other_images_are_refused(image: np.ndarray) -> None:
    with pytest.raises(InputError, match="expected"):
        grey_levels(image)


def test_motorcycle_gives_all_the_keypoints_wanted_within_the_image(pair: StereoPair) -> None:
    features = OrbDetector(count=2000)(grey_levels(pair.left))
    assert features.uv.shape == (2000, 2)
    assert features.descriptor.shape == (2000, 32)
    assert features.descriptor.dtype == np.uint8
    assert (features.uv >= 0).all()
    assert (features.uv <= (740, 499)).all()
    assert features.score.shape == features.scale.shape == features.angle.shape == (2000,)
    assert features.scale.min() == 1
    assert np.ptp(features.angle) > 3


def test_keypoints_are_spread_more_evenly_than_by_score_alone(pair: StereoPair) -> None:
    def empty_cells(uv: np.ndarray) -> int:
        counts = np.histogram2d(uv[:, 0], uv[:, 1], bins=(15, 10), range=((0, 741), (0, 500)))[0]
        return int((counts == 0).sum())

    grey = grey_levels(pair.left)
    spread, crowded = OrbDetector(count=500)(grey), OrbDetector(count=500, per_cell=1000)(grey)
    assert empty_cells(spread.uv) < empty_cells(crowded.uv) / 2


def test_no_two_keypoints_start_on_one_pixel(pair: StereoPair) -> None:
    features = OrbDetector()(grey_levels(pair.left))
    raw = features.uv - (features.scale[:, None].astype(np.float64) - 1) / 2
    assert len(np.unique(np.rint(raw), axis=0)) == 2000


def test_a_blob_is_found_at_its_centre_on_every_octave() -> None:
    v, u = np.mgrid[:200, :240]
    grey = (30 + 200 * np.exp(-((u - 120) ** 2 + (v - 100) ** 2) / (2 * 6**2))).round().astype(np.uint8)
    features = OrbDetector(count=50)(grey)
    near = np.abs(features.uv - (120, 100)).max(axis=1) <= 1 + features.scale
    assert (near & (features.scale > 2)).any()


def test_detection_is_deterministic(pair: StereoPair) -> None:
    grey = grey_levels(pair.right)
    first, second = OrbDetector()(grey), OrbDetector()(grey)
    for name in ("uv", "descriptor", "score", "scale", "angle"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


@pytest.mark.parametrize("shape", [(1, 1), (10, 10), (44, 44), (60, 50), (37, 400), (120, 160)])
def test_any_size_works_with_and_without_texture(shape: tuple[int, int]) -> None:
    flat = OrbDetector()(np.full(shape, 128, np.uint8))
    assert flat.uv.shape == (0, 2)
    assert flat.descriptor.shape == (0, 32)
    rough = OrbDetector()(noise(*shape))
    assert (len(rough.uv) > 0) == (min(shape) >= 44)
    assert (rough.uv <= (shape[1] - 1, shape[0] - 1)).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [("count", 0), ("scale_factor", 1.0), ("levels", 0), ("fast_threshold", 0), ("oversampling", 0.5), ("per_cell", 0)],
)
def test_settings_out_of_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"orb: {name} is"):
        OrbDetector(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("image", [np.zeros((50, 50), np.float32), np.zeros((50, 50, 3), np.uint8)])
def test_detector_wants_a_grey_plane(image: np.ndarray) -> None:
    with pytest.raises(InputError, match="uint8"):
        OrbDetector()(image)
