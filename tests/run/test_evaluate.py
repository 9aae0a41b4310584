"""`tspslam eval`: a path file or a run folder beside true poses."""

import json
import re

import numpy as np
import pytest

from tests.datasets import standard
from tspslam import InputError, cli
from tspslam.io import RunFolder, image_size, read_trajectory, write_kitti, write_tum
from tspslam.run.evaluate import describe_errors, evaluated


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
    assert cli.exit_code([*command, "--json", "--plot", str(paths / "path.png")]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == describe_errors(evaluated(paths / "estimate.tum", paths / "truth.tum"))
    assert {"ate_rmse_m", "rpe_translation_percent_10m", "rpe_rotation_deg_frame", "matched", "total"} <= set(found)
    assert found["rpe_translation_percent_10m"] == pytest.approx(1, abs=0.05)
    assert image_size(paths / "path.png")[0] > 1000
    assert cli.exit_code(command) == 0
    assert "ate_rmse_m" in capsys.readouterr().out


def test_a_person_is_told_units_words_and_the_file_of_the_plot(paths, capsys):
    cut(paths, "part.tum", slice(0, 45))
    command = ["eval", str(paths / "part.tum"), "--truth", str(paths / "truth.tum")]
    assert cli.exit_code([*command, "--plot", str(paths / "path.png")]) == 0
    *lines, last = capsys.readouterr().out.splitlines()
    assert last == f"wrote {paths / 'path.png'}"
    found = describe_errors(evaluated(paths / "part.tum", paths / "truth.tum"))
    assert [line.split()[0] for line in lines] == [name for name in found if name != "warnings"]
    assert all(
        re.fullmatch(r"\w+ {2,}(-|[\d.e+-]+( m| degrees| %| pairs| frames| poses)?) {2,}\S.*\w", line) for line in lines
    )
    told = {line.split()[0]: line.split("  ", 1)[1].strip() for line in lines}
    assert re.fullmatch(r"100 % +of the path's time .*", told["covered"])
    assert re.match(r"7[45][.\d]* % +of the true path's time", told["truth_covered"])
    assert re.match(r"0 poses +of the path that are NaN", told["unknown"])
    assert cli.exit_code([*command, "--json", "--plot", str(paths / "path.png")]) == 0
    assert json.loads(capsys.readouterr().out) == found


def test_a_run_folder_is_matched_by_stamp_or_by_the_numbers_of_its_frames(paths, tmp_path):
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
    with pytest.raises(InputError, match=r"has no true poses, expected .* or a file of them"):
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
    assert cli.exit_code(["eval", str(tmp_path / "a.txt"), "--truth", str(tmp_path / "a.txt")]) == cli.BAD_INPUT
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


STRANGE = {
    "holds per_frame, a dict": {"per_frame": {"stamp": 1}},
    "holds per_frame, a str": {"per_frame": "stamp"},
    "row 0 of per_frame": {"per_frame": ["stamp", "index"]},
    "row 1 of per_frame": {"per_frame": [{"stamp": 5.0, "index": 0}, {"stamp": 5.1}]},
    "stamp that can be": {"per_frame": [{"stamp": [5.0], "index": 0}]},
    "no index": {"per_frame": [{"stamp": 5.0, "index": "0"}]},
    "no stamp that": {"per_frame": [{"stamp": True, "index": 0}]},
    "index or no": {"per_frame": [{"stamp": 5.0, "index": 1 << 70}]},
    "holds NaN": b'{"per_frame": [{"stamp": NaN, "index": 0}]}',
    "holds -Infinity": b'{"per_frame": [], "more": -Infinity}',
    "no index or no stamp": b'{"per_frame": [{"stamp": 1' + 400 * b"0" + b', "index": 0}]}',
    "is not JSON": b'{"per_frame": [{"index": 1' + 5000 * b"0" + b"}]}",
    "not JSON": b'{"per_frame": ' + 100_000 * b"[" + b"}",
    "holds a list": b"[]",
}


@pytest.mark.parametrize("said", STRANGE)
def test_a_run_folder_of_a_stranger_is_read_or_one_line(paths, capsys, said):
    with RunFolder.create(paths / "run", {}) as folder:
        estimate = read_trajectory(paths / "estimate.tum")
        folder.write_trajectory(estimate.stamp, estimate.T_world_camera)
        folder.write_run({"per_frame": [{"stamp": float(estimate.stamp[k]), "index": k} for k in range(60)]})
        assert folder.read_rows()[7] == {"stamp": float(estimate.stamp[7]), "index": 7}
    content = STRANGE[said]
    (paths / "run/run.json").write_bytes(content if isinstance(content, bytes) else json.dumps(content).encode())
    command = ["eval", str(paths / "run"), "--truth", str(paths / "truth.tum")]
    assert cli.exit_code(command) == cli.BAD_INPUT
    err = capsys.readouterr().err
    assert said in err
    assert "run.json" in err
    assert err.count("\n") == 1


def test_of_frames_of_one_moment_the_first_one_counts(paths):
    with RunFolder.create(paths / "run", {}) as folder:
        estimate = read_trajectory(paths / "estimate.tum")
        folder.write_trajectory(estimate.stamp, estimate.T_world_camera)
        rows = [{"stamp": float(estimate.stamp[k]), "index": k} for k in range(60)]
        folder.write_run({"per_frame": [*rows, {"stamp": float(estimate.stamp[-1]), "index": 60}]})
    assert evaluated(paths / "run", paths / "truth.txt").matched == 60


def cut(paths, name, rows):
    """A file of chosen lines of the truth."""
    lines = (paths / "truth.tum").read_text().splitlines(keepends=True)
    (paths / name).write_text("".join(np.array(lines, object)[rows]))
    return paths / name


def test_two_poses_of_sixty_are_an_error_and_a_quarter_is_said(paths, capsys):
    words = ["eval", str(paths / "estimate.tum"), "--json", "--truth"]
    assert cli.exit_code([*words, str(cut(paths, "two.tum", slice(0, 2)))]) == cli.BAD_INPUT
    assert "2 of 60 poses have a true one within 0.01 s, expected at least 3" in capsys.readouterr().err
    assert cli.exit_code([*words, str(cut(paths, "three.tum", slice(0, 3)))]) == cli.BAD_INPUT
    assert (
        "3 of 60 poses have a true one within 0.01 s, 3.4 % of the path, expected at least 5 %"
        in capsys.readouterr().err
    )
    assert cli.exit_code([*words, str(cut(paths, "part.tum", slice(0, 15)))]) == cli.COMPLETE
    out, err = capsys.readouterr()
    said = "only 24 % of the estimated path is compared (15 of 60 poses): the errors are those of a part"
    assert err == f"warning: {said}\n"
    assert json.loads(out)["warnings"] == [said]
    assert json.loads(out)["truth_covered"] == 1


@pytest.mark.parametrize(
    ("known", "code"), [(4, cli.DEGRADED), (29, cli.DEGRADED), (30, cli.COMPLETE), (57, cli.COMPLETE)]
)
def test_a_path_that_is_mostly_unknown_is_said_and_ends_as_degraded(paths, capsys, known, code):
    lines = (paths / "estimate.tum").read_text().splitlines()
    kept = np.linspace(0, 59, known).astype(int)
    lines = [line if k in kept else line.split()[0] + " nan" * 7 for k, line in enumerate(lines)]
    (paths / "holes.tum").write_text("\n".join(lines))
    words = ["eval", str(paths / "holes.tum"), "--truth", str(paths / "truth.tum"), "--json"]
    assert cli.exit_code(words) == code
    out, err = capsys.readouterr()
    said = f"{60 - known} of 60 poses of the estimated path are NaN: the errors are those of the {known} others"
    assert (said in err) == (code == cli.DEGRADED) == any(said in line for line in json.loads(out)["warnings"])


def test_unknown_true_poses_are_left_out_and_counted(paths, capsys):
    lines = (paths / "truth.tum").read_text().splitlines()
    for k in (3, 4, 59):
        lines[k] = lines[k].split()[0] + " NaN" * 7
    (paths / "holes.tum").write_text("\n".join(lines))
    assert cli.exit_code(["eval", str(paths / "estimate.tum"), "--truth", str(paths / "holes.tum"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert [found[key] for key in ("matched", "total", "truth_total", "truth_unknown")] == [57, 60, 57, 3]
    assert found["scale"] == pytest.approx(1 / 1.01)
    assert cli.exit_code(["eval", str(paths / "estimate.tum"), "--truth", str(paths / "holes.tum")]) == 0
    assert "truth_unknown" + " " * 17 + "3 poses " in capsys.readouterr().out


@pytest.mark.parametrize("filler", ["", "nan " * 12])
def test_line_k_of_poses_without_stamps_is_frame_k(paths, filler):
    lines = (paths / "truth.txt").read_text().splitlines()
    (paths / "holes.txt").write_text("\n".join([*lines[:10], filler, *lines[11:]]) + "\n\n\n")
    path = read_trajectory(paths / "holes.txt")
    assert (len(path), np.flatnonzero(np.isnan(path.T_world_camera[:, 0, 0])).tolist()) == (60, [10])
    for estimate in ("estimate.tum", "estimate.txt"):
        errors = evaluated(paths / estimate, paths / "holes.txt")
        assert (errors.matched, errors.truth_unknown) == (59, 1)
        assert errors.scale == pytest.approx(1 / 1.01)
    errors = evaluated(paths / "holes.txt", paths / "truth.tum")
    assert (errors.matched, errors.unknown, errors.ate_rmse_m < 1e-9) == (59, 1, True)


def test_poses_with_and_without_stamps_go_by_line_only_where_there_are_as_many(paths):
    errors = evaluated(paths / "estimate.txt", paths / "truth.tum")  # not line 5 at 5 s
    assert (errors.matched, errors.scale) == (60, pytest.approx(1 / 1.01))
    cut(paths, "tail.tum", slice(10, None))
    for one, other in (("tail.tum", "truth.txt"), ("estimate.txt", "tail.tum")):
        with pytest.raises(InputError, match="which is for which frame cannot be told; expected both with stamps"):
            evaluated(paths / one, paths / other)


def test_a_run_that_left_out_images_is_matched_by_their_numbers(paths, tmp_path):
    """An image without a partner is no frame, but has its line among the true poses."""
    from tspslam.io import RunFolder

    kept = [k for k in range(60) if k not in (5, 20)]
    estimate = read_trajectory(paths / "estimate.tum")
    with RunFolder.create(tmp_path / "run", {}) as folder:
        folder.write_trajectory(estimate.stamp[kept], estimate.T_world_camera[kept])
        rows = [{"stamp": float(estimate.stamp[k]), "index": i, "name": f"{k:06d}"} for i, k in enumerate(kept)]
        folder.write_run({"per_frame": rows})
    assert evaluated(tmp_path / "run", paths / "truth.txt").scale == pytest.approx(1 / 1.01)
    truth = np.array((paths / "truth.txt").read_text().splitlines(keepends=True), object)
    (paths / "pairs.txt").write_text("".join(truth[kept]))  # a line for each pair
    assert evaluated(tmp_path / "run", paths / "pairs.txt").scale == pytest.approx(1 / 1.01)


def told(words, capsys):
    """What the command says as JSON."""
    assert cli.exit_code(["eval", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_options_of_the_command_are_those_of_the_function(paths, capsys):
    pair = [paths / "estimate.tum", "--truth", paths / "truth.tum"]
    found = told([*pair, "--align", "sim3", "--delta", "1f,2m, 0.5s", "--kitti", "--max-diff", "0.02"], capsys)
    errors = evaluated(paths / "estimate.tum", paths / "truth.tum", align="sim3", deltas=["1f", "2m", "0.5s"])
    assert found == describe_errors(errors, kitti=True)
    assert found["ate_rmse_m"] < 1e-9
    assert found["rpe_pairs_1f"] == 59
    assert (found["kitti_translation_percent"], found["kitti_sections"]) == (None, {})
    assert cli.exit_code(["eval", *map(str, pair), "--kitti", "--delta", "9f"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"kitti_translation_percent +- +no section of 100 m or more: the true path is [\d.]+ m long", out)
    assert "of poses that are 9 frames apart" in out


def test_the_table_of_kitti_is_shown_for_each_length(tmp_path, capsys):
    truth = np.tile(np.eye(4), (400, 1, 1))
    truth[:, 2, 3] = np.arange(400)
    estimate = truth.copy()
    estimate[:, 2, 3] *= 1.02
    write_kitti(tmp_path / "a.txt", estimate)
    write_kitti(tmp_path / "b.txt", truth)
    assert cli.exit_code(["eval", str(tmp_path / "a.txt"), "--truth", str(tmp_path / "b.txt"), "--kitti"]) == 0
    out = capsys.readouterr().out
    assert "of sections of 100, 200, 300 m, mean" in out
    assert re.search(r"^  300 m +2\.00\d* % +0 degrees/100 m, 10 sections$", out, re.MULTILINE)
    found = told([tmp_path / "a.txt", "--truth", tmp_path / "b.txt", "--kitti"], capsys)
    assert found["kitti_sections"]["100"] == pytest.approx([30, 2 * 1.01, 0])  # a section ends beyond its length


def test_an_offset_is_given_or_found(paths, tmp_path, capsys):
    from tests.vision.test_offset import even, late, walk

    truth, estimate = walk(np.arange(0, 60, 0.05)), late(walk(np.arange(10, 40, 0.05)), -4)
    for name, path in (("all", truth), ("part", estimate), ("even", even(np.arange(60)))):
        write_tum(tmp_path / f"{name}.tum", path.stamp, path.T_world_camera)
    pair = [tmp_path / "part.tum", "--truth", tmp_path / "all.tum"]
    found = told([*pair, "--offset", "auto"], capsys)
    assert found["offset_s"] == pytest.approx(4, abs=0.003)
    assert 0 <= found["offset_sigma_s"] < 0.003
    given = told([*pair, "--offset", "4"], capsys)
    assert (given["offset_s"], given["offset_sigma_s"], given["matched"]) == (4, 0, 600)
    assert given["ate_rmse_m"] < 1e-9
    for words, said in (
        ([paths / "estimate.txt", "--truth", paths / "truth.txt", "--offset", "1"], "poses without stamps go by their"),
        ([paths / "even.tum", "--truth", paths / "even.tum", "--offset", "auto"], "turn and move evenly"),
    ):
        assert cli.exit_code(["eval", *map(str, words)]) == cli.BAD_INPUT
        err = capsys.readouterr().err
        assert said in err
        assert err.count("\n") == 1


def test_stamps_of_a_file_go_with_poses_that_have_none(paths, capsys):
    (paths / "times.txt").write_text("".join(f"{5 + k / 10}\n" for k in range(60)))
    cut(paths, "tail.tum", slice(20, None))
    found = told([paths / "tail.tum", "--truth", paths / "truth.txt", "--stamps", paths / "times.txt"], capsys)
    assert (found["matched"], found["truth_total"]) == (40, 60)
    both = told([paths / "estimate.txt", "--truth", paths / "truth.txt", "--stamps", paths / "times.txt"], capsys)
    assert both["matched"] == 60
    words = ["eval", str(paths / "tail.tum"), "--truth", str(paths / "truth.tum"), "--stamps", str(paths / "times.txt")]
    assert cli.exit_code(words) == cli.BAD_INPUT
    assert "have stamps of their own" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--align", "best"], "expected one of none, origin, se3, sim3"),
        (["--offset", "1_0"], "expected seconds or auto"),
        (["--offset", "nan"], "expected seconds or auto"),
        (["--delta", "10"], "is no length"),
        (["--delta", "1f,,2m"], "is no length"),
    ],
)
def test_a_word_that_is_none_is_a_usage_error(paths, capsys, words, said):
    command = ["eval", str(paths / "estimate.tum"), "--truth", str(paths / "truth.tum"), *words]
    assert cli.exit_code(command) == cli.USAGE
    assert said in " ".join(capsys.readouterr().err.split())
