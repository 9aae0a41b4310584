from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from view_maps import ODD_MAPS, room, wall

from tspslam.errors import InputError
from tspslam.view import _style as style
from tspslam.view import write_map_pictures, write_report, write_scene
from tspslam.view._map_section import map_numbers
from tspslam.view._turning import map_to_turn

RUN = {"source": "drive", "status": "complete", "frames": 60, "keyframes": 6}


def without_scripts(path):
    return re.sub(r"<script.*?</script>", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.fixture
def pictures(monkeypatch, tmp_path):
    monkeypatch.setattr(style, "DPI", 35)
    return write_map_pictures(wall(), tmp_path / "pictures")


def test_the_map_stands_before_the_frame_with_its_pictures(frame, pictures, tmp_path):
    page = without_scripts(write_report(frame, RUN, pictures, tmp_path / "report.html", map_=wall()))
    titles = re.findall(r"<h2 id=.*?>(.*?)</h2>", page)
    assert titles == ["The map and the path", "Pictures", "Numbers"]
    assert "The mesh in space" not in page
    assert [page.count(f"<b>{title}.</b>") for title in ("The map from above", "Response of the map")] == [1, 1]


def test_pictures_of_the_frame_stay_where_they_are(frame, pictures, tmp_path):
    other = pictures[0].rename(tmp_path / "phase.png")
    page = without_scripts(write_report(frame, RUN, [other, *pictures[1:]], tmp_path / "report.html", map_=wall()))
    titles = re.findall(r"<figcaption><b>(.*?)\.</b>", page)
    assert titles[-1] == "Response phase"
    assert len(titles) == 4
    assert f"the others of frame {frame.name}, one of 60" in page


def test_without_a_map_the_page_is_the_one_of_a_frame(frame, tmp_path):
    plain = write_report(frame, RUN, [], tmp_path / "a.html").read_bytes()
    assert write_report(frame, RUN, [], tmp_path / "b.html", map_=None).read_bytes() == plain
    assert "The map" not in without_scripts(tmp_path / "a.html")


def test_a_page_with_a_map_refers_to_nothing_outside_itself_and_has_the_same_bytes_twice(frame, pictures, tmp_path):
    first, second = (write_report(frame, RUN, pictures, tmp_path / f"{k}.html", map_=room()) for k in "ab")
    assert first.read_bytes() == second.read_bytes()
    page = without_scripts(first)
    assert not re.search(r"https?://|//www|url\(|@import", page)
    assert all(value.startswith("data:") for value in re.findall(r'(?:src|href)="([^#"][^"]*)"', page))


@pytest.mark.parametrize("name", ODD_MAPS)
def test_every_map_has_numbers_and_a_scene_or_a_word_why_not(name):
    map_ = ODD_MAPS[name]()
    numbers = dict(map_numbers(map_))
    assert numbers["Euler characteristic"] == map_.complex_.euler
    assert ("<canvas" in map_to_turn(map_)) == (len(map_.surface.faces) > 0)


def test_numbers_say_what_the_map_holds():
    map_ = wall()
    start = np.cumsum([0, *([3] * 40), *([2] * 41)])
    few = replace(map_, observations=replace(map_.observations, start=start))
    numbers = dict(map_numbers(few))
    assert numbers["vertices, each a landmark"] == 81
    assert numbers["Euler characteristic"] == 1
    assert numbers["parts"] == 1
    assert numbers["landmarks with 3 or more observations"] == "49 %"
    assert numbers["faces that a keyframe sees, not too slanted"] == "100 %"
    assert numbers["spread of a direction over views, median"] == f"{np.degrees(0.1):.1f}°"
    assert numbers["exposure, most over least"] == "1.22×"
    assert dict(map_numbers(room()))["parts"] == 3


def test_a_page_of_its_own_shows_a_frame_or_a_map_to_turn(frame, tmp_path):
    for shown, title in ((frame, "The mesh in space"), (room(), "The map in space")):
        page = write_scene(shown, tmp_path / "scene.html").read_text(encoding="utf-8")
        assert title in page
        assert "webgl2" in page
    with pytest.raises(InputError, match="a Frame or a TopologicalMap"):
        write_scene("map.vtu", tmp_path / "scene.html")
