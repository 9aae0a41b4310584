"""The report of a whole run: in its folder, and as one page to hand on, of whole and of broken runs."""

import ast
import json
import re
import shutil
from copy import copy as twin
from pathlib import Path

import numpy as np
import pytest

import tspslam
from tspslam import InputError, Rig, StereoPair, cli
from tspslam.io import RunFolder, write_kitti
from tspslam.run.config import resolve
from tspslam.run.evaluate import describe_errors, evaluated
from tspslam.run.health import frame_states, judge_calibration
from tspslam.run.mesh import filter_mesh
from tspslam.run.pipeline import OnePair, run
from tspslam.run.report import write_page
from tspslam.topology.harmonic import Tmahf
from tspslam.view._report_advice import ADVICE

from ..sequences import SETTINGS, SMALL_RIG, corridor

LENGTH = 6.0  # m, two frames each
DARK, BROKEN = (6, 7), 9  # pairs that show nothing; one that is no pair


class Drive:
    """A corridor with dark pairs and a bad one, and its true path."""

    name = "drive </script>\u202e"

    def __init__(self):
        self.pairs = corridor(LENGTH, SMALL_RIG)
        self.rig, self.truth, self.stamps = self.pairs.rig, self.pairs.truth, self.pairs.stamps

    def __len__(self):
        return len(self.pairs)

    def __getitem__(self, index):
        if index == BROKEN:
            raise InputError("drive: image 9 is torn")
        pair = self.pairs[index]
        if index in DARK:
            pair = StereoPair(0 * pair.left, 0 * pair.right, pair.rig, index=index, stamp=pair.stamp, name=pair.name)
        return pair


@pytest.fixture(scope="module")
def drive():
    return Drive()


