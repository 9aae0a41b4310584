"""Several recordings in one run, and into one that is there: the same bytes either way, whatever stops it."""

import json
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.test_cli import complain, type_in
from tspslam import InputError, OutputError, build_map, load_run
from tspslam.datasets import JoinedSequence, open_sequence, synthetic
from tspslam.io import RunFolder, read_trajectory, write_tum
from tspslam.io.lock import FolderLock
from tspslam.run import continuing
from tspslam.run.config import resolve
from tspslam.run.continuing import run_into
from tspslam.run.evaluate import evaluated
from tspslam.run.evaluate_recordings import evaluated_recordings
from tspslam.run.export import export
from tspslam.run.joining import grow_tree
from tspslam.run.pipeline import OnePair, run
from tspslam.run.report import write_page
from tspslam.scale.maps.joining import join_runs

from .. import sequences
from ..sequences import SETTINGS, SMALL_RIG, Kept, write_sequence

HERE = {"there": range(14), "back": range(6, 18)}


class Piece(list):
    """Some pairs of a sequence."""

    rig = SMALL_RIG


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Folders of two passes through one corridor, and of one through another; true paths beside them."""
    place = tmp_path_factory.mktemp("recordings")
    walk = sequences.corridor(9.0, SMALL_RIG)
    other = Kept(synthetic.corridor(3.5, seed=1), SMALL_RIG, synthetic.Faults(noise=0.01))
    for name, sequence, frames in (
        ("there", walk, HERE["there"]),
        ("back", walk, HERE["back"]),
        ("other", other, range(6)),
    ):
        write_sequence(place / name, Piece(sequence[k] for k in frames))
        write_tum(place / f"{name}.txt", np.arange(float(len(frames))), sequence.truth[list(frames)])
    return place


def opened(folders, *names):
    return JoinedSequence([open_sequence(folders / name) for name in names])


@pytest.fixture(scope="module")
def one(folders, tmp_path_factory):
    """A run of the first pass."""
    out = tmp_path_factory.mktemp("one") / "run"
    run(open_sequence(folders / "there"), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture(scope="module")
def both(folders, tmp_path_factory):
    """A run of both passes."""
    out = tmp_path_factory.mktemp("both") / "run"
    run(opened(folders, "there", "back"), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture(scope="module")
def three(folders, tmp_path_factory):
    """A run of both passes and of the other corridor."""
    out = tmp_path_factory.mktemp("three") / "run"
    run(opened(folders, "there", "back", "other"), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture
def copy(one, tmp_path):
    return shutil.copytree(one, tmp_path / "run")


def content(folder):
    files = (file for file in folder.rglob("*") if file.is_file() and file.name != "timings.json")
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}


def test_two_passes_are_one_path_in_one_frame(folders, both):
    record = load_run(both).record
    assert record["status"] == "complete"
    first, second = record["recordings"]
    assert (first["name"], first["first"], first["tracked"], first["relative_to"]) == ("there", 0, 14, "there")
    assert (second["name"], second["first"], second["tracked"], second["relative_to"]) == ("back", 14, 12, "there")
    assert (second["joined_by"]["recording"], second["joined_by"]["frame"]) == ("there", 14)
    assert second["joined_by"]["landmarks"] >= 60
    errors = evaluated_recordings(both, [folders / "there.txt", folders / "back.txt"])
    assert errors.joint.matched == 26
    assert errors.joint.ate_rmse_m < 0.02
    assert {name: one.matched for name, one in errors.each.items()} == {"there": 14, "back": 12}
    assert errors.joint.rpe_pairs == 13 + 11
    ways = [one.kitti.travelled_m for one in errors.each.values()]
    assert errors.joint.kitti.travelled_m == pytest.approx(sum(ways))


def test_each_recording_has_a_path_with_its_own_stamps_and_all_have_one_that_rises(both):
    whole = read_trajectory(both)
    parts = [read_trajectory(both / f"trajectory_{name}.tum") for name in ("there", "back")]
    assert [part.stamp.tolist() for part in parts] == [list(map(float, range(n))) for n in (14, 12)]
    assert np.array_equal(np.concatenate([part.T_world_camera for part in parts]), whole.T_world_camera)
    assert (np.diff(whole.stamp) > 0).all()
    assert load_run(both).record["recordings"][1]["stamp_offset_s"] == whole.stamp[14]


def test_another_world_is_said_to_be_apart_and_is_in_neither_path_nor_map(folders, three):
    stored = load_run(three)
    assert stored.record["status"] == "degraded"
    last = stored.record["recordings"][2]
    assert (last["relative_to"], last["joined_by"], last["tracked"]) == ("other", None, 6)
    (warning,) = [one for one in stored.record["warnings"] if one["code"] == "not_joined"]
    assert warning["message"].startswith("other was not found in the map of there: its poses are relative to its own")
    assert len(stored.trajectory) == 26
    own = read_trajectory(three / "trajectory_other.tum")
    assert np.allclose(own.T_world_camera[0], np.eye(4), atol=1e-12)
    assert evaluated(three / "trajectory_other.tum", folders / "other.txt").ate_rmse_m < 0.02
    assert max(stored.keyframes) < 26
    assert build_map(three).keyframes.max() < 26
    errors = evaluated_recordings(three, [folders / f"{name}.txt" for name in ("there", "back", "other")])
    assert (errors.joint.matched, errors.each["other"].matched) == (26, 6)


def test_the_report_takes_a_true_path_of_each_recording(folders, three, tmp_path):
    truths = [folders / f"{name}.txt" for name in ("there", "back", "other")]
    page = write_page(three, tmp_path / "a.html", truth=truths)
    assert page.missing == ()
    said = page.path.read_text(encoding="utf-8")
    errors = evaluated_recordings(three, truths)
    assert all(f"<td>{one.ate_rmse_m:.3g}</td>" in said for one in errors.each.values())
    assert "Path against the truth" in said
    (missing,) = write_page(three, tmp_path / "b.html", truth=truths[:2]).missing
    assert "is of 3 recordings (there, back, other), 2 true paths are given" in missing
    (missing,) = write_page(three, tmp_path / "c.html", truth=truths[0]).missing
    assert "expected one --truth for each of them" in missing


@pytest.mark.parametrize("form", ["colmap", "pvd", "vtu"])
def test_a_run_with_a_recording_apart_is_handed_on(three, tmp_path, form):
    assert export(three, form, tmp_path / (f"out.{form}" if form == "vtu" else "out")).exists()


def test_one_truth_is_not_taken_for_that_of_another_recording(folders, both):
    with pytest.raises(InputError, match=r"recordings that have stamps in common .there, back.; expected one --truth"):
        evaluated(both, folders / "there.txt")
    kitti = folders / "kitti.txt"
    kitti.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 26)
    with pytest.raises(InputError, match="number their frames each from 0"):
        evaluated(both, kitti)
    with pytest.raises(InputError, match=r"is of 2 recordings \(there, back\), 3 true paths are given"):
        evaluated_recordings(both, [folders / "there.txt"] * 3)
    with pytest.raises(InputError, match="in having stamps; expected stamps in all, or in none"):
        evaluated_recordings(both, [folders / "there.txt", kitti])


def test_lines_without_stamps_are_for_the_frames_of_their_recording(folders, both, tmp_path):
    for name in ("there", "back"):
        poses = read_trajectory(folders / f"{name}.txt").T_world_camera
        (tmp_path / name).write_text("".join(" ".join(map(str, T[:3].ravel())) + "\n" for T in poses))
    errors = evaluated_recordings(both, [tmp_path / "there", tmp_path / "back"])
    assert errors.joint.matched == 26
    assert errors.joint.ate_rmse_m < 0.02


def test_a_run_of_one_recording_has_one_truth(folders, one):
    with pytest.raises(InputError, match="is a run of one recording, 2 true paths are given; expected one --truth"):
        evaluated_recordings(one, [folders / "there.txt"] * 2)


def test_what_comes_into_a_run_is_what_one_run_of_all_gives(folders, copy, both, three):
    (copy / "mine.txt").write_text("kept")
    result = run_into(copy, [open_sequence(folders / "back")])
    assert (result.folder, result.run["status"]) == (copy, "complete")
    assert content(copy) == content(both) | {"mine.txt": b"kept"}
    assert run_into(copy, [open_sequence(folders / "other")]).is_degraded
    assert content(copy) == content(three) | {"mine.txt": b"kept"}
    assert [path.name for path in copy.parent.iterdir()] == ["run"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_on_the_way_the_run_is_as_it_was_and_the_same_command_goes_on(folders, copy, both):
    before = content(copy)

    def kill(arrived):
        if arrived.index == 20:
            os.kill(os.getpid(), signal.SIGKILL)

    child = os.fork()
    if not child:
        run_into(copy, [open_sequence(folders / "back")], on_frame=kill)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    (copy / ".lock").unlink(missing_ok=True)  # which the system has let go of
    assert content(copy) == before
    assert load_run(copy).record["frames"] == 14
    run_into(copy, [open_sequence(folders / "back")])
    assert content(copy) == content(both)


def test_a_change_of_places_that_stops_in_its_middle_is_taken_up(folders, copy, both, monkeypatch):
    (copy / "mine.txt").write_text("kept")
    rename, calls = continuing._rename, []

    def once(one, other):
        calls.append(one)
        if len(calls) > 1:
            raise OutputError("no more")
        rename(one, other)

    monkeypatch.setattr(continuing, "_rename", once)
    with pytest.raises(OutputError, match="no more"):
        run_into(copy, [open_sequence(folders / "back")])
    assert not copy.exists()
    monkeypatch.undo()
    run_into(copy, [open_sequence(folders / "back")])
    assert content(copy) == content(both) | {"mine.txt": b"kept"}
    assert [path.name for path in copy.parent.iterdir()] == ["run"]


def without_record(folder):
    (folder / "run.json").unlink()


def with_another_state(folder):
    data = (folder / "state.npz").read_bytes()
    (folder / "state.npz").write_bytes(data[:-1] + b"x")


def of_another_version(folder):
    with RunFolder.create(folder, RunFolder.open(folder).config) as inner:
        data = (folder / "state.npz").read_bytes().replace(b", state 9", b", state 1")
        (folder / "state.npz").write_bytes(_with_sums(data))
        inner.record(folder / "state.npz", input_hash=inner.units["state.npz"].input)


def _with_sums(data):
    """An npz again, with the sums that its changed content has."""
    import io
    import zipfile

    source, target = io.BytesIO(data), io.BytesIO()
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for info in old.infolist():
            with old.open(info) as entry:
                entry._expected_crc = None
                new.writestr(info.filename, entry.read())
    return target.getvalue()


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (without_record, "has no run.json yet; expected a finished run"),
        (with_another_state, "state.npz: is missing or was changed since the run"),
        (of_another_version, "state.npz: cannot be gone on with .another version made it."),
    ],
)
def test_a_run_that_cannot_be_gone_on_with_is_refused(folders, copy, spoil, said):
    spoil(copy)
    before = content(copy)
    with pytest.raises(InputError, match=said):
        run_into(copy, [open_sequence(folders / "back")])
    assert content(copy) == before
    assert [path.name for path in copy.parent.iterdir()] == ["run"]


def test_what_does_not_go_into_a_run_is_refused(folders, copy, small_pair, tmp_path):
    there, back = open_sequence(folders / "there"), open_sequence(folders / "back")
    with pytest.raises(InputError, match=r"there: is in the run already, as there \(frame 0 is the same\)"):
        run_into(copy, [there])
    with pytest.raises(InputError, match=r"filter\.order was 1 and is now 2; expected the settings of the run"):
        run_into(copy, [back], resolve(assignments=["filter.order=2"]))
    other = Piece([back[0]])
    other.rig, other.name = replace(SMALL_RIG, baseline=0.5), "other"
    with pytest.raises(InputError, match=r"other: its baseline is 0\.5, that of there is 0\.24"):
        run_into(copy, [other])
    lock = FolderLock(copy)
    with pytest.raises(InputError, match="is in use by process"):
        run_into(copy, [back])
    lock.release()
    pair = OnePair(back[0])
    run(pair, tmp_path / "pair", resolve(assignments=SETTINGS))
    with pytest.raises(InputError, match="is a run of a single pair"):
        run_into(tmp_path / "pair", [there])
    with pytest.raises(InputError, match=r"holds no config\.yaml of a run"):
        run_into(tmp_path, [there])


def test_a_recording_of_which_nothing_can_be_read_leaves_the_run_as_it_was(folders, copy, tmp_path):
    damaged = shutil.copytree(folders / "back", tmp_path / "damaged")
    recording, before = open_sequence(damaged), content(copy)
    for image in damaged.rglob("*.png"):
        image.write_bytes(b"no image")
    said = r"damaged: none of its 12 pairs could be used, frame 14 first \(.*\.png: .*\); .* the run is as it was"
    with pytest.raises(InputError, match=said):
        run_into(copy, [recording])
    assert content(copy) == before
    assert not copy.with_name("run-joining").exists()


def test_settings_that_are_the_runs_own_may_be_said_again(folders, copy):
    with pytest.raises(InputError, match="is in the run already"):
        run_into(copy, [open_sequence(folders / "there")], resolve(assignments=SETTINGS))


def test_frames_made_anew_for_the_end_of_the_path_and_parts_of_a_source_are_not_gone_on_with(folders, tmp_path):
    few = Piece(open_sequence(folders / "there")[k] for k in range(3))
    few.name = "few"
    run(few, tmp_path / "fixed", resolve(assignments=[*SETTINGS, "mapping.fix_offset=true"]))
    with pytest.raises(InputError, match="was made with --fix-offset"):
        run_into(tmp_path / "fixed", [open_sequence(folders / "back")])
    run(few, tmp_path / "later", resolve(assignments=SETTINGS), frames=range(1, 3))
    with pytest.raises(InputError, match="is of frames 1:3:1 of its source; expected frames from 0 on"):
        run_into(tmp_path / "later", [open_sequence(folders / "back")])


def test_a_recording_of_a_joined_map_is_not_taken_into_it_again(folders, one, tmp_path):
    """Frames of its runs have other numbers, names and stamps there."""
    there, back = (open_sequence(folders / name) for name in ("there", "back"))
    run(back, tmp_path / "back", resolve(assignments=SETTINGS), frames=range(2, 12))
    join_runs([one, tmp_path / "back"], tmp_path / "map")
    before = content(tmp_path / "map")
    with pytest.raises(InputError, match=r"there: is in the run already, as there \(frame 0 is the same\)"):
        run_into(tmp_path / "map", [there])
    with pytest.raises(InputError, match=r"back: is in the run already, as back \(frame 14 is the same\)"):
        run_into(tmp_path / "map", [back])
    assert content(tmp_path / "map") == before
    result = run_into(tmp_path / "map", [open_sequence(folders / "other")])
    names = [one["name"] for one in result.run["recordings"]]
    assert (names, result.run["recordings"][1]["joined_by"]["recording"]) == (["there", "back", "other"], "there")


def standing(there, count, name="still"):
    """A camera that stands where a recording begins, in pictures without noise, with that recording's stamps."""
    still = Piece(replace(there[0], index=k, stamp=there[k].stamp, name=there[k].name) for k in range(count))
    still.name = name
    return still


