"""Pieces of the report of a whole run: strip, gallery, times, errors, words."""

from __future__ import annotations

import base64
import json
import re
from collections import Counter
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

from tspslam.view import _report_gallery as gallery
from tspslam.view import write_report
from tspslam.view._html import data_of, text
from tspslam.view._report_advice import ADVICE, MOST_OF_A_KIND, REASONS, warnings_section, why_degraded
from tspslam.view._report_chart import MOST_POINTS, coarse
from tspslam.view._report_health import MARKS, health_section
from tspslam.view._report_parts import STATES, Finding, FrameState, WholeRun
from tspslam.view._report_recordings import recordings_section
from tspslam.view._report_strip import LOOK, MOST_CELLS, strip_section, summary_of
from tspslam.view._report_tables import MOST_ROWS, numbers_section, settings_section
from tspslam.view._report_timings import timings_section, timings_svg

EVIL = "</script></title><img src=x onerror=alert(1)>\"'\u202e" + "long" * 80


def frames(*states):
    return [FrameState(k, f"image {k}", k / 10, state, 100) for k, state in enumerate(states)]


def read(drawing):
    """Undo `drawing_of`, as the page does."""
    values, value, shift = [], 0, 0
    for byte in base64.b64decode(drawing):
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            values.append(value)
            value = shift = 0
    (count, *rest), places, steps, edges, u, at = values, [], [], [], 0, 0
    for k in range(count):
        u += rest[at]
        places.append((u, rest[at + 1]))
        steps.append(rest[at + 2])
        edges += [(k, k + further) for further in rest[at + 4 : at + 4 + rest[at + 3]]]
        at += 4 + rest[at + 3]
    assert at == len(rest)
    return np.array(places).reshape(-1, 2), np.array(steps, int), np.array(edges, int).reshape(-1, 2)


def test_keypoints_and_mesh_survive_packing(odd_frame):
    shot = gallery.shot_of(odd_frame, "keyframe")
    places, steps, edges = read(gallery.drawing_of(shot, (2.0, 50.0)))
    expected = np.rint(2 * np.clip(shot.uv, 0, 1) * shot.size).astype(int)
    assert Counter(map(tuple, places.tolist())) == Counter(map(tuple, expected.tolist()))
    drawn, wanted = (
        Counter(tuple(sorted(map(tuple, pair))) for pair in points[ends].tolist())
        for points, ends in ((places, edges), (expected, shot.edges))
    )
    assert drawn == wanted
    assert (steps > 0).sum() == np.isfinite(shot.depth).sum()


def test_depth_grows_along_the_scale(frame):
    shot = gallery.shot_of(frame, "keyframe")
    shot = replace(
        shot, depth=np.geomspace(1, 100, len(shot.depth)).astype(np.float32), uv=np.linspace((0, 0), (1, 1), 36)
    )
    steps = read(gallery.drawing_of(shot, (1.0, 100.0)))[1]
    assert (steps[0], steps[-1]) == (1, 255)
    assert (np.diff(steps) >= 0).all()


def test_an_image_is_at_most_480_px_wide_and_keeps_its_shape(frame):
    image = np.zeros((300, 1200, 3), np.uint8)
    assert gallery.shot_of(replace(frame, image=image), "lost").size == (480, 120)
    assert gallery.shot_of(frame, "lost").size == (90, 60)


def test_a_frame_of_very_many_points_is_drawn_thinned_without_its_mesh(frame, monkeypatch):
    monkeypatch.setattr(gallery, "MOST_POINTS", 10)
    shot = gallery.shot_of(frame, "keyframe")
    assert (len(shot.uv), len(shot.edges)) == (9, 0)


def test_at_most_120_frames_are_chosen_evenly_and_it_is_said(frame):
    chosen = gallery.thinned(range(1000))
    assert (len(chosen), chosen[0], chosen[-1]) == (120, 0, 999)
    assert set(np.diff(chosen)) == {8, 9}
    page = gallery.gallery_section([gallery.shot_of(frame, "keyframe")], 1000)
    assert "1 of 1000 stored frames are here, evenly chosen" in page
    assert gallery.gallery_section([], 0) == ""


def test_each_image_is_once_in_the_page_and_named_by_its_frame(frame):
    shots = [gallery.shot_of(replace(frame, index=k), "keyframe") for k in (3, 9)]
    page = gallery.gallery_section(shots, 2)
    assert re.findall(r'<img data-frame="(\d+)"', page) == ["3", "9"]
    assert page.count("data:image/jpeg") == 2


