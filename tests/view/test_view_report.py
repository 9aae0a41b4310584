from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from tspslam.errors import InputError, OutputError
from tspslam.view import write_pictures, write_report

RUN = {
    "status": "complete",
    "frames": 2,
    "tracked": 2,
    "points_per_frame": [36, np.int64(35)],
    "complex": {"n": 36, "edges": 85, "faces": 50, "euler": 1},
    "calibration": {"vertical_offset_px": -0.25, "std": {"vertical_px": float("nan")}},
    "per_frame": [{"frame": 0, "points": 12345}, {"frame": 1, "points": None, "tracked": True}],
    "settings": {"detector": "orb", "order": 1},
    "warnings": [{"code": "offset", "message": "rows <b>differ</b>"}, "plain & simple"],
}
VOID = {"meta", "link", "img", "br", "input"}


class Outline(HTMLParser):
    """Tags in order, and whether each that opens is closed in turn."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] not in ("script", "style"):
            self.words.append(data)


def outline(path: Path) -> Outline:
    parsed = Outline()
    parsed.feed(path.read_text(encoding="utf-8"))
    parsed.close()
    assert parsed.open == []
    return parsed


def without_scripts(path: Path) -> str:
    return re.sub(r"<script.*?</script>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_every_frame_gives_a_well_formed_page(odd_frame, tmp_path):
    path = write_report(odd_frame, {}, [], tmp_path / "new" / "report.html")
    parsed = outline(path)
    assert [tag for tag, _ in parsed.seen].count("h1") == 1
    assert "doi:10.3390/s25196103" in " ".join(parsed.words)


def test_the_same_run_gives_the_same_bytes(frame, tmp_path):
    pictures = write_pictures(frame, tmp_path)
    first, second = (write_report(frame, RUN, pictures, tmp_path / f"{k}.html") for k in "ab")
    assert first.read_bytes() == second.read_bytes()


def test_the_page_refers_to_nothing_outside_itself(frame, tmp_path):
    path = write_report(frame, RUN, write_pictures(frame, tmp_path), tmp_path / "report.html")
    assert not re.search(r"https?://|//www|url\(|@import", without_scripts(path))
    for tag, attributes in outline(path).seen:
        for name in ("src", "href"):
            value = attributes.get(name)
            assert value is None or value.startswith(("data:", "#")), (tag, value)
    assert "default-src 'none'" in without_scripts(path)


def test_names_and_numbers_of_the_user_are_escaped(build, tmp_path):
    evil = "</title></script><script>alert(1)</script>\"'<img src=x onerror=alert(2)>"
    run = {
        evil: evil,
        "status": evil,
        "nested": {evil: evil},
        "rows": [{evil: evil}],
        "warnings": [{"code": evil, "message": evil}, evil],
    }
    picture = write_pictures(build(), tmp_path)[0].rename(tmp_path / "<b>&.png")
    path = write_report(build(name=evil), run, [picture], tmp_path / "report.html")
    plain = write_report(build(name="a"), {**dict.fromkeys("x", "a")}, [], tmp_path / "plain.html")
    tags = [tag for tag, _ in outline(path).seen]
    assert tags.count("script") == [tag for tag, _ in outline(plain).seen].count("script")
    assert tags.count("img") == 1
    assert evil in " ".join(outline(path).words)


def test_numbers_of_the_run_are_shown_with_units(frame, tmp_path):
    words = " ".join(outline(write_report(frame, RUN, [], tmp_path / "report.html")).words)
    for shown in ("vertical offset [px]", "\N{MINUS SIGN}0.25", "–", "12\N{NARROW NO-BREAK SPACE}345", "yes", "36, 35"):
        assert shown in words
    for shown in (
        "std.vertical [px]",
        "complete",
        "rows <b>differ</b>",
        "plain & simple",
        "Euler characteristic",
        "orb",
    ):
        assert shown in words


def test_long_tables_and_settings_are_folded(frame, tmp_path):
    run = {"settings": {"a": 1}, "many": {f"k{i}": i for i in range(40)}, "few": {"b": 2}}
    page = without_scripts(write_report(frame, run, [], tmp_path / "report.html"))
    assert re.findall(r"<summary>(\w+)", page) == ["settings", "many"]
    assert re.findall(r"<h3>(\w+)", page) == ["few"]


def test_pictures_are_embedded_with_captions_and_equations(frame, tmp_path):
    pictures = write_pictures(frame, tmp_path)
    path = write_report(frame, {}, pictures, tmp_path / "report.html")
    images = [a for tag, a in outline(path).seen if tag == "img"]
    assert len(images) == len(pictures)
    assert all(a["src"].startswith("data:image/jpeg;base64,") and a["width"] == "1400" for a in images)
    assert "eqs (12) and (19)-(22)" in " ".join(outline(path).words)


def test_a_picture_that_is_none_is_an_input_error(frame, tmp_path):
    (tmp_path / "broken.png").write_bytes(b"\x89PNG\r\n")
    for name in ("broken.png", "missing.png"):
        with pytest.raises(InputError, match=name):
            write_report(frame, {}, [tmp_path / name], tmp_path / "report.html")


def test_a_page_that_cannot_be_written_is_an_output_error(frame, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(OutputError, match="is not a regular file"):
        write_report(frame, {}, [], tmp_path / "report.html")
    assert [x.name for x in tmp_path.iterdir()] == ["report.html"]


SEVERAL = {
    "source": "drive <1>",
    "status": "degraded",
    "frames": 1200,
    "tracked": 1190,
    "keyframes": 77,
    "landmarks": 54_321,
    "per_frame": [{"name": f"{k}", "is_lost": k < 7} for k in range(1197)],
}


def tile(page, name):
    return re.search(rf"<b>([^<]*)</b><span>{name}</span>", page)[1]


def test_the_headline_of_a_sequence_is_the_run_s_and_the_frame_shown_is_named(tmp_path, frame):
    page = write_report(frame, SEVERAL, [], tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<title>TSP-SLAM report: drive &lt;1&gt;</title>" in page
    assert '<h1>drive &lt;1&gt;<span class="badge note">degraded</span></h1>' in page
    head, _, rest = page.partition("the others of frame ")
    names = "frames", "tracked", "lost", "skipped", "keyframes", "landmarks"
    thin = "\N{NARROW NO-BREAK SPACE}"
    assert [tile(head, name).replace(thin, "") for name in names] == ["1200", "1190", "7", "3", "77", "54321"]
    assert "<span>points</span>" not in head
    assert rest.startswith(frame.name)
    assert f"one of 1{thin}200:" in rest
    assert tile(rest, "points") == str(frame.complex_.n)


def test_the_headline_of_a_single_frame_is_the_frame_s(tmp_path, frame):
    page = write_report(frame, SEVERAL | {"frames": 1}, [], tmp_path / "report.html").read_text(encoding="utf-8")
    assert f"<title>TSP-SLAM report: {frame.name}</title>" in page
    assert "the others of frame " not in page
    assert tile(page, "points") == str(frame.complex_.n)
