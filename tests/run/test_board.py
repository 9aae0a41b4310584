"""The commands that calibrate by a board and print one."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.vision.calibration.boards import BASELINE, CHARUCO, CHESSBOARD, SIZE, exact_views, images, places, project
from tspslam.cli import BAD_INPUT, COMPLETE, USAGE, exit_code
from tspslam.errors import InputError
from tspslam.io.images import read_image, write_png
from tspslam.run import board as job
from tspslam.run.sequence import Step
from tspslam.vision.calibration.board import Corners, calibrate, detect
from tspslam.vision.calibration.formats import read_calibration
from tspslam.vision.calibration.formats.own import load_cameras

NO_IDS = np.zeros(0, np.int64)


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """Seven pairs; of an eighth the right image shows no board."""
    folder = tmp_path_factory.mktemp("boards")
    for side in ("left", "right"):
        (folder / side).mkdir()
    for k, both in enumerate(images(count=8)):
        for side, image in zip(("left", "right"), both, strict=True):
            write_png(folder / side / f"{k:02}.png", image)
    write_png(folder / "left" / "20.png", np.zeros(SIZE[::-1], np.uint8))
    write_png(folder / "right" / "20.png", np.zeros(SIZE[::-1], np.uint8))
    (folder / "left" / "30.png").write_bytes(b"no image")
    write_png(folder / "right" / "30.png", np.zeros(SIZE[::-1], np.uint8))
    return folder


def run(capsys, *words):
    code = exit_code([str(word) for word in words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_a_recording_becomes_a_calibration_a_picture_and_a_table(recording, tmp_path, capsys):
    target = tmp_path / "calib.yaml"
    code, out, err = run(
        capsys, "calib", "board", recording, "--board", "9x6", "--square", 0.025, "--output", target, "--threads", 1
    )
    assert code == COMPLETE
    cameras = load_cameras(target)
    assert abs(np.linalg.norm(cameras.matrix[:3, 3]) / BASELINE - 1) < 0.003
    assert abs(cameras.left.fx / 530 - 1) < 0.002
    assert 0.6 < np.divide(*read_image(tmp_path / "calib-board.png").shape[:2]) < 0.8
    assert re.search(r"^20 +left out: no corners found in either image$", out, re.MULTILINE)
    assert re.search(r"^30 +left out: .*30.png", out, re.MULTILINE)
    assert re.search(r"^focal length  5\d\d\.\d\d ± 0\.\d\d px left", out, re.MULTILINE)
    assert re.search(r"^baseline      1[12]\d\.\d\d ± 0\.\d\d mm$", out, re.MULTILINE)
    assert f"tspslam run PAIRS --calib {target}" in out
    assert "warning: 8 views of both cameras are used, 10 or more are good" in err


def test_the_result_is_the_same_with_any_number_of_threads_and_for_programs(recording, tmp_path, capsys):
    found = []
    for threads in (1, 2):
        target = tmp_path / f"{threads}.yaml"
        code, out, err = run(
            capsys, "calib", "board", recording / "left", recording / "right", "--board", "9x6", "--square", 0.025,
            "--output", target, "--picture", tmp_path / f"{threads}.png", "--threads", threads, "--json",
        )  # fmt: skip
        assert code == COMPLETE
        described = json.loads(out)
        assert [row["code"] for row in described["warnings"]] == ["few_views"]
        assert described["lens"] == "brown"
        assert described["held"] == ["k3"]
        assert len(described["views"]) == 8
        assert all(json.loads(line) for line in err.splitlines())
        found.append((target.read_bytes(), (tmp_path / f"{threads}.png").read_bytes()))
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--square", "0.025"], "either this or --charuco"),
        (["--board", "9x6", "--charuco", "5x7", "--square", "0.025"], "not both"),
        (["--board", "9", "--square", "0.025"], "expected COLUMNSxROWS"),
        (["--board", "9x6"], "--square"),
        (["--board", "9x6", "--square", "0.025", "--marker", "0.02"], "goes with --charuco"),
        (["--charuco", "5x7", "--square", "0.025"], "is needed with --charuco"),
        (["--board", "9x6", "--square", "0.025", "--lens", "mei"], "expected one of brown, rational, equidistant"),
        (["--board", "9x6", "--square", "0.025", "--output", "calib.txt"], "expected .yaml or .yml"),
    ],
)
def test_what_was_typed_wrong_is_told(recording, capsys, words, said):
    code, _, err = run(capsys, "calib", "board", recording, *words)
    assert code == USAGE
    assert said in err
    assert err.count("\n") == 1


def test_nothing_is_written_where_the_board_is_not_seen(recording, tmp_path, tmp_path_factory, capsys):
    few, target = tmp_path_factory.mktemp("few"), tmp_path / "calib.yaml"
    for image in ("left/00.png", "left/01.png", "right/00.png", "right/01.png"):
        (few / image).parent.mkdir(exist_ok=True)
        shutil.copy(recording / image, few / image)
    code, _, err = run(capsys, "calib", "board", few, "--board", "8x5", "--square", 0.025, "--output", target)
    assert code == BAD_INPUT
    assert "views can be used, expected 5 or more" in err
    assert err.splitlines()[-1].startswith("tspslam: board: 0 of 2 views")
    assert "--board counts inner corners: a board of 8x5 squares is 7x4" in err
    assert not list(tmp_path.iterdir())


def test_another_file_is_not_overwritten(recording, tmp_path, capsys):
    target = tmp_path / "settings.yaml"
    target.write_text("mapping: {}\n")
    code, _, err = run(capsys, "calib", "board", recording, "--board", "9x6", "--square", 0.025, "--output", target)
    assert code == BAD_INPUT
    assert "is no calibration of ours" in err
    assert target.read_text() == "mapping: {}\n"


class Repeated:
    """A long recording: views of the board that are alike, and few that differ."""

    name, unpaired = "long", ()

    def __init__(self, count):
        self.names, self.stamps, self.read = [f"{k:04}" for k in range(count)], np.arange(count) / 10.0, []

    def __len__(self):
        return len(self.names)

    def images(self, index):
        self.read.append(index)
        return iter((np.full((8, 8), index % 7, np.uint8),) * 2)


def test_of_a_long_recording_views_are_chosen_that_differ_and_are_sharp(monkeypatch):
    source, poses = Repeated(1500), places(count=12)

    def corners(board, image):
        k = len(source.read) % 140
        uv = project_left(poses[k % 7]) + 0.3 * (k // 7)
        return Corners(np.arange(len(uv)), uv, CHESSBOARD.corners, SIZE, 2.0 if k % 2 else 4.0)

    monkeypatch.setattr(job, "detect", corners)
    steps = []
    views, unread = job.find_views(CHESSBOARD, source, steps.append)
    assert len(source.read) == 600
    assert source.read[0] == 0
    assert source.read[-1] == 1499
    assert len(views) <= job.MOST_VIEWS
    assert unread == {}
    assert len({tuple(np.rint(view.left.uv[0] / 20)) for view in views}) >= 7
    assert np.mean([view.left.blur < 3 for view in views]) > 0.5
    assert steps[3] == Step("corners", 3, 600)


def project_left(T):
    from tests.vision.calibration.boards import CAMERAS

    return project(CAMERAS["brown"][0], CHESSBOARD.corners, T)


def test_views_of_one_name_are_told_apart():
    assert job._unique("a", 4, {"a"}) == "a (4)"
    assert job._unique("a", 4, {"a", "a (4)"}) == "a (4) (4)"
    assert job._unique("b", 4, {"a"}) == "b"


def test_a_fisheye_calibration_is_read_back_with_its_lens(recording, tmp_path, capsys, monkeypatch):
    views = exact_views(lens="equidistant", noise=0.05)
    views[2] = views[2]._replace(right=replace(views[2].right, ids=NO_IDS, uv=np.zeros((0, 2)), xyz=np.zeros((0, 3))))
    monkeypatch.setattr(job, "find_views", lambda *_: (views, {}))
    target = tmp_path / "calib.yaml"
    words = ["--board", "9x6", "--square", 0.025, "--lens", "equidistant", "--output", target]
    code, out, _ = run(capsys, "calib", "board", recording, *words)
    assert code == COMPLETE
    expected, cameras = calibrate(CHESSBOARD, views, lens="equidistant").rig, read_calibration(target).cameras
    for one, other in ((cameras.left, expected.left), (cameras.right, expected.right)):
        assert one.lens == "equidistant"
        assert np.allclose(one.distortion, other.distortion, rtol=0, atol=1e-9)
    assert re.search(r"^02 +\d.* - ", out, re.MULTILINE)
    assert re.search(r"^ +- : no corners found in that image$", out, re.MULTILINE)
    assert re.search(r"^coverage +corners in \d+% of the left image's 8 x 6 cells, in \d+%", out, re.MULTILINE)


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO], ids=["chessboard", "charuco"])
def test_a_printed_board_has_its_true_size(board, tmp_path, capsys):
    file = tmp_path / "board.png"
    words = job.name_of_board(board).split()
    code, out, _ = run(capsys, "calib", "sheet", *words, "--output", file)
    assert code == COMPLETE
    width, height = map(float, re.search(r"([\d.]+) x ([\d.]+) mm", out).groups())
    page = read_image(file)
    dots = page.shape[1] / width  # a mm
    assert abs(page.shape[0] / height - dots) < 0.01 * dots
    found = detect(board, page[..., :3])
    assert len(found) == len(board.corners)
    apart = np.ptp(found.uv, axis=0) / dots
    assert np.abs(np.sort(apart) - np.sort(1000 * np.ptp(board.corners, axis=0)[:2])).max() < 0.15
    rows = page[..., 0] if page.ndim == 3 else page
    line = np.argwhere((rows < 128).sum(axis=1) > 90 * dots).ravel().max()  # the lowest long one is the ruler
    on = np.flatnonzero(rows[line, : int(115 * dots)] < 128)
    assert abs((on[-1] - on[0]) / dots - 100) < 0.5


@pytest.mark.parametrize("suffix", ["pdf", "svg", "png"])
def test_the_same_board_gives_the_same_file(suffix, tmp_path, capsys):
    files = [tmp_path / f"{k}.{suffix}" for k in range(2)]
    for file in files:
        assert run(capsys, "calib", "sheet", "--board", "9x6", "--square", 0.02, "--output", file)[0] == COMPLETE
    assert files[0].read_bytes() == files[1].read_bytes()


def test_a_vector_page_has_its_size_in_it(tmp_path, capsys):
    file = tmp_path / "a.svg"
    code, out, _ = run(capsys, "calib", "sheet", "--board", "9x6", "--square", 0.025, "--output", file, "--json")
    assert code == COMPLETE
    assert json.loads(out)["page_mm"] == [297, 210]
    text = file.read_text()
    assert float(re.search(r'width="([\d.]+)pt"', text)[1]) == pytest.approx(297 / 25.4 * 72, abs=0.01)


def test_a_board_beyond_the_largest_page_is_refused(tmp_path):
    from tspslam.vision.calibration.board import Chessboard

    with pytest.raises(InputError, match="is 2500 x 1750 mm, expected one that fits A0; is --square in metres"):
        job.write_sheet(Chessboard(9, 6, 0.25), tmp_path / "a.pdf")
    with pytest.raises(InputError, match=r"has the suffix '\.jpg'"):
        job.write_sheet(CHESSBOARD, tmp_path / "a.jpg")


def test_a_source_of_which_nothing_can_be_read_says_why(tmp_path):
    from tspslam.datasets.views import open_views

    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        (tmp_path / side / "a.png").write_bytes(b"none")
    with pytest.raises(InputError, match=r"a\.png"):
        job.calibrate_from(CHESSBOARD, open_views([tmp_path]))