@pytest.fixture(scope="module")
def made(drive, tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "drive"
    run(drive, out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture
def copy(made, tmp_path):
    return Path(shutil.copytree(made, tmp_path / "drive"))


def page_of(path):
    return path.read_text(encoding="utf-8")


def record(folder):
    return json.loads((folder / "run.json").read_text())


def type_in(capsys, *words):
    code = cli.exit_code([str(word) for word in words])
    return code, *capsys.readouterr()


def headings(page):
    return re.findall(r'<h2 id="(\w+)">', page)


def test_a_run_repeated_gives_the_same_bytes_whatever_the_times_were(drive, made, tmp_path):
    run(drive, tmp_path / "again", resolve(assignments=SETTINGS))
    for name in ("report.html", "run.json"):
        assert (made / name).read_bytes() == (tmp_path / "again" / name).read_bytes()
    page = page_of(made / "report.html")
    assert "timings.json beside it has them" in page
    units = RunFolder.open(made).units
    assert "report.html" in units
    assert "timings.json" not in units


def test_the_report_has_its_sections_in_order(made):
    page = page_of(made / "report.html")
    assert headings(page) == [
        "warnings", "map", "strip", "truth", "health", "timings", "gallery", "pictures", "settings", "numbers", "details",
    ]  # fmt: skip
    assert "<b>Not complete:</b> pairs could not be used; tracking was lost." in page
    assert "<td>detector.count</td><td>800</td>" in page
    assert "drive &lt;/script&gt;\\u202e" in page


def test_frames_are_told_apart_as_they_went(made):
    states = {one.frame: one.state for one in frame_states(record(made))}
    assert sorted(states) == list(range(len(Drive())))
    assert [k for k, state in states.items() if state == "lost"] == list(DARK)
    assert states[BROKEN] == "skipped"
    assert states[0] == "keyframe"
    assert {"tracked"} <= set(states.values())


def test_few_landmarks_make_a_frame_weak_and_a_loop_is_one_that_is_not():
    rows = [
        {"index": k, "name": "", "stamp": float(k), "is_keyframe": k == 0, "is_lost": False, "landmarks_seen": seen}
        for k, seen in enumerate((400, 400, 400, 79, 81, 400))
    ]
    said = frame_states({"per_frame": rows, "loop_closures": [[4, 0], [3, 1]]})
    assert [one.state for one in said] == ["keyframe", "tracked", "tracked", "weak", "loop", "tracked"]
    few = [row | {"landmarks_seen": seen} for row, seen in zip(rows, (31, 30, 29), strict=False)]
    assert [one.state for one in frame_states({"per_frame": few})] == ["keyframe", "tracked", "weak"]


@pytest.mark.parametrize(
    "odd", [{}, {"per_frame": None}, {"per_frame": []}, {"skipped": "x", "loop_closures": [[], 3]}]
)
def test_odd_records_have_no_states_but_what_can_be_told(odd):
    assert frame_states(odd) == []


def test_the_path_is_measured_as_eval_measures_it(made, drive, tmp_path):
    tspslam.io.write_tum(tmp_path / "truth.tum", drive.stamps, drive.truth)
    found, expected = record(made)["evaluation"], describe_errors(evaluated(made, tmp_path / "truth.tum"))
    assert found.keys() == expected.keys()
    numbers = {name for name, value in expected.items() if isinstance(value, float)}
    assert {name: found[name] for name in numbers} == pytest.approx(
        {name: expected[name] for name in numbers}, rel=1e-6
    )
    assert all(found[name] == expected[name] for name in expected.keys() - numbers)


@pytest.mark.parametrize(
    "truth",
    [
        np.full((12, 4, 4), np.nan),
        np.zeros((12, 4, 4)),
        np.tile(np.eye(4), (3, 1, 1)),
        np.eye(3),
        "north",
        [[1], [1, 2]],
        3.0,
    ],
    ids=["unknown", "no rotation", "too few", "no poses", "a word", "ragged", "a number"],
)
def test_a_truth_that_does_not_fit_is_a_line(drive, tmp_path, truth):
    spoilt = twin(drive)
    spoilt.truth = truth
    found = run(spoilt, tmp_path / "run", resolve(assignments=SETTINGS), frames=range(4)).run
    assert found["status"] == "complete"
    assert "evaluation" not in found
    (line,) = [one["message"] for one in found["warnings"] if one["code"] == "truth"]
    assert line.startswith("the path is not compared with the true one (")
    assert "\n" not in line


def test_a_piece_of_a_sequence_is_compared_with_that_piece_of_the_truth(tmp_path, drive):
    found = run(drive, tmp_path / "run", resolve(assignments=SETTINGS), frames=range(1, 5)).run
    assert (found["evaluation"]["matched"], found["evaluation"]["truth_total"]) == (4, 4)
    assert "truth" not in [one["code"] for one in found["warnings"]]


def test_too_short_a_path_is_not_compared_and_that_is_no_news(tmp_path, drive):
    found = run(drive, tmp_path / "run", resolve(assignments=SETTINGS), frames=range(2)).run
    assert "evaluation" not in found
    assert "truth" not in [one["code"] for one in found["warnings"]]


YIELDING = ("mesh.py", "scan.py")  # which give a code and its message


def test_every_warning_that_a_run_gives_has_advice():
    codes = set()
    for file in (file for room in ("run", "datasets") for file in (Path(tspslam.__file__).parent / room).glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Dict):
                pairs = zip(node.keys, node.values, strict=True)
                codes |= {
                    v.value for k, v in pairs if getattr(k, "value", "") == "code" and isinstance(v, ast.Constant)
                }
            if isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple) and file.name in YIELDING:
                codes.add(node.value.elts[0].value)
    assert len(codes) > 20
    assert codes == ADVICE.keys()


def test_offsets_are_judged_with_the_thresholds_of_the_warnings():
    def verdicts(**values):
        return [one.verdict for one in judge_calibration(values, SMALL_RIG, None)]

    fine = {"vertical_offset_px": -0.4, "vertical_offset_std_px": 0.2}
    assert verdicts(**fine, disparity_offset_px=0.4, disparity_offset_std_px=0.01) == ["fine", "fine"]
    assert (
        verdicts(vertical_offset_px=0.6, disparity_offset_px=-0.6, disparity_offset_std_px=0.01) == ["look at it"] * 2
    )
    assert verdicts(vertical_offset_px=1.1, disparity_offset_px=1.1, disparity_offset_std_px=0.01) == ["wrong"] * 2
    assert verdicts(disparity_offset_px=2.0, disparity_offset_std_px=1.0) == ["fine"]
    assert verdicts(vertical_offset_px="x", disparity_offset_px=None, disparity_offset_std_px=None) == ["not known"]


def test_it_is_said_what_an_offset_does_to_depth():
    rig = Rig(fx=500, fy=500, cx=0, cy=0, baseline=0.2, width=10, height=10)
    given = {"disparity_offset_px": -5.0, "disparity_offset_std_px": 0.1}
    (finding,) = judge_calibration(given, rig, None)
    assert "off by \N{MINUS SIGN}5.00 ± 0.1 px" in finding.words
    assert "10 m come out as 20 m" in finding.words  # 500 · 0.2 / 10 = 10 px, of which half are left


def test_exposures_that_differ_by_more_than_two_stops_are_to_be_looked_at():
    said = [[one.verdict for one in judge_calibration({}, None, gain)][1:] for gain in ([1, 4], [1, 5], [1, 17], [1])]
    assert said == [["fine"], ["look at it"], ["wrong"], []]


def test_the_page_to_hand_on_holds_all_and_leads_nowhere(made, tmp_path, capsys):
    code, out, err = type_in(capsys, "report", made, "--output", tmp_path / "page.html")
    assert (code, out, err) == (0, f"wrote {tmp_path / 'page.html'}\n", "")
    page = page_of(tmp_path / "page.html")
    own = page_of(made / "report.html")
    assert headings(page) == headings(own)
    assert page.count("<img data-frame=") == own.count("<img data-frame=") > 2
    for value in re.findall(r'(?:src|href)="([^"]*)"', re.sub("(?s)<script.*?</script>", "", page)):
        assert value.startswith(("data:", "#")), value[:80]


def test_two_pages_of_a_run_are_the_same_bytes(made, tmp_path):
    first, second = (write_page(made, tmp_path / f"{k}.html") for k in "ab")
    assert first.missing == second.missing == ()
    assert first.path.read_bytes() == second.path.read_bytes()


def test_the_page_goes_to_the_folder_one_is_in_and_json_says_so(made, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = type_in(capsys, "report", made, "--json")
    assert (code, json.loads(out)) == (0, {"written": "drive-report.html", "missing": []})
    assert (tmp_path / "drive-report.html").exists()


def test_a_true_path_may_be_given_and_one_that_does_not_fit_is_named(made, drive, tmp_path, capsys):
    write_kitti(tmp_path / "truth.txt", drive.truth)
    code, *_ = type_in(capsys, "report", made, "--truth", tmp_path / "truth.txt", "--output", tmp_path / "a.html")
    assert code == 0
    assert "Error of position after alignment" in page_of(tmp_path / "a.html")
    write_kitti(tmp_path / "other.txt", drive.truth[:2])
    code, _, err = type_in(capsys, "report", made, "--truth", tmp_path / "other.txt", "--output", tmp_path / "b.html")
    assert code == 4
    assert err.startswith("not shown: evaluation: 2 of 12 poses")


def test_a_page_is_never_put_into_the_run_nor_over_another_file(made, drive, tmp_path, capsys):
    before = page_of(made / "report.html")
    for name in ("report.html", "mine.html"):
        code, _, err = type_in(capsys, "report", made, "--output", made / name)
        assert (code, "expected a place outside" in err) == (3, True)
    assert page_of(made / "report.html") == before
    (tmp_path / "notes.html").write_text("mine")
    code, _, err = type_in(capsys, "report", made, "--output", tmp_path / "notes.html")
    assert (code, "is there and is no HTML" in err) == (3, True)
    assert type_in(capsys, "report", made, "--output", tmp_path / "notes.html", "--force")[0] == 0
    assert type_in(capsys, "report", made, "--output", tmp_path / "page.pdf")[0] == 2


def refused(capsys, folder, tmp_path, words):
    code, out, err = type_in(capsys, "report", folder, "--output", tmp_path / "page.html")
    assert (code, out) == (3, "")
    assert words in err
    assert err.count("\n") == 1
    assert not (tmp_path / "page.html").exists()


def test_what_is_no_run_of_this_version_is_refused(copy, tmp_path, capsys):
    refused(capsys, tmp_path / "nowhere", tmp_path, "holds no config.yaml of a run")
    (tmp_path / "empty").mkdir()
    refused(capsys, tmp_path / "empty", tmp_path, "holds no config.yaml of a run")
    config = copy / "config.yaml"
    config.write_text(config.read_text().replace("format 3", "format 2"))
    refused(capsys, copy, tmp_path, "of format 2, as another version of tspslam makes them")


def test_a_run_that_has_stored_nothing_is_refused(tmp_path, capsys):
    RunFolder.create(tmp_path / "begun", {"source": {"name": "x"}}).close()
    refused(capsys, tmp_path / "begun", tmp_path, "holds nothing that can be shown (run.json is not there yet")


def stored(folder):
    return sorted((folder / "frames").glob("*.npz"))


def broken(change):
    """A run of which something is broken: what is named, and the page of the rest."""

    def test(copy, tmp_path, capsys):
        names = change(copy)
        code, _, err = type_in(capsys, "report", copy, "--output", tmp_path / "page.html")
        page = page_of(tmp_path / "page.html")
        assert code == 4
        assert "What could not be shown" in page
        for name in names:
            assert any(line.startswith("not shown:") and name in line for line in err.splitlines()), (name, err)
            assert name in page
        return page

    return test


def test_a_corrupt_frame_is_named_and_the_others_are_shown(copy, tmp_path, capsys):
    def change(run):
        stored(run)[1].write_bytes(stored(run)[1].read_bytes()[:-9])
        return [stored(run)[1].name]

    count = len(stored(copy))
    page = broken(change)(copy, tmp_path, capsys)
    assert page.count("<img data-frame=") == count - 1


def test_a_first_frame_that_is_gone_leaves_the_page_to_the_second(copy, tmp_path, capsys):
    def change(run):
        stored(run)[0].unlink()
        return ["000000.npz"]

    page = broken(change)(copy, tmp_path, capsys)
    assert "the others of frame" in page


def test_a_run_without_run_json_is_shown_as_far_as_it_came(copy, tmp_path, capsys):
    def change(run):
        (run / "run.json").unlink()
        return ["run.json is not there yet"]

    page = broken(change)(copy, tmp_path, capsys)
    assert "not finished" in page
    assert {"map", "strip", "gallery"} <= set(headings(page))


def test_a_half_written_run_shows_its_keyframes(copy, tmp_path, capsys):
    def change(run):
        for name in ("run.json", "map.npz", "report.html", "trajectory.tum", "timings.json", "pictures/phase.png"):
            (run / name).unlink()
        manifest = run / "manifest.jsonl"
        lines = [line for line in manifest.read_text().splitlines(True) if '"frames/' in line]
        manifest.write_text("".join(lines))
        return ["run.json is not there yet"]

    page = broken(change)(copy, tmp_path, capsys)
    assert {"strip", "gallery"} <= set(headings(page))
    assert "The mesh in space" in page


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("run.json", b"{}"), ("run.json", b"no JSON"), ("map.npz", b"PK"), ("trajectory.tum", b"1 2 3\n"),
        ("pictures/phase.png", b"\x89PNG\r\n"), ("timings.json", b"["),
    ],
)  # fmt: skip
def test_a_damaged_file_is_named_and_the_rest_is_shown(copy, tmp_path, capsys, name, content):
    def change(run):
        (run / name).write_bytes(content)
        return [name.split("/")[-1]]

    broken(change)(copy, tmp_path, capsys)