def refused(folder, recording):
    """Whether a run says that it has a recording."""
    stored = load_run(folder)
    rows, _, parts = continuing.stored_parts(stored)
    try:
        continuing._refuse_again(stored, rows, parts, [recording])
    except InputError as error:
        return "is in the run already" in str(error)
    return False


def test_one_image_in_common_makes_no_recording_that_the_run_has(folders, one, tmp_path):
    there = open_sequence(folders / "there")
    assert refused(one, there)
    assert not refused(one, standing(there, 14))
    run(standing(there, 3), tmp_path / "run", resolve(assignments=SETTINGS))
    assert len(load_run(tmp_path / "run").stored) == 1
    assert refused(tmp_path / "run", standing(there, 3, "again"))
    assert not refused(tmp_path / "run", there)


def test_what_a_lost_camera_did_not_give_is_still_missing_when_a_recording_is_added(folders, tmp_path):
    lost = Piece(open_sequence(folders / "there")[k] for k in range(8))
    lost.name, lost.warnings = "lost", [{"code": "camera_lost", "message": "it gave no more images"}]
    assert run(lost, tmp_path / "run", resolve(assignments=SETTINGS)).is_degraded
    result = run_into(tmp_path / "run", [open_sequence(folders / "back")])
    assert [each["relative_to"] for each in result.run["recordings"]] == ["lost"] * 2
    assert result.is_degraded


