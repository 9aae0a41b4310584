"""What only recordings in the ASL layout have: lists of files, two kinds of truth, sensors with places in the body."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam.datasets import EurocSequence
from tspslam.datasets._pairing import pair_by_stamp
from tspslam.errors import InputError
from tspslam.types import RawRig
from tspslam.vision.calibration.formats import read_calibration
from tspslam.vision.calibration.rectify import rectification

from . import standard

LIST = "mav0/cam0/data.csv"


def place(rotvec: tuple[float, float, float], t: tuple[float, float, float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_rotvec(rotvec).as_matrix(), t
    return T


def write_sensor(folder: Path, T: np.ndarray) -> None:
    folder.mkdir(exist_ok=True)
    (folder / "sensor.yaml").write_text(standard.SENSOR.format(data=", ".join(map(str, T.ravel()))))


def stamps_ns(folder: Path) -> list[int]:
    return [int(line.split(",")[0]) for line in (folder / LIST).read_text().splitlines()[1:]]


def test_mav0_itself_is_the_same_recording(tmp_path: Path) -> None:
    folder = standard.euroc(tmp_path / "V1_01")
    one, other = EurocSequence(folder), EurocSequence(str(folder / "mav0"))
    assert one.name == other.name == "V1_01"
    assert one.rig == other.rig
    np.testing.assert_array_equal(one.stamps, other.stamps)
    np.testing.assert_array_equal(one.stamps, [stamp / 10**9 for stamp in stamps_ns(folder)])


def test_a_gap_on_one_side_never_shifts_the_pairs_behind_it(tmp_path: Path) -> None:
    folder = standard.euroc(tmp_path, count=6)
    whole = EurocSequence(folder)
    gone = whole[1].name
    path = folder / "mav0" / "cam1" / "data.csv"
    path.write_text("".join(line for line in path.read_text().splitlines(True) if gone not in line))
    sequence = EurocSequence(folder)
    assert sequence.unpaired == [f"cam0/{gone}.png", f"cam1/{gone}.png"]
    for pair in sequence:
        (same,) = [each for each in whole if each.name == pair.name]
        assert pair.stamp == same.stamp
        np.testing.assert_array_equal(pair.right, same.right)


def test_a_listed_image_that_is_not_there_is_reported_with_its_partner(tmp_path: Path) -> None:
    folder = standard.euroc(tmp_path)
    first = stamps_ns(folder)[0]
    (folder / f"mav0/cam0/data/{first}.png").unlink()
    assert EurocSequence(folder).unpaired == [f"cam1/{first}.png", f"cam0/{first}.png"]


def test_names_of_unpaired_files_are_one_line(tmp_path: Path) -> None:
    folder = standard.euroc(tmp_path)
    first = folder / f"mav0/cam0/data/{stamps_ns(folder)[0]}.png"
    first.with_name("a\nb.png").write_bytes(first.read_bytes())
    path = folder / LIST
    path.write_text(path.read_text() + f"{stamps_ns(folder)[-1] + 50_000_000},x\x1by.png\n")
    assert EurocSequence(folder).unpaired == ["cam0/x y.png", "cam0/a b.png"]
    one, other = Path("a\nb.png"), Path("c.png")
    assert pair_by_stamp({1: one}, {2: other}, ("cam0", "cam1")).unpaired == ["cam0/a b.png", "cam1/c.png"]


def test_truth_is_that_of_the_rectified_camera(tmp_path: Path) -> None:
    """A point of the raw camera's frame has one place in the world, through the body and through the reader."""
    folder = standard.euroc(tmp_path)
    T_BC, T_world_body = place((0.1, -0.2, 1.5), (0.1, 0.2, 0.3)), standard.poses(4)
    write_sensor(folder / "mav0/cam0", T_BC)
    write_sensor(folder / "mav0/cam1", T_BC @ place((0.01, 0.02, -0.01), (0.1, 0.002, 0.001)))
    standard.euroc_truth(folder, T_world_body, stamps_ns(folder))
    raw = read_calibration(folder / "mav0/cam0/sensor.yaml").cameras
    assert isinstance(raw, RawRig)
    R_left = rectification(raw).R_left
    assert np.abs(R_left - np.eye(3)).max() > 1e-3
    point = np.array([0.3, -0.2, 2.0])
    truth = EurocSequence(folder).truth
    assert truth is not None
    seen = truth[:, :3, :3] @ (R_left @ point) + truth[:, :3, 3]
    np.testing.assert_allclose(seen, (T_world_body @ T_BC @ (*point, 1))[:, :3], atol=1e-7)