def test_every_frame_has_its_cell_and_every_state_a_height_of_its_own():
    states = frames(*STATES)
    page = strip_section(states)
    assert re.findall(r'<g class="(\w+)"><title>', page) == list(STATES)
    looks = set(LOOK.values())
    assert len(looks) == len(STATES) == len({(height, mark) for height, mark in looks})
    assert summary_of(states) == "6 frames: 1 lost, 1 skipped, 1 weak, 1 loop, 1 keyframe, 1 tracked"
    assert f'aria-label="{summary_of(states)}"' in page


def test_many_frames_share_cells_that_show_the_worst_and_it_is_said():
    states = frames(*["tracked"] * 1000, "lost", *["keyframe"] * 1999)
    page = strip_section(states)
    cells = re.findall(r'<g class="(\w+)"><title>(.*?)</title>', page)
    assert len(cells) == 3000 // 8 <= MOST_CELLS
    assert "Each cell is 8 frames, as the worst of them went" in page
    assert [title for state, title in cells if state == "lost"] == [
        "frames 1000 to 1007: lost in frame 1000, 100 landmarks (image 1000)"
    ]
    assert "1 lost" in page
    assert "1999 keyframe" in page.replace("\N{NARROW NO-BREAK SPACE}", "")


def test_a_run_of_one_frame_has_no_strip():
    assert strip_section(frames("keyframe")) == strip_section([]) == ""


def test_a_line_stands_where_a_further_recording_begins():
    page = strip_section(frames(*["tracked"] * 6), [(4, EVIL)])
    assert page.count('class="begin"') == 1
    assert 'd="M39.5 0V100"' in page
    assert EVIL not in page
    many = strip_section(frames(*["tracked"] * (2 * MOST_CELLS)), [(MOST_CELLS, "b")])  # two frames a cell
    assert f'd="M{5 * MOST_CELLS - 0.5:g} 0V100"' in many


def test_recordings_are_told_apart_and_those_that_no_run_writes_are_left_out():
    first = {"name": "a", "first": 0, "frames": 3, "tracked": 3, "keyframes": 2, "evaluation": {"ate_rmse_m": 0.01234}}
    by = {"recording": "a", "frame": 3, "landmarks": 99}
    second = first | {"name": EVIL, "first": 3, "joined_by": by, "loops_to_others": 1}
    page = recordings_section([first, second, first | {"name": "c", "first": 6, "joined_by": None}])
    assert page.count("<tr><td>") == 3
    assert EVIL not in page
    assert "3 to 5" in page
    assert "to a at frame 3, by 99 landmarks, and 1 loop<" in page
    assert "was not found" in page
    assert "0.0123" in page
    for wrong in (None, [], "a", [1], [{"name": "a"}], [first | {"first": "0"}]):
        assert recordings_section(wrong) == ""


def test_warnings_of_one_code_stand_together_with_what_to_do_once():
    many = [{"code": "frame_skipped", "message": f"frame {k}: gone"} for k in range(MOST_OF_A_KIND + 4)]
    page = warnings_section([*many, "plain"])
    assert page.count(text(ADVICE["frame_skipped"])) == 1
    assert f"frame {MOST_OF_A_KIND}:" not in page
    assert "and 4 more of this kind" in page
    assert "<p>plain</p>" in page
    assert warnings_section([]) == ""


def test_it_is_said_why_a_run_is_not_complete():
    run = {
        "status": "degraded",
        "warnings": [{"code": "tracking_lost", "message": ""}, {"code": "bits", "message": ""}],
    }
    assert REASONS["tracking_lost"] in why_degraded(run)
    assert why_degraded(run | {"status": "complete"}) == ""
    assert REASONS.keys() <= ADVICE.keys()


def test_advice_is_one_plain_sentence_or_two_and_names_no_code():
    for code, words in ADVICE.items():
        assert words[0].isupper(), code
        assert words.endswith("."), code
        assert 20 < len(words) < 160, code
        assert "_" not in words.replace("detector_", ""), code


@pytest.mark.parametrize(
    "timings",
    [
        {},
        {"frames": {}},
        {"frames": [1], "map_s": "x", "total_s": None},
        {"frames": {"a": {"follow": 0.1}}, "total_s": 1.0},
        {"frames": {EVIL: {EVIL: 0.1, "follow": True}, "b": {"follow": float("nan")}, "c": 3}, "map_s": 1e99},
        {"frames": {str(k): {"follow": 0.1 + k, "write": 1.0} for k in range(1000)}, "map_s": 2, "total_s": 5.5},
    ],
)
def test_the_picture_of_the_times_is_well_formed_whatever_they_are(timings):
    svg = timings_svg(timings)
    root = ElementTree.fromstring(svg)
    assert root.tag.endswith("svg")
    assert not re.search(r"nan|inf|href", svg)
    assert timings_svg(timings) == svg