@pytest.mark.parametrize(
    ("joins", "found"),
    [
        ([], {}),
        ([(1, 0)], {1: (0, 0)}),
        ([(2, 1), (2, 0)], {2: (0, 1), 1: (2, 0)}),
        ([(1, 2), (2, 1), (2, 0)], {2: (0, 2), 1: (2, 0)}),
        ([(3, 2), (1, 1)], {3: (2, 0)}),
        ([(3, 2), (2, 0), (1, 3), (1, 2)], {2: (0, 1), 3: (2, 0), 1: (3, 2)}),
    ],
)
def test_what_joined_recordings_leads_to_the_lowest_one_and_never_round(joins, found):
    assert grow_tree(joins, 4) == found
    for k in found:
        seen = [k]
        while seen[-1] in found:
            seen.append(found[seen[-1]][0])
        assert len(seen) == len(set(seen))
        assert seen[-1] == min(seen)


def test_recordings_are_typed_one_after_another(folders, tmp_path, capsys):
    options = ["--out", tmp_path / "run", "--set", SETTINGS[0]]
    code, out, _ = type_in(capsys, "run", folders / "there", folders / "back", *options)
    assert code == 0
    assert "  recording  there: from frame 0 on, 14 of 14 tracked\n" in out
    assert "recording back: from frame 14 on, 12 of 12 tracked, joined to there at frame 14" in " ".join(out.split())
    assert max(len(line) for line in out.splitlines() if str(tmp_path) not in line) <= 80
    code, out, err = type_in(capsys, "run", folders / "other", "--into", tmp_path / "run")
    assert code == 4
    assert "  recording  other: from frame 26 on, 6 of 6 tracked, joined to none\n" in out
    assert "warning: other was not found in the map of there: its poses are relative to its own start" in err
    truths = [word for name in ("there", "back", "other") for word in ("--truth", folders / f"{name}.txt")]
    code, out, _ = type_in(capsys, "eval", tmp_path / "run", *truths, "--json")
    assert code == 0
    told = json.loads(out)
    assert (told["matched"], told["recordings"]["other"]["matched"]) == (26, 6)
    assert type_in(capsys, "eval", tmp_path / "run", *truths)[1].startswith("there:\nate_rmse_m")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["{there}", "{back}", "--frames", "0:3"], 2, "--frames: goes with one recording"),
        (["{there}", "--into", "{run}", "--out", "x"], 2, "--out: does not go with --into"),
        (["--into", "{run}"], 2, "--into: goes with recordings: folders, bags or videos"),
        (["{there}/left/000.png", "{there}/right/000.png", "--calib", "{there}/calib.yaml", "--into", "{run}"], 2, "--into"),
        (["{there}", "{back}", "{there}/../there"], 2, "there is named twice, expected each recording once"),
        (["{there}", "{none}"], 3, "is no folder"),
        (["{there}", "--into", "{run}"], 3, "there: is in the run already"),
        (["{back}", "--into", "{none}"], 3, "holds no config.yaml of a run"),
    ],
)  # fmt: skip
def test_what_is_typed_wrong_is_said_in_one_line(folders, copy, tmp_path, capsys, words, code, said):
    places = {"there": folders / "there", "back": folders / "back", "run": copy, "none": tmp_path / "none"}
    found, line = complain(capsys, "run", *(word.format(**places) for word in words))
    assert (found, said in line) == (code, True), line


