"""Pixels that no camera saw carry nothing: no keypoint, no match, no landmark, no signal."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tspslam import Session, Settings, build_complex, build_map, reconstruct, sample_signals
from tspslam.datasets import motorcycle, synthetic
from tspslam.errors import GeometryError, InputError
from tspslam.io import read_frame
from tspslam.io.frames import read_frame_valid, write_frame
from tspslam.run.record import pair_hash
from tspslam.types import StereoPair
from tspslam.vision.features.detecting import detect_usable
from tspslam.vision.features.orb import OrbDetector
from tspslam.vision.images import MARGIN, are_usable, find_usable, prepare
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.stereo.reconstruct import match_stereo
from tspslam.vision.stereo.row_matcher import RowMatcher
from tspslam.vision.stereo.sgbm import SgbmMatcher


def disc(height: int, width: int, share: float = 0.55) -> np.ndarray:
    """What a fisheye lens sees of a wide rectified image."""
    v, u = np.mgrid[:height, :width]
    return np.asarray(np.hypot(u - width / 2, v - height / 2) < share * width)


def masked(pair: StereoPair, valid: np.ndarray) -> StereoPair:
    """The pair with black where nothing was seen."""
    left, right = (
        np.where(valid if image.ndim == 2 else valid[..., None], image, 0).astype(image.dtype)
        for image in (pair.left, pair.right)
    )
    return replace(pair, left=left, right=right, valid=valid)


@pytest.fixture(scope="module")
def pair() -> StereoPair:
    given = motorcycle()
    return masked(given, disc(given.rig.height, given.rig.width, 0.4))


def distance_to_unseen(valid: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Chebyshev distance of places to the nearest pixel that was not seen, px."""
    v, u = np.nonzero(~valid & ~find_usable_by_one(~valid))
    if not len(u):
        v, u = np.nonzero(~valid)
    return np.array([np.maximum(np.abs(u - a), np.abs(v - b)).min() for a, b in np.rint(uv)])


def find_usable_by_one(unseen: np.ndarray) -> np.ndarray:
    """Unseen pixels whose four neighbours are unseen too: they are nobody's nearest."""
    inner = unseen.copy()
    inner[1:] &= unseen[:-1]
    inner[:-1] &= unseen[1:]
    inner[:, 1:] &= unseen[:, :-1]
    inner[:, :-1] &= unseen[:, 1:]
    return inner


def test_usable_pixels_keep_their_distance_from_unseen_ones() -> None:
    valid = np.ones((60, 80), bool)
    valid[30, 40] = False
    usable = find_usable(valid)
    v, u = np.mgrid[:60, :80]
    assert np.array_equal(usable, np.maximum(abs(v - 30), abs(u - 40)) > MARGIN)
    assert find_usable(np.ones((9, 9), bool)).all()
    assert are_usable(None, np.full((3, 2), np.nan)).all()
    assert not are_usable(usable, np.full((3, 2), np.nan)).any()
    assert are_usable(usable, np.array([(-5.0, 0), (1e9, 1e9), (40, 30)])).tolist() == [True, True, False]


def test_no_keypoint_lies_near_what_was_not_seen(pair: StereoPair) -> None:
    images = prepare(pair)
    for image in (images.left_image, images.right_image):
        every, kept = OrbDetector()(image.grey), detect_usable(image, OrbDetector())
        assert distance_to_unseen(pair.valid, every.uv).min() <= 2  # the border makes corners
        assert distance_to_unseen(pair.valid, kept.uv).min() > MARGIN
        assert len(kept.uv) > 500


@pytest.mark.parametrize("matcher", [RowMatcher(), SgbmMatcher()])
def test_points_rest_on_what_both_images_show(pair: StereoPair, matcher: RowMatcher | SgbmMatcher) -> None:
    stereo = match_stereo(pair, OrbDetector(), matcher)
    known = np.isfinite(stereo.disparity)
    uv, shift = stereo.left.uv[known], np.column_stack([stereo.disparity[known], 0 * stereo.disparity[known]])
    usable = find_usable(pair.valid)
    assert are_usable(usable, uv).all()
    assert are_usable(usable, uv - shift).all()
    assert known.sum() > 100
    assert np.array_equal(stereo.cloud.uv[np.lexsort(stereo.cloud.uv.T)], uv[np.lexsort(uv.T)])


def test_the_dense_map_knows_nothing_of_what_was_not_seen(pair: StereoPair) -> None:
    dense = SgbmMatcher().disparity_map(pair, 0, 64)
    assert not np.isfinite(dense[~pair.valid]).any()
    assert np.isfinite(dense[pair.valid]).mean() > 0.3