def test_the_poses_of_vicon_markers_are_carried_to_the_body(tmp_path: Path) -> None:
    folder, T_world_body = standard.euroc(tmp_path), standard.poses(4)
    T_body_marker = place((0.3, 0.1, -1.2), (0.07, -0.01, 0.12))
    standard.euroc_truth(folder, T_world_body @ T_body_marker, stamps_ns(folder))
    (folder / "mav0/state_groundtruth_estimate0").rename(folder / "mav0/vicon0")
    with pytest.raises(InputError, match=r"vicon0/sensor\.yaml"):
        _ = EurocSequence(folder).truth
    write_sensor(folder / "mav0/vicon0", T_body_marker)
    truth = EurocSequence(folder).truth
    assert truth is not None
    np.testing.assert_allclose(truth, T_world_body, atol=1e-6)


def test_rotation_is_interpolated_along_the_arc_and_nothing_beyond_the_measurements(tmp_path: Path) -> None:
    folder, T = standard.euroc(tmp_path, count=5), standard.poses(2)
    T[1, :3, :3] = Rotation.from_rotvec((0, 1.0, 0)).as_matrix()
    stamps = stamps_ns(folder)
    standard.euroc_truth(folder, T, [stamps[1] + 10_000_000, stamps[3] + 10_000_000])
    truth = EurocSequence(folder).truth
    assert truth is not None
    assert np.isfinite(truth).all(axis=(1, 2)).tolist() == [False, False, True, True, False]
    turned = Rotation.from_matrix(truth[2:4, :3, :3]).as_rotvec()
    np.testing.assert_allclose(turned, [[0, 0.4, 0], [0, 0.9, 0]], atol=1e-6)
    np.testing.assert_allclose(truth[2:4, 2, 3], [0.2, 0.45], atol=1e-6)


def test_measurements_far_apart_give_no_pose_between_them(tmp_path: Path) -> None:
    folder = standard.euroc(tmp_path, count=9)
    stamps = stamps_ns(folder)
    standard.euroc_truth(folder, standard.poses(2), [stamps[0], stamps[8]])
    truth = EurocSequence(folder).truth
    assert truth is not None
    assert np.flatnonzero(np.isfinite(truth[:, 0, 0])).tolist() == [0, 8]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1,a.png\n2,a.png\n", "1e-09 s apart in the median"),
        ("100000000,a.png\n200000000,a.png\n", "has a file name twice"),
        ("1.5,a.png\n", "line 1 has '1.5'"),
        ("1,a.png,b\n", "line 1 has 3 values"),
    ],
)
def test_bad_lists_of_images_are_refused(tmp_path: Path, text: str, said: str) -> None:
    folder = standard.euroc(tmp_path)
    (folder / LIST).write_text(text)
    with pytest.raises(InputError, match=rf"cam0/data\.csv: .*{said}"):
        EurocSequence(folder)


def test_the_real_room_is_flown_at_a_plausible_speed(tmp_path: Path) -> None:
    sequence = EurocSequence(standard.euroc_v101(tmp_path))
    truth = sequence.truth
    assert truth is not None
    known = np.isfinite(truth).all(axis=(1, 2))
    steps = np.linalg.norm(np.diff(truth[known][:, :3, 3], axis=0), axis=1)
    assert 0.5 * 58.5 < steps.sum() < 58.5  # the chords of a path of 58.5 m
    assert (steps / np.diff(sequence.stamps[known])).max() < 3