def test_a_name_that_is_taken_is_said_before_the_work(folders, copy, capsys):
    taken = copy.parent / ".run-before-joining"
    taken.write_text("mine")
    code, line = complain(capsys, "run", folders / "back", "--into", copy)
    assert (code, "before-joining: is there; expected a free name" in line) == (3, True), line
    assert sorted(path.name for path in copy.parent.iterdir()) == [taken.name, "run"]


def test_left_and_right_folders_are_still_one_recording(folders, tmp_path, capsys):
    sides = [folders / "other" / side for side in ("left", "right")]
    code, _, err = type_in(
        capsys,
        "run",
        *sides,
        "--calib",
        folders / "other" / "calib.yaml",
        "--out",
        tmp_path / "r",
        "--set",
        SETTINGS[0],
    )
    assert (code, json.loads((tmp_path / "r" / "run.json").read_text()).get("recordings")) == (0, None), err


def test_a_camera_that_looks_back_does_not_find_the_way_and_says_so(tmp_path):
    """From the middle of the first pass on, the other way round: nothing looks the same."""
    scene = synthetic.corridor(7.0)
    turn = np.diag([-1.0, 1.0, -1.0, 1.0])
    behind = replace(scene, path=np.ascontiguousarray((scene.path @ turn)[7::-1]))
    first = Kept(scene, SMALL_RIG, synthetic.Faults(noise=0.01))
    second = Kept(behind, SMALL_RIG, synthetic.Faults(noise=0.01))
    result = run(JoinedSequence([first, second]), tmp_path / "run", resolve(assignments=SETTINGS))
    assert [one["relative_to"] for one in result.run["recordings"]] == ["corridor", "corridor-2"]
    assert result.is_degraded
    assert result.run["recordings"][1]["evaluation"]["ate_rmse_m"] < 0.03
    assert Path(tmp_path / "run" / "trajectory_corridor-2.tum").exists()
