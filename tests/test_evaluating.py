"""`tspslam eval`: a path file or a run folder beside true poses."""

import json

import numpy as np
import pytest

from tests.datasets import standard
from tspslam import InputError, cli
from tspslam.evaluating import evaluated, summary
from tspslam.io import image_size, read_trajectory, write_kitti, write_tum


@pytest.fixture
def paths(tmp_path):
    """An estimate 1 % too long, and the truth, both in both forms."""
    truth = standard.poses(60)
    estimate = truth.copy()
    estimate[:, :3, 3] *= 1.01
    stamps = 5 + np.arange(60) / 10
    for name, poses in (("estimate", estimate), ("truth", truth)):
        write_tum(tmp_path / f"{name}.tum", stamps, poses)
        write_kitti(tmp_path / f"{name}.txt", poses)
    return tmp_path


def test_forms_are_read_as_they_were_written(paths):
    tum, kitti = read_trajectory(paths / "truth.tum"), read_trajectory(paths / "truth.txt")
    np.testing.assert_allclose(tum.T_world_camera, standard.poses(60), atol=1e-12)
    np.testing.assert_allclose(kitti.T_world_camera, standard.poses(60), atol=1e-12)
    np.testing.assert_allclose(tum.stamp, 5 + np.arange(60) / 10)
    assert kitti.stamp.tolist() == list(range(60))


@pytest.mark.parametrize("estimate", ["estimate.tum", "estimate.txt"])
def test_a_file_without_stamps_is_matched_by_line(paths, estimate):
    errors = evaluated(paths / estimate, paths / "truth.txt")
    assert errors.matched == 60
    assert errors.scale == pytest.approx(1 / 1.01)


def test_the_command_prints_what_the_function_finds_and_draws(paths, capsys):
    command = ["eval", str(paths / "estimate.tum"), "--truth", str(paths / "truth.tum")]
    assert cli._exit_code([*command, "--json", "--plot", str(paths / "path.png")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == summary(evaluated(paths / "estimate.tum", paths / "truth.tum"))
    assert {"ate_rmse_m", "rpe_translation_percent_10m", "rpe_rotation_deg_frame", "matched", "total"} <= set(found)
    assert found["rpe_translation_percent_10m"] == pytest.approx(1, abs=0.05)
    assert image_size(paths / "path.png")[0] > 1000
    assert cli._exit_code(command) == 0
    assert "ate_rmse_m" in capsys.readouterr().out


def test_a_run_folder_is_matched_by_stamp_or_by_the_numbers_of_its_frames(paths, tmp_path):
    from tspslam.io import RunFolder

    run = tmp_path / "run"
    with RunFolder.create(run, {}) as folder:
        estimate = read_trajectory(paths / "estimate.tum")
        folder.write_trajectory(estimate.stamp[10:], estimate.T_world_camera[10:])
        folder.write_run({"per_frame": [{"stamp": float(estimate.stamp[k]), "index": k} for k in range(60)]})
    by_stamp, by_number = (evaluated(run, paths / f"truth.{form}") for form in ("tum", "txt"))
    assert by_stamp.matched == by_number.matched == 50
    assert by_stamp.ate_rmse_m == pytest.approx(by_number.ate_rmse_m)


def test_a_sequence_folder_brings_its_truth(tmp_path):
    folder = standard.odometry(tmp_path / "drive")
    write_tum(tmp_path / "path.tum", np.arange(4) / 10, standard.poses(4))
    with pytest.raises(InputError, match="has no true poses"):
        evaluated(tmp_path / "path.tum", folder)
    (folder / "poses.txt").write_text(standard.rows_of(standard.poses(4)))
    assert evaluated(tmp_path / "path.tum", folder).ate_rmse_m < 1e-9


BAD = {
    "line 1 has 3 values": "1 2 3\n",
    "line 2 has 12 values": "0 0 0 0 0 0 0 1\n1 0 0 0 0 1 0 0 0 0 1 0\n",
    "no number": "0 a 0 0 0 0 0 1\n",
    "line 1 has a value that is not finite": "0 inf 0 0 0 0 0 1\n",
    "has no pose that is known": "0 nan 0 0 0 0 0 1\n",
    "stamp 2 is 0.0": "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n",
    "not of length 1": "0 0 0 0 0 0 0 2\n",
    "holds no rotation": "2 0 0 0 0 1 0 0 0 0 1 0\n",
    "has no line": "# nothing\n",
}


@pytest.mark.parametrize("said", BAD)
def test_a_bad_file_is_one_line_and_exit_code_three(tmp_path, capsys, said):
    (tmp_path / "a.txt").write_text(BAD[said])
    assert cli._exit_code(["eval", str(tmp_path / "a.txt"), "--truth", str(tmp_path / "a.txt")]) == cli.BAD_INPUT
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


def test_a_part_of_a_path_is_matched_by_stamps_that_look_like_numbers_of_lines(tmp_path):
    from tspslam.io.trajectory import write_tum

    stamps, poses = np.arange(20.0), np.tile(np.eye(4), (20, 1, 1))
    poses[:, 0, 3] = stamps**2
    write_tum(tmp_path / "whole.tum", stamps, poses)
    write_tum(tmp_path / "tail.tum", stamps[5:], poses[5:])
    found = evaluated(tmp_path / "tail.tum", tmp_path / "whole.tum")
    assert found.matched == 15
    assert found.ate_rmse_m < 1e-9
    poses[:, :3, 3] *= 1e200
    write_tum(tmp_path / "far.tum", stamps, poses)
    with pytest.raises(InputError, match="from the origin"):
        evaluated(tmp_path / "far.tum", tmp_path / "whole.tum")
