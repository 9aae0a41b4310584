"""What only runs of UTIAS VT&R have: chains of transforms, a run that was taught, a robot that carries the camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tspslam.datasets import UtiasRun
from tspslam.errors import InputError
from tspslam.types import Camera, RawRig
from tspslam.vision.calibration.formats.own import save_cameras

from . import standard


def row(pose: tuple[int, int], neighbour: tuple[int, int], T: np.ndarray, rows: int = 3) -> str:
    return ",".join(map(str, [*pose, *neighbour, *T[:rows].ravel().tolist()])) + "\n"


def vehicle_path(n: int) -> np.ndarray:
    """A robot that drives ahead (x) and turns left (z up)."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, :3, :3] = Rotation.from_rotvec(np.outer(np.arange(n), (0, 0, 0.1))).as_matrix()
    T[:, 0, 3] = 0.5 * np.arange(n)
    return T


def relative(truth: np.ndarray) -> np.ndarray:
    return np.linalg.inv(truth[:-1]) @ truth[1:]


def truth_of(run: Path) -> np.ndarray:
    truth = UtiasRun(run).truth
    assert truth is not None
    return truth


def temporal(run: Path, T: np.ndarray, number: int, rows: int = 3) -> None:
    """Rows from each pose to the next: T maps points of the pose's frame to the next one's."""
    steps = np.linalg.inv(T[1:]) @ T[:-1]
    lines = [row((number, k), (number, k + 1), step, rows) for k, step in enumerate(steps)]
    (run / "transforms_temporal.txt").write_text("".join(lines))


@pytest.mark.parametrize("rows", [3, 4])
def test_transforms_of_either_size_give_the_path_of_the_camera(tmp_path: Path, rows: int) -> None:
    run, T = standard.utias(tmp_path, 4), vehicle_path(4)
    temporal(run, T, 3, rows)
    truth = truth_of(run)
    np.testing.assert_allclose(truth[0], np.eye(4), atol=1e-12)
    turned = Rotation.from_matrix(relative(truth)[:, :3, :3]).as_rotvec()
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 0.1, atol=1e-9)
    assert (turned[:, 1] < -0.09).all()  # left, about an axis that points up, where the camera's y points down
    assert (relative(truth)[:, 2, 3] > 0.3).all()


def test_rows_in_the_other_direction_give_the_same_path(tmp_path: Path) -> None:
    run, T = standard.utias(tmp_path, 4), vehicle_path(4)
    temporal(run, T, 3)
    forth = truth_of(run)
    steps = np.linalg.inv(T[:-1]) @ T[1:]
    lines = [row((3, k + 1), (3, k), step) for k, step in enumerate(steps)]
    (run / "transforms_temporal.txt").write_text("".join(lines))
    np.testing.assert_allclose(relative(truth_of(run)), relative(forth), atol=1e-9)


def test_a_gap_in_the_chain_leaves_the_poses_behind_it_unknown(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 5)
    temporal(run, vehicle_path(5), 3)
    path = run / "transforms_temporal.txt"
    lines = path.read_text().splitlines(True)
    path.write_text("".join(lines[:2] + lines[3:]))
    assert np.isfinite(truth_of(run)[:, 0, 0]).tolist() == [True, True, True, False, False]


def test_a_repeated_run_is_placed_by_the_run_that_was_taught(tmp_path: Path) -> None:
    taught, T = standard.utias(tmp_path / "run_000000", 4, run=0), vehicle_path(4)
    temporal(taught, T, 0)
    repeated = standard.utias(tmp_path / "run_000007", 3, run=7)
    (repeated / "transforms_temporal.txt").unlink()
    beside = np.eye(4)
    beside[1, 3] = 0.2
    here = T[:3] @ beside  # where the repeated poses are
    spatial = [row((7, k), (0, k), np.linalg.inv(T[k]) @ here[k]) for k in range(3)]
    (repeated / "transforms_spatial.txt").write_text("".join(spatial))
    ours, theirs = truth_of(repeated), truth_of(taught)
    apart = np.linalg.inv(theirs[:3]) @ ours
    np.testing.assert_allclose(np.linalg.norm(apart[:, :3, 3], axis=1), 0.2, atol=1e-9)
    assert (apart[:, 0, 3] < -0.19).all()  # to the left of the taught path
    (taught / "transforms_temporal.txt").unlink()
    assert UtiasRun(repeated).truth is None


