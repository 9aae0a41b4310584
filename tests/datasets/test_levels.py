"""Cameras of 10, 12 and 14 bits in 16-bit files: luminance is that of the camera's range, not of the file's."""

import numpy as np
import pytest
from PIL import Image

from tspslam.datasets import StereoFolder, open_sequence, pair_from_files
from tspslam.datasets._levels import Levels, used_bits
from tspslam.datasets.maps import read_levelled
from tspslam.errors import InputError
from tspslam.io.images import write_png
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.calibration.rectify import rectification
from tspslam.vision.rig import Rig

from . import standard

RIG = Rig(fx=50, fy=50, cx=32, cy=24, baseline=0.1, width=64, height=48)


def picture(bits, seed=0, brightest=1.0):
    """A 16-bit array with values over all of `bits`."""
    values = np.random.default_rng(seed).integers(0, int((1 << bits) * brightest), (48, 64))
    values[0, 0] = int(((1 << bits) - 1) * brightest)
    return values.astype(np.uint16)


def folder_of(path, pairs):
    for k, pair in enumerate(pairs):
        for side, image in zip(("left", "right"), pair, strict=True):
            (path / side).mkdir(exist_ok=True)
            write_png(path / side / f"{k:03d}.png", image)
    save_cameras(RIG, path / "calib.yaml")
    return path


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_a_white_pixel_is_white_whatever_the_depth_of_the_camera(tmp_path, bits):
    left, right = picture(bits), picture(bits, 1)
    pair = StereoFolder(folder_of(tmp_path, [(left, right)]))[0]
    files = tmp_path / "left/000.png", tmp_path / "right/000.png", tmp_path / "calib.yaml"
    for read in (pair, pair_from_files(*files), pair_from_files(*files, bits=bits)):
        assert read.bits == bits
        np.testing.assert_array_equal(read.left, left << (16 - bits))
        np.testing.assert_array_equal(read.right, right << (16 - bits))
    np.testing.assert_array_equal(read_levelled(files[0])[0], left << (16 - bits))


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_pixels_aligned_to_the_left_are_at_full_scale_however_dark(bits):
    for part in (1.0, 0.05):
        assert used_bits([picture(bits, brightest=part) << (16 - bits)]) == 16


def test_pixels_widened_from_8_bits_are_at_full_scale_however_dark():
    assert used_bits([picture(5) * np.uint16(257)]) == 16


def test_black_images_and_images_of_8_bits_tell_nothing():
    assert used_bits([np.zeros((2, 2), np.uint16)]) == 16
    assert used_bits([np.full((2, 2), 255, np.uint8)]) == 16
    assert used_bits([]) == 16


@pytest.mark.parametrize("image", [np.full((2, 2), 7, np.uint8), np.full((2, 2), 0.5, np.float32)])
def test_other_pixels_than_of_16_bits_stay(image):
    levels = Levels(lambda _: [image], 1)
    assert levels([image])[0] is image
    assert levels.bits_of(image) is None


def test_a_dark_first_frame_does_not_decide_and_all_frames_are_scaled_alike(tmp_path):
    pairs = [(picture(12, k, 0.2 if k == 0 else 1.0), picture(12, k + 50, 0.2 if k == 0 else 1.0)) for k in range(5)]
    sequence = StereoFolder(folder_of(tmp_path, pairs))
    assert [pair.bits for pair in sequence] == [12] * 5
    np.testing.assert_array_equal(sequence[0].left, pairs[0][0] << 4)


def test_the_brighter_side_decides_for_both(tmp_path):
    left, right = picture(12, 0, 0.2), picture(12, 1)
    np.testing.assert_array_equal(StereoFolder(folder_of(tmp_path, [(left, right)]))[0].left, left << 4)


def test_damaged_frames_do_not_hinder_the_others(tmp_path):
    folder_of(tmp_path, [(picture(12, k), picture(12, k + 50)) for k in range(3)])
    (tmp_path / "left/000.png").write_bytes(b"no image")
    sequence = StereoFolder(tmp_path, tmp_path / "calib.yaml")
    assert sequence[1].bits == 12
    with pytest.raises(InputError, match=r"000\.png"):
        sequence[0]


def test_frames_beyond_the_bits_are_refused_with_the_way_on_and_glints_become_white(tmp_path):
    pairs = [(picture(10, k), picture(10, k + 50)) for k in range(40)]
    pairs[1] = (picture(12), picture(12, 1))  # of 40 frames the second is not in the sample
    pairs[2][0][5, 5] = 3000  # nor is the third
    sequence = StereoFolder(folder_of(tmp_path, pairs))
    assert sequence[0].bits == 10
    assert sequence[2].left[5, 5] == 1023 << 6
    with pytest.raises(InputError, match=r"001: 7.% of the pixels are above 1023.*bits=12 to be given \(--bits 12\)"):
        sequence[1]
    assert StereoFolder(tmp_path, bits=12)[1].bits == 12


def test_bits_that_cannot_be_are_refused(tmp_path):
    folder = folder_of(tmp_path, [(picture(8).astype(np.uint8), picture(8, 1).astype(np.uint8))])
    for bits in (0, 17, 12.0, True, "12"):
        with pytest.raises(InputError, match=r"bits is .*, expected how many pixels use, from 1 to 16"):
            StereoFolder(folder, bits=bits)
    with pytest.raises(InputError, match="000: image is uint8, expected 16-bit pixels where bits=12 is given"):
        StereoFolder(folder, bits=12)[0]
    assert StereoFolder(folder, bits=8)[0].bits is None


@pytest.mark.parametrize("kind", ["odometry", "euroc", "utias"])
def test_every_layout_finds_the_bits_or_takes_them(tmp_path, kind):
    getattr(standard, kind)(tmp_path)
    for path in tmp_path.rglob("*.png"):
        write_png(path, np.asarray(Image.open(path).convert("L")).astype(np.uint16) * 16 + 1)  # 12 bits
    for bits, scale in ((None, 16), (14, 4)):
        pair = open_sequence(tmp_path, bits=bits)[0]
        stored = np.asarray(Image.open(next(p for p in sorted(tmp_path.rglob("*.png")) if p.stem == pair.name)))
        assert pair.bits == (bits or 12)
        np.testing.assert_array_equal(pair.left, stored * scale)


def test_bits_are_found_before_rectification_makes_values_between(tmp_path, raw_pair):
    pair, raw = raw_pair
    stored = [(image[..., 1].astype(np.uint16) << 4) + 15 for image in (pair.left, pair.right)]
    for side, image in zip(("left", "right"), stored, strict=True):
        (tmp_path / side).mkdir()
        write_png(tmp_path / side / "a.png", image)
    save_cameras(raw, tmp_path / "calib.yaml")
    read, wanted = StereoFolder(tmp_path)[0], rectification(raw)(stored[0] << 4, stored[1] << 4)
    assert read.bits == 12
    np.testing.assert_array_equal(read.left, wanted[0])
    np.testing.assert_array_equal(read.right, wanted[1])
