"""The summary of a batch: what a stranger's may hold, what its page shows, which true poses go with which recording."""

import json

import pytest
from PIL import Image

from tspslam.cli.scale import _tabulate
from tspslam.errors import InputError, OutputError
from tspslam.scale.batch import BatchResult
from tspslam.scale.summary import Row, describe_batch, found_of, read_names, write_summary
from tspslam.scale.truths import find_truths, measure

ROWS = [
    Row("drive", "/data/drive", "degraded", "resumed", frames=9, tracked=8, keyframes=3, attempts=2, seconds=12.34,
        evaluation={"ate_rmse_m": 0.0123}, warnings=["skipped 1 <b>frame</b>"], picture="drive/pictures/path.png"),
    Row("walk", "/data/<script>", "refused", error="holds no <images>"),
]  # fmt: skip


def test_the_page_has_a_row_and_a_picture_a_run_and_obeys_nothing(tmp_path):
    (tmp_path / "drive" / "pictures").mkdir(parents=True)
    Image.new("RGB", (700, 300), "red").save(tmp_path / "drive" / "pictures" / "path.png")
    write_summary(tmp_path, describe_batch(ROWS, {}, seconds=3.0))
    page = (tmp_path / "batch.html").read_text(encoding="utf-8")
    assert page.count("<tr><td>") == 2
    assert page.count('<img src="data:image/jpeg;base64,') == 1
    assert 'width="150" height="64"' in page
    assert '<a href="drive/report.html">drive</a>' in page
    assert "0.0123" in page
    assert "resumed, 2 attempts" in page
    assert "holds no &lt;images&gt;" in page
    assert "&lt;b&gt;frame&lt;/b&gt;" in page
    assert "/<wbr>data/<wbr>&lt;script&gt;" in page
    assert "http" not in page.replace("http-equiv", "").replace("https://doi", "")


def test_a_picture_that_cannot_be_read_is_left_out(tmp_path):
    (tmp_path / "drive" / "pictures").mkdir(parents=True)
    (tmp_path / "drive" / "pictures" / "path.png").write_bytes(b"no picture")
    write_summary(tmp_path, describe_batch(ROWS, {}))
    assert "<img" not in (tmp_path / "batch.html").read_text(encoding="utf-8")


def test_names_are_read_back_and_those_that_lead_astray_are_not(tmp_path):
    names = {"/a": "a", "/b": "../../etc", "/c": ".batch", "/d": "A", "/e": "x/y", "/f": 7, "/g": "g g"}
    write_summary(tmp_path, describe_batch(ROWS, {}) | {"names": names}, has_page=False)
    assert read_names(tmp_path) == {"/g": "g g"}
    assert not (tmp_path / "batch.html").exists()


@pytest.mark.parametrize("text", ["[]", "{", '{"rows": []}', ""])
def test_a_summary_that_is_none_is_refused(tmp_path, text):
    (tmp_path / "batch.json").write_text(text)
    with pytest.raises(InputError, match=r"batch\.json"):
        read_names(tmp_path)


def test_a_summary_that_cannot_be_written_leaves_the_one_before(tmp_path):
    write_summary(tmp_path, describe_batch(ROWS, {}), has_page=False)
    before = (tmp_path / "batch.json").read_bytes()
    (tmp_path / "batch.html").mkdir()
    with pytest.raises(OutputError, match=r"batch\.html"):
        write_summary(tmp_path, describe_batch(ROWS, {}))
    assert json.loads(before)["states"] == {"degraded": 1, "refused": 1}
    assert (tmp_path / "batch.json").read_bytes() == before


def test_what_is_no_finished_run_is_none(tmp_path):
    with pytest.raises(InputError):
        found_of(tmp_path)


def test_truths_are_found_by_name_in_a_folder_or_a_list(tmp_path):
    for name in ("a.txt", "b.csv", "other.txt"):
        (tmp_path / name).write_text("")
    (tmp_path / "c").mkdir()
    expected = {"a": tmp_path / "a.txt", "b": tmp_path / "b.csv", "c": tmp_path / "c"}
    assert find_truths(tmp_path, ["a", "b", "c", "d"]) == expected
    (tmp_path / "list").write_text("# poses\na  a.txt\na b b.csv\nunknown x.txt\n")
    assert find_truths(tmp_path / "list", ["a", "a b"]) == {"a": tmp_path / "a.txt", "a b": tmp_path / "b.csv"}


@pytest.mark.parametrize(
    ("line", "said"), [("a b.txt", "line 2 names a again"), ("b", "line 2 has no path")]
)  # fmt: skip
def test_a_list_of_truths_that_can_be_read_in_two_ways_is_refused(tmp_path, line, said):
    (tmp_path / "list").write_text(f"a a.txt\n{line}\n")
    with pytest.raises(InputError, match=said):
        find_truths(tmp_path / "list", ["a", "b"])


def test_a_truth_in_a_home_that_is_not_known_is_not_there(tmp_path):
    (tmp_path / "list").write_text("a ~nobody-of-this-name/a.txt\n")
    assert find_truths(tmp_path / "list", ["a"]) == {"a": tmp_path / "~nobody-of-this-name/a.txt"}


@pytest.mark.parametrize("place", ["", "y" * 300, "gone", "empty.txt"])
def test_truths_of_none_of_the_recordings_are_refused(tmp_path, place):
    (tmp_path / "empty.txt").write_text("")
    with pytest.raises(InputError, match=r"expected a folder with NAME\.txt"):
        find_truths(tmp_path / place, ["drive"])


def test_a_truth_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(InputError):
        measure(tmp_path, tmp_path / "gone.txt")


def test_the_table_of_errors_names_runs_that_have_none(tmp_path):
    rows = [ROWS[0], Row("hall", "/data/hall", "complete"), ROWS[1]]
    lines = _tabulate(BatchResult(tmp_path, rows, describe_batch(rows, {})))
    assert lines[3].split()[:2] == ["drive", "0.0123"]
    assert lines[4] == "without true poses that fit: hall"  # not the refused one
    assert not [
        line for line in _tabulate(BatchResult(tmp_path, rows[1:], describe_batch(rows[1:], {}))) if "true" in line
    ]