def test_a_raw_calibration_turns_the_poses_too(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 4)
    temporal(run, vehicle_path(4), 3)
    plain = truth_of(run)
    R = Rotation.from_rotvec((0.02, 0.04, -0.03)).as_matrix()
    T_right_left = np.eye(4)
    T_right_left[:3, :3], T_right_left[:3, 3] = R, R @ (-0.24, 0, 0)
    camera = Camera(387.777, 387.777, 257.446, 197.718, 512, 384)
    rows = T_right_left.tolist()
    save_cameras(RawRig(camera, camera, (tuple(rows[0]), tuple(rows[1]), tuple(rows[2]), tuple(rows[3]))), run / "calib.yaml")  # fmt: skip
    turned = UtiasRun(run)
    assert turned.truth is not None
    R_left = turned._frames.R_left
    assert np.abs(R_left - np.eye(3)).max() > 1e-3
    np.testing.assert_allclose(turned.truth[:, :3, :3], plain[:, :3, :3] @ R_left.T, atol=1e-9)
    np.testing.assert_allclose(turned.truth[:, :3, 3], plain[:, :3, 3], atol=1e-9)


def test_a_calibration_lies_above_the_run_or_is_given(tmp_path: Path) -> None:
    run = standard.utias(tmp_path / "run_000003")
    text = "{fx: %d, fy: 400, cx: 256, cy: 192, baseline: 0.2, width: 512, height: 384}\n"
    (tmp_path / "calib.yaml").write_text(text % 400)
    (tmp_path / "mine.yaml").write_text(text % 300)
    assert UtiasRun(run).rig.fx == 400
    assert UtiasRun(run, calib=tmp_path / "mine.yaml").rig.fx == 300
    with pytest.raises(InputError, match=r"nowhere\.yaml"):
        UtiasRun(run, calib=tmp_path / "nowhere.yaml")


def test_stamps_belong_to_the_pose_that_their_line_names(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 4)
    start = 1_600_000_000_000_000_000
    path = run / "timestamps_images.txt"
    path.write_text("".join(f"{k},{start + 10**8 * k}\n" for k in (0, 2, 3)))
    sequence = UtiasRun(run)
    assert [pair.name for pair in sequence] == ["000000", "000002", "000003"]
    assert sequence.unpaired == ["left/000001.png", "right/000001.png"]
    path.write_text("".join(f"{start + 10**8 * k}\n" for k in range(4)))
    np.testing.assert_array_equal(UtiasRun(run).stamps, [(start + 10**8 * k) / 10**9 for k in range(4)])


def test_stamps_in_seconds_are_refused(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 4)
    (run / "timestamps_images.txt").write_text("0,1600000000\n1,1600000001\n2,1600000002\n3,1600000003\n")
    with pytest.raises(InputError, match=r"timestamps_images\.txt: .*expected nanoseconds"):
        UtiasRun(run)


def test_bad_transforms_are_refused_with_their_file(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 2)
    (run / "transforms_temporal.txt").write_text(row((3, 0), (3, 1), np.diag([2.0, 1, 1, 1])))
    with pytest.raises(InputError, match=r"transforms_temporal\.txt: pose 1 holds no rotation"):
        _ = UtiasRun(run).truth


@pytest.mark.parametrize("name", ["transforms_temporal.txt", "transforms_spatial.txt"])
def test_transforms_of_another_run_are_refused(tmp_path: Path, name: str) -> None:
    run = standard.utias(tmp_path / "run_000004", run=3)
    (run / "transforms_temporal.txt").rename(run / name)
    with pytest.raises(InputError, match=rf"{name}: is of run 3; expected transforms of run 4, as the folder's name"):
        _ = UtiasRun(run).truth
    run.rename(tmp_path / "run_000003")
    assert (UtiasRun(tmp_path / "run_000003").truth is None) == (name == "transforms_spatial.txt")


def test_transforms_that_place_no_image_are_refused(tmp_path: Path) -> None:
    run = standard.utias(tmp_path, 2)
    (run / "transforms_temporal.txt").write_text(row((3, 50), (3, 51), np.eye(4)))
    with pytest.raises(InputError, match="has no pose of any of the 2 images; expected transforms of run 3"):
        _ = UtiasRun(run).truth


@pytest.mark.parametrize(("pose", "neighbour", "x"), [(0, 1, 0.6), (1, 0, 0.5), (1, 1, 0.1)])
def test_transforms_that_contradict_each_other_are_refused(tmp_path: Path, pose: int, neighbour: int, x: float) -> None:
    run, T, other = standard.utias(tmp_path, 2), np.eye(4), np.eye(4)
    T[0, 3], other[0, 3] = 0.5, x
    path = run / "transforms_temporal.txt"
    path.write_text(row((3, 0), (3, 1), T) + row((3, pose), (3, neighbour), other))
    with pytest.raises(InputError, match=rf"line 2 contradicts what is known of poses {pose} and {neighbour}"):
        _ = UtiasRun(run).truth
    path.write_text(row((3, 0), (3, 1), T) + row((3, 1), (3, 0), np.linalg.inv(T)) + row((3, 0), (3, 1), T))
    assert np.isfinite(truth_of(run)).all()
