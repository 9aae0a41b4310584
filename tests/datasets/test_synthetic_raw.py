"""A camera with lenses driven through a scene: its rectified pairs show what a pinhole camera sees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tspslam.datasets import synthetic
from tspslam.types import Camera, RawRig, StereoPair
from tspslam.vision.images import MARGIN
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.stereo.reconstruct import reconstruct_with_quality

LENS = Camera(110.0, 110.0, 159.5, 119.5, 320, 240, (0.01, -0.005, 0.001, 0.0), lens="equidistant")
DOUBLE = Camera(92.0, 92.0, 161.0, 120.5, 320, 240, (-0.17, 0.59), lens="double_sphere")
T_RIGHT_LEFT = (
    (0.99995, 0.0, 0.00999983, -0.2), (0.0, 1.0, 0.0, 0.0), (-0.00999983, 0.0, 0.99995, 0.0), (0.0, 0.0, 0.0, 1.0)
)  # fmt: skip


def cameras(right: Camera = LENS, field_of_view: float | None = None) -> RawRig:
    return RawRig(LENS, right, T_RIGHT_LEFT, field_of_view)


@pytest.mark.parametrize("raw", [cameras(DOUBLE), cameras(field_of_view=90.0)])
def test_rectified_pairs_show_what_a_pinhole_camera_sees(raw: RawRig) -> None:
    scene = synthetic.corridor(1.0)
    sequence = synthetic.RawSequence(scene, raw)
    straight = replace(scene, path=sequence.truth)
    pinhole = synthetic.SyntheticSequence(straight, sequence.rig)
    assert sequence[0].valid is None  # both cameras fill it
    for pair, expected in ((sequence[0], pinhole[0]), (sequence[1], pinhole[1])):
        assert pair.stamp == expected.stamp
        for image, other in ((pair.left, expected.left), (pair.right, expected.right)):
            a, b = (each[20:-20, 20:-20].astype(float).ravel() for each in (image, other))
            assert np.corrcoef(a, b)[0, 1] > 0.9
    quality = reconstruct_with_quality(sequence[0])[1]
    assert abs(quality.vertical_offset_px) < 0.1


def path_of(pairs: list[StereoPair]) -> StereoOdometry:
    odometry = StereoOdometry(pairs[0].rig)
    for pair in pairs:
        assert not odometry.process(pair).is_lost
    odometry.finish()
    odometry.close()
    return odometry


def test_the_path_of_a_fisheye_camera_is_about_that_of_a_pinhole_camera() -> None:
    scene = synthetic.corridor(3.0)
    lens = replace(LENS, fx=150.0, fy=150.0)
    sequence = synthetic.RawSequence(scene, RawRig(lens, lens, T_RIGHT_LEFT, 120.0))
    pinhole = synthetic.SyntheticSequence(replace(scene, path=sequence.truth), sequence.rig)
    valid = sequence[0].valid
    assert valid is not None  # rows that the lenses' images do not have
    assert 0.5 < valid.mean() < 1
    errors = []
    for pairs in (list(sequence), list(pinhole)):
        odometry = path_of(pairs)
        poses = odometry.trajectory.T_world_camera
        truth = np.linalg.inv(sequence.truth[0]) @ sequence.truth
        errors.append(float(np.sqrt(((poses[:, :3, 3] - truth[:, :3, 3]) ** 2).sum(axis=1).mean())))
    assert errors[1] < 0.03
    assert errors[0] < max(3 * errors[1], 0.03)


def test_no_keypoint_of_a_wide_field_lies_near_its_border() -> None:
    sequence = synthetic.RawSequence(synthetic.corridor(1.0), cameras(field_of_view=140.0))
    pair = sequence[0]
    assert pair.valid is not None
    odometry = path_of(list(sequence))
    v, u = np.nonzero(~pair.valid)
    for frame in odometry.map.keyframes:
        assert len(frame.uv) > 50
        for a, b in frame.uv:
            assert np.maximum(abs(u - a), abs(v - b)).min() > MARGIN - 0.5
