from __future__ import annotations

import cv2
import numpy as np
import pytest

from tspslam.errors import InputError
from tspslam.types import StereoPair
from tspslam.vision.features._corners import find_corners, orientations, segment_scores
from tspslam.vision.features.orb import OrbDetector
from tspslam.vision.features.sift_brisk import BriskDetector, SiftDetector
from tspslam.vision.features.spread import _strongest_first
from tspslam.vision.images import grey_levels, luminance_levels

from ..conftest import noise


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


DETECTORS = {"orb": OrbDetector, "sift": SiftDetector, "brisk": BriskDetector}
every = pytest.mark.parametrize("kind", DETECTORS.values(), ids=DETECTORS)


@every
def test_motorcycle_gives_all_the_keypoints_wanted_within_the_image(pair: StereoPair, kind: type) -> None:
    features = kind(count=1500)(grey_levels(pair.left))
    assert features.uv.shape == (1500, 2)
    size, dtype = {OrbDetector: (32, np.uint8), SiftDetector: (128, np.float32), BriskDetector: (64, np.uint8)}[kind]
    assert (features.descriptor.shape, features.descriptor.dtype) == ((1500, size), dtype)
    assert (features.uv >= 0).all()
    assert (features.uv <= (740, 499)).all()
    assert features.score.shape == features.scale.shape == features.angle.shape == (1500,)
    assert features.scale.min() == 1
    assert np.ptp(features.angle) > 3


@every
def test_keypoints_are_spread_more_evenly_than_by_score_alone(pair: StereoPair, kind: type) -> None:
    def empty_cells(uv: np.ndarray) -> int:
        counts = np.histogram2d(uv[:, 0], uv[:, 1], bins=(15, 10), range=((0, 741), (0, 500)))[0]
        return int((counts == 0).sum())

    grey = grey_levels(pair.left)
    even, crowded = kind(count=1500)(grey), kind(count=1500, per_cell=1000, spacing=0)(grey)
    assert empty_cells(even.uv) <= 16
    assert empty_cells(crowded.uv) > 2 * empty_cells(even.uv)


@every
def test_no_two_keypoints_start_on_one_pixel(pair: StereoPair, kind: type) -> None:
    features = kind()(grey_levels(pair.left))
    assert len(np.unique(np.floor(features.uv + 0.5), axis=0)) == len(features.uv) > 1900


@pytest.mark.parametrize("kind", [OrbDetector, SiftDetector])
def test_a_blob_is_found_at_its_centre_on_every_octave(kind: type) -> None:
    v, u = np.mgrid[:200, :240]
    grey = (30 + 200 * np.exp(-((u - 120) ** 2 + (v - 100) ** 2) / (2 * 6**2))).round().astype(np.uint8)
    features = kind(count=50)(grey)
    near = np.abs(features.uv - (120, 100)).max(axis=1) <= 1 + features.scale
    assert (near & (features.scale > 2)).any()


def test_sift_keypoints_stand_in_the_middle_of_their_blobs() -> None:
    centres = np.random.default_rng(0).uniform(40, 360, (12, 2))
    v, u = np.mgrid[:400, :400]
    for sigma in (3.0, 6.0):
        spots = [np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * sigma**2)) for x, y in centres]
        uv = SiftDetector()((30 + 180 * np.clip(np.sum(spots, axis=0), 0, 1)).round().astype(np.uint8)).uv
        offset = np.array([uv[np.abs(uv - c).sum(axis=1).argmin()] - c for c in centres])
        assert np.abs(np.median(offset, axis=0)).max() < 0.1


@pytest.mark.parametrize(("shape", "room", "fewest"), [((16, 16), 3, 0), ((24, 100), 3, 0), ((140, 100), 5, 50)])
def test_brisk_has_no_more_octaves_than_the_image_has_room_for(shape: tuple[int, int], room: int, fewest: int) -> None:
    """More octaves than leave a pixel make OpenCV fail."""
    asked, fitting = (BriskDetector(octaves=octaves)(noise(*shape)) for octaves in (8, room))
    assert asked.uv.tobytes() == fitting.uv.tobytes()
    assert len(asked.uv) >= fewest