def test_the_picture_shows_seconds_of_each_stage_and_of_each_frame():
    svg = timings_svg(
        {"frames": {"a": {"follow": 1.0, "write": 9.0}, "b": {"follow": 3.0}}, "map_s": 2.0, "total_s": 5.0}
    )
    for words in ("tracking", "4.00 s", "writing keyframes", "making the map", "2.00 s", "most 3 s, median 2 s"):
        assert words in svg
    assert "2 frames processed, 5.0 s in all" in svg


def test_times_are_a_picture_or_words_on_where_they_are():
    assert '<p class="quiet">beside &lt;it&gt;</p>' in timings_section("beside <it>")
    within = timings_section({"frames": {"a": {"follow": 1.0}}})
    assert 'src="data:image/svg+xml;base64,' in within
    assert "tracking 1.00 s" in within
    assert timings_section(None) == ""


def test_a_thinned_curve_keeps_its_peaks():
    height = np.full(10 * MOST_POINTS, 100.0)
    height[777] = 0.0
    x, kept = coarse(np.arange(len(height), dtype=float), height)
    assert len(x) == MOST_POINTS
    assert x[np.argmin(kept)] == 777


def test_verdicts_have_words_and_marks():
    page = health_section([Finding("Rows", verdict, "so and so") for verdict in MARKS])
    assert [word for word in MARKS if f"</span> {word}</span>" in page] == list(MARKS)
    assert health_section([]) == ""


def test_settings_that_differ_are_shown_with_default_and_unit():
    row = {"value": 800, "default": 2000, "unit": "keypoints", "meaning": "Keypoints wanted."}
    page = settings_section({"detector.count": row})
    assert "<td>detector.count</td><td>800</td><td>2\N{NARROW NO-BREAK SPACE}000</td><td>keypoints</td>" in page
    assert "All settings are the defaults" in settings_section({})
    assert settings_section(None) == ""


def test_a_very_long_table_is_cut_and_it_is_said():
    run = {"per_frame": [{"index": k} for k in range(MOST_ROWS + 5)]}
    page = numbers_section(run, folded=True, told=frozenset())
    assert page.count("<tr>") == MOST_ROWS + 1
    assert f"The first {MOST_ROWS} of {MOST_ROWS + 5} rows" in page


def test_no_text_closes_a_script_or_turns_the_page():
    said = data_of({"words": EVIL, "ends": "<!-- & \u2028"})
    assert "<" not in said
    assert json.loads(said)["words"] == EVIL
    assert said.isascii()
    assert "\u202e" not in text(EVIL)
    assert "\\u202e" in text(EVIL)


def test_names_of_strangers_are_harmless_in_every_section(frame, tmp_path):
    shot = replace(gallery.shot_of(frame, "keyframe"), name=EVIL)
    whole = WholeRun(
        states=[FrameState(k, EVIL, 0.0, "lost", 3) for k in range(3)],
        findings=[Finding(EVIL, "fine", EVIL)],
        settings={EVIL: {"value": EVIL, "default": EVIL, "unit": EVIL, "meaning": EVIL}},
        shots=[shot],
        stored=1,
        timings={"frames": {EVIL: {EVIL: 1.0}}},
        missing=[EVIL],
    )
    run = {"source": EVIL, "status": EVIL, "frames": 3, "warnings": [{"code": EVIL, "message": EVIL}]}
    run["evaluation"] = dict.fromkeys(("matched", "total", "ate_rmse_m"), EVIL) | {"scale": 10**400}
    page = write_report(frame, run, [], tmp_path / "a.html", whole=whole).read_text(encoding="utf-8")
    plain = re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL)
    assert "<img src=x" not in page
    assert "\u202e" not in page
    assert "</script></title>" not in plain
    assert plain.count("longlong") > 5


def test_a_page_without_a_frame_shows_what_there_is(tmp_path):
    whole = WholeRun(states=frames("keyframe", "tracked"), missing=["frames/000000.npz: is gone"])
    page = write_report(None, {"source": "drive", "status": "x"}, [], tmp_path / "a.html", whole=whole)
    words = page.read_text(encoding="utf-8")
    assert "<title>TSP-SLAM report: drive</title>" in words
    assert "frames/000000.npz: is gone" in words