def test_points_of_a_given_map_lie_on_usable_pixels(pair: StereoPair) -> None:
    given = replace(pair, disparity=np.full(pair.valid.shape, 20.0))
    assert are_usable(find_usable(pair.valid), reconstruct(given).uv).all()


def test_a_mask_of_all_pixels_changes_nothing() -> None:
    given = motorcycle()
    every = replace(given, valid=np.ones(given.left.shape[:2], bool))
    assert np.array_equal(reconstruct(given).xyz, reconstruct(every).xyz)
    assert pair_hash(given) != pair_hash(every)
    assert pair_hash(every) != pair_hash(replace(every, valid=disc(*given.left.shape[:2])))


@pytest.mark.parametrize("valid", [np.ones((5, 5), bool), np.ones((500, 741)), "all"])
def test_a_mask_of_another_kind_or_size_is_refused(valid: object) -> None:
    with pytest.raises(InputError, match=r"valid is .*, expected bool of shape \(500, 741\)"):
        reconstruct(replace(motorcycle(), valid=valid))


def test_a_mask_that_leaves_nothing_is_named() -> None:
    given = motorcycle()
    with pytest.raises(GeometryError, match=r"0 left and 0 right keypoints.*: 0 % of their pixels are far enough from"):
        reconstruct(replace(given, valid=np.zeros(given.left.shape[:2], bool)))


def test_signals_of_what_was_not_seen_are_none() -> None:
    image = np.random.default_rng(0).random((40, 40))
    valid = np.ones((40, 40), bool)
    valid[20:, 20:] = False
    uv = np.array([(5.0, 5), (30, 5), (5, 30), (35, 12), (30, 30), (19.5, 25)])
    complex_ = build_complex([[0, 1, 2], [1, 2, 4], [0, 1, 3], [0, 2, 5]], 6)
    every = sample_signals(image, uv, complex_)
    seen = sample_signals(image, uv, complex_, valid=valid)
    assert seen.vertex_ok.tolist() == [True, True, True, True, False, False]
    assert seen.face_ok.tolist() == [4 not in face for face in complex_.faces.tolist()]
    for level in ("vertex", "edge", "face"):
        ok, before = getattr(seen, f"{level}_ok"), getattr(every, level)
        assert np.array_equal(getattr(seen, level), np.where(ok, before, 0))
    assert not seen.face_pixels[~seen.face_ok].any()
    assert np.array_equal(sample_signals(image, uv, complex_, valid=np.ones((40, 40), bool)).face, every.face)
    with pytest.raises(InputError, match=r"valid: is float64 of shape \(40, 40\), expected bool of shape \(40, 40\)"):
        sample_signals(image, uv, complex_, valid=np.ones((40, 40)))


@pytest.fixture(scope="module")
def walk() -> list[StereoPair]:
    sequence = synthetic.SyntheticSequence(synthetic.corridor(2.0))
    valid = disc(sequence.rig.height, sequence.rig.width, 0.5)
    return [masked(sequence[k], valid) for k in range(len(sequence))]


def test_landmarks_are_tracked_on_usable_pixels_alone(walk: list[StereoPair]) -> None:
    sequence = synthetic.SyntheticSequence(synthetic.corridor(2.0))
    odometry = StereoOdometry(sequence.rig)
    for pair in walk:
        assert not odometry.process(pair).is_lost
    usable = find_usable(walk[0].valid)
    for frame in odometry.map.keyframes:
        assert are_usable(usable, frame.uv).all()
        known = np.isfinite(frame.disparity)
        right = frame.uv[known] - np.column_stack([frame.disparity[known], 0 * frame.disparity[known]])
        assert are_usable(usable, right).all()
    odometry.finish()
    off = odometry.trajectory.T_world_camera[-1][:3, 3] - sequence.truth[-1][:3, 3]
    assert np.linalg.norm(off) < 0.02
    odometry.close()


def test_the_map_samples_and_finds_nothing_where_nothing_was_seen(walk: list[StereoPair], tmp_path: Path) -> None:
    with Session(walk[0].rig, Settings()) as session:
        for pair in walk:
            session.process(pair)
        made = build_map(session)
        frame = next(iter(session.keyframes.values()))
    usable = find_usable(walk[0].valid)
    assert len(made.observations.uv) > 500
    assert are_usable(usable, made.observations.uv).all()
    write_frame(tmp_path / "frame.npz", frame)
    assert np.array_equal(read_frame(tmp_path / "frame.npz").valid, walk[0].valid)
    assert np.array_equal(read_frame_valid(tmp_path / "frame.npz"), walk[0].valid)
    with pytest.raises(InputError, match=r"frame: valid is .*, expected \(384, 512\) of True and False"):
        replace(frame, valid=np.ones((3, 3), bool))