@every
def test_detection_is_deterministic(pair: StereoPair, kind: type) -> None:
    grey = grey_levels(pair.right)
    first, second = kind()(grey), kind()(grey)
    for name in ("uv", "descriptor", "score", "scale", "angle"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


@pytest.mark.parametrize("shape", [(1, 1), (10, 10), (44, 44), (60, 50), (37, 400), (120, 160)])
@every
def test_any_size_works_with_and_without_texture(shape: tuple[int, int], kind: type) -> None:
    rough = kind()(noise(*shape))
    flat = kind()(np.full(shape, 128, np.uint8))
    assert flat.uv.shape == (0, 2)
    assert (flat.descriptor.dtype, flat.descriptor.shape[1]) == (rough.descriptor.dtype, rough.descriptor.shape[1])
    assert len(rough.uv) > 0 or min(shape) < 60
    assert len(rough.uv) == len(rough.descriptor) == len(rough.angle)
    assert (rough.uv <= (shape[1] - 1, shape[0] - 1)).all()


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("orb", "count", 0), ("orb", "scale_factor", 1.0), ("orb", "levels", 0), ("orb", "fast_threshold", 0),
        ("orb", "per_cell", 0), ("sift", "count", 0), ("sift", "layers", 0), ("sift", "sigma", 0.1),
        ("sift", "contrast_threshold", -1), ("sift", "edge_threshold", 0.5), ("brisk", "threshold", 255),
        ("brisk", "octaves", 9), ("brisk", "spacing", 1.5),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused(kind: str, name: str, value: float) -> None:
    with pytest.raises(InputError, match=f"{kind}: {name} is"):
        DETECTORS[kind](**{name: value})


@pytest.mark.parametrize("image", [np.zeros((50, 50), np.float32), np.zeros((50, 50, 3), np.uint8)])
@every
def test_detector_wants_a_grey_plane(image: np.ndarray, kind: type) -> None:
    with pytest.raises(InputError, match="uint8"):
        kind()(image)


def test_corner_score_is_that_of_the_plain_segment_test() -> None:
    image = noise(60, 70)
    score = np.zeros_like(image)
    segment_scores(image, 10, 5, score)
    circle = [(0, -3), (2, -2), (3, 0), (2, 2), (0, 3), (-2, 2), (-3, 0), (-2, -2)]
    for y, x in np.random.default_rng(1).integers(5, 55, (300, 2)):
        ring = [int(image[y + dv, x + du]) - int(image[y, x]) for du, dv in circle] * 2
        bright = max(min(ring[k : k + 4]) for k in range(8))
        dark = max(min(-r for r in ring[k : k + 4]) for k in range(8))
        best = max(bright, dark)
        assert score[y, x] == (best if best > 10 else 0)


def test_the_strength_of_a_corner_is_its_harris_response() -> None:
    image = noise(60, 70)
    xy, strength = find_corners(image, 10, 19)
    grey = image.astype(np.int64)
    gx, gy = np.roll(grey, -1, 1) - np.roll(grey, 1, 1), np.roll(grey, -1, 0) - np.roll(grey, 1, 0)
    assert len(xy) > 3
    for (x, y), found in zip(xy, strength, strict=True):
        block = slice(y - 3, y + 4), slice(x - 3, x + 4)
        xx, xy_, yy = (float((a[block] * b[block]).sum()) for a, b in ((gx, gx), (gx, gy), (gy, gy)))
        assert found == pytest.approx((xx * yy - xy_**2 - 0.04 * (xx + yy) ** 2) / 7**4, rel=1e-4)


def test_orientation_turns_with_the_image() -> None:
    v, u = np.mgrid[-20:21, -20:21]
    angle = np.empty(1)
    for turn in (0.3, 2.0, 4.5):
        image = np.rint(128 + 5 * (u * np.cos(turn) + v * np.sin(turn))).clip(0, 255).astype(np.uint8)
        orientations(image, np.array([[20, 20]]), angle)
        assert abs(angle[0] - turn) < 0.01


def test_descriptors_are_opencv_s_of_the_whole_image(pair: StereoPair) -> None:
    grey = grey_levels(pair.left)
    found = OrbDetector(count=500)(grey)
    scale = found.scale.astype(np.float64)
    octave = np.rint(np.log(scale) / np.log(1.2)).astype(int)
    assert octave.max() > 3
    places = found.uv - (scale[:, None] - 1) / 2
    columns = (*places.T, 31 * scale, np.degrees(found.angle), found.score, octave)
    keypoints = [cv2.KeyPoint(*row) for row in zip(*(column.tolist() for column in columns), strict=True)]
    expected = cv2.ORB.create(scaleFactor=1.2, nlevels=8, edgeThreshold=19).compute(grey, keypoints)[1]
    assert np.unpackbits(found.descriptor ^ expected).mean() < 0.001


def test_ranking_is_stable_by_falling_strength() -> None:
    strength = np.array([1.0, 5.0, 1.0, 0.25, 5.0, 3e7], np.float32)
    np.testing.assert_array_equal(_strongest_first(strength), np.argsort(-strength, kind="stable"))


def test_keypoints_keep_their_distance_whatever_their_octave(motorcycle):
    from scipy.spatial import cKDTree

    uv = OrbDetector(spacing=0.5)(grey_levels(motorcycle.left)).uv
    least = 0.5 * np.sqrt(500 * 741 / 2000)
    assert cKDTree(uv).query(uv, 2)[0][:, 1].min() > least - 2  # whole pixels, rounded places