def test_rows_that_are_none_do_not_stop_the_page(copy, tmp_path, capsys):
    def change(run):
        values = record(run) | {"per_frame": [{"index": "x"}], "calibration": 3, "warnings": 4, "frames": "many"}
        values |= {"evaluation": {"matched": "<b>", "ate_rmse_m": 10**400}, "loop_closures": [[[]]], "skipped": [[]]}
        with RunFolder.create(run, RunFolder.open(run).config) as folder:
            unit = folder.units["run.json"]
            folder.record(folder.write_run(values), input_hash=unit.input)
        return ["row 0 of per_frame has no index"]

    broken(change)(copy, tmp_path, capsys)


def test_all_that_can_be_shown_of_frames_alone_is_shown_even_if_every_frame_is_broken(copy, tmp_path, capsys):
    def change(run):
        for path in stored(run):
            path.write_bytes(b"PK\x03\x04")
        return [path.name for path in stored(run)]

    page = broken(change)(copy, tmp_path, capsys)
    assert "gallery" not in headings(page)
    assert {"map", "strip", "pictures"} <= set(headings(page))


def test_times_of_the_call_that_did_the_work_stay(copy, drive):
    before = (copy / "timings.json").read_bytes()
    run(drive, copy, resolve(assignments=SETTINGS))
    assert (copy / "timings.json").read_bytes() == before


def test_one_pair_has_neither_strip_nor_path(tmp_path, drive):
    run(OnePair(drive[0]), tmp_path / "one", resolve(assignments=SETTINGS))
    page = page_of(tmp_path / "one/report.html")
    assert not {"strip", "truth", "map"} & set(headings(page))
    assert {"health", "gallery", "pictures"} <= set(headings(page))
    assert "The mesh in space" in page
    assert "One frame cannot tell" in page
    assert write_page(tmp_path / "one", tmp_path / "page.html").missing == ()


def test_a_filtered_mesh_has_a_page_too(tmp_path, made, sequence):
    filter_mesh(made / "map.ply", sequence / "left/000.png", sequence / "calib.yaml", tmp_path / "mesh", Tmahf())
    page = page_of(tmp_path / "mesh/report.html")
    assert not {"strip", "truth", "timings", "gallery", "health"} & set(headings(page))
    assert "The mesh in space" in page
    found = write_page(tmp_path / "mesh", tmp_path / "page.html")
    assert found.missing == ()
    assert "The mesh in space" in page_of(found.path)
