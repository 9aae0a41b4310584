"""What is turned in space, in a real browser: it is drawn, each switch changes it, and keys, slider and clicks work."""

import base64
import io
import re

import numpy as np
import pytest
from PIL import Image

from tspslam.view._html import page_of
from tspslam.view._space import Station
from tspslam.view._turning import frame_to_turn, map_to_turn

from ..view.conftest import ODD_FRAMES, make_frame
from ..view.view_maps import ODD_MAPS, PATH, room, wall

WAIT = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"  # until it is drawn


def stations():
    """One a frame: the second is weak, the third lost, the fourth closes a loop."""
    states = ("keyframe", "weak", "lost", "loop", "tracked", "keyframe")
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, :3, 3] = PATH
    return [Station(10 * k, pose, state) for k, (pose, state) in enumerate(zip(T, states, strict=True))]


def thumbnail(level):
    """A picture, one colour, as an address."""
    buffer = io.BytesIO()
    Image.new("RGB", (64, 48), (level, 40, 40)).save(buffer, "PNG")
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()


@pytest.fixture
def shown(open_page, tmp_path):
    """Open a page of sections; gives the page, drawn, and what was heard."""

    def opened(*sections, width=820, height=700, **options):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}.html"
        path.write_text(page_of("Scene", ["<h1>Scene</h1>", *sections]), encoding="utf-8")
        page, heard = open_page(path, width=width, height=height, **options)
        page.set_default_timeout(60_000)  # ms
        page.wait_for_selector("canvas[data-drawn]", timeout=60_000)
        return page, heard

    return opened


def pixels(page, which=0):
    """The picture, (H, W, 3) int."""
    page.evaluate(WAIT)
    data = page.locator("canvas").nth(which).evaluate("canvas => canvas.toDataURL()")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data.split(",")[1]))).convert("RGB")).astype(int)


def redrawn(page, act):
    """Do something, and wait until the picture is drawn anew."""
    before = page.locator("canvas").get_attribute("data-draws")
    act()
    page.wait_for_function("before => document.querySelector('canvas').dataset.draws !== before", arg=before)


def changed(before, after):
    """Share of the pixels that differ."""
    return float((np.abs(before - after).max(axis=2) > 8).mean())


def colours(picture):
    """How many colours a picture has, and the share of its commonest."""
    count = np.bincount((picture @ np.array([1 << 16, 1 << 8, 1])).ravel())
    return np.count_nonzero(count), count.max() / count.sum()


def test_a_map_is_drawn_and_goes_flat_when_all_is_hidden(shown):
    page, heard = shown(map_to_turn(room()))
    kinds, commonest = colours(pixels(page))
    assert kinds > 200
    assert commonest < 0.9
    page.uncheck("[name=surface]")
    without = pixels(page)
    assert colours(without)[0] > 1
    assert colours(without)[1] > 0.9
    for name in ("path", "frustums"):
        page.uncheck(f"[name={name}]")
    assert colours(pixels(page)) == (1, 1.0)
    assert heard.errors == []
    assert [url for url in heard.requests if not url.startswith(("file:", "data:"))] == []


def test_each_layer_and_each_switch_changes_the_picture(shown):
    page, heard = shown(map_to_turn(room(), np.tile([0.2, 0.6, 0.9], (294, 1))))
    seen, labels = [pixels(page)], page.locator(".layers label")
    assert labels.count() == 10
    for k in range(1, labels.count()):
        labels.nth(k).click()
        seen.append(pixels(page))
        assert all(changed(old, seen[-1]) > 0.002 for old in seen[:-1]), labels.nth(k).inner_text()
        assert labels.nth(k).inner_text() in page.locator("canvas").get_attribute("aria-label")
        assert labels.nth(k).inner_text() in page.locator(".legend").inner_text()
    labels.nth(0).click()
    assert changed(seen[0], pixels(page)) == 0
    for name in ("ceiling", "edges", "points", "strokes"):
        before = pixels(page)
        page.check(f"[name={name}]")
        assert changed(before, pixels(page)) > 0.001, name
    assert heard.errors == []


def test_edges_are_there_while_their_layer_is(shown):
    page, _ = shown(map_to_turn(wall()))
    page.get_by_text("Luminance of edges", exact=True).click()
    assert page.is_checked("[name=edges]")
    page.get_by_text("Luminance of faces", exact=True).click()
    assert not page.is_checked("[name=edges]")
    page.check("[name=edges]")
    page.get_by_text("Luminance of edges", exact=True).click()
    page.get_by_text("Luminance of faces", exact=True).click()
    assert page.is_checked("[name=edges]")


def test_the_slider_moves_the_camera_and_says_which_frame(shown):
    gallery = "".join(f'<img data-frame="{k}" src="{thumbnail(level)}" alt="">' for k, level in ((10, 90), (30, 200)))
    page, heard = shown(map_to_turn(wall(), stations=stations()), gallery)
    slider, said = page.locator("input[type=range]"), page.locator(".time output")
    assert said.inner_text() == "frame 0, keyframe"
    assert not page.locator(".thumb").is_visible()
    before = pixels(page)
    for value, words, level in ((2, "frame 20, lost", 90), (3, "frame 30, loop", 200), (5, "frame 50, keyframe", 200)):
        slider.fill(str(value))
        assert said.inner_text() == words
        assert slider.get_attribute("aria-valuetext") == words
        after = pixels(page)
        assert changed(before, after) > 0.0005
        assert page.locator(".thumb").get_attribute("src") == thumbnail(level)
        before = after
    slider.focus()
    page.keyboard.press("ArrowLeft")
    assert said.inner_text() == "frame 40, tracked"
    assert heard.errors == []


def test_the_path_is_played_to_its_end_and_stops(shown):
    page, _ = shown(map_to_turn(wall(), stations=stations()))
    page.click(".play")
    assert page.locator(".play").inner_text() == "Pause"
    page.wait_for_function("() => document.querySelector('.play').textContent === 'Play'", timeout=60_000)
    assert page.locator(".time output").inner_text() == "frame 50, keyframe"


def test_a_frame_whose_place_is_not_known_has_no_camera_and_breaks_the_path(shown):
    gone = stations()
    gone[2] = Station(20, np.full((4, 4), np.nan), "lost")
    page, heard = shown(map_to_turn(wall(), stations=gone))
    page.uncheck("[name=surface]")
    before = pixels(page)
    page.locator("input[type=range]").fill("2")
    assert page.locator(".time output").inner_text() == "frame 20, lost"
    assert changed(before, pixels(page)) > 0.0005
    page.click("[data-view=path]")
    assert colours(pixels(page))[0] > 1
    assert heard.errors == []


def test_another_path_is_drawn_and_named(shown):
    page, _ = shown(map_to_turn(wall(), others=[("the true path", PATH + np.array([0.3, 0, 0]))]))
    assert "the true path" in page.locator(".keys").inner_text()
    before = pixels(page)
    page.uncheck("[name=path]")
    green = (before[..., 1] > before[..., 0] + 60) & (before[..., 1] > before[..., 2] + 20)
    assert green.sum() > 50
    after = pixels(page)
    assert not ((after[..., 1] > after[..., 0] + 60) & (after[..., 1] > after[..., 2] + 20)).any()


@pytest.mark.parametrize(
    ("layer", "words"),
    [
        ("Luminance of faces", r"Face \d+ at right \S+, down \S+, forward 4.00 m: Luminance of faces: 0\.\d+ \(lum"),
        ("Views of faces", r"Face \d+ at .* m: Views of faces: 6 keyframes"),
        ("Luminance of edges", r"Edge \d+ at right \S+, down \S+, forward 4.00 m: Luminance of edges: 0\.\d+ \("),
        ("Magnitude", r"Vertex \d+ at right \S+, down \S+, forward 4.00 m: Magnitude: \d(\.\d+)?( or \w+)? \(\|r\|\)"),
        ("Direction", r"Vertex \d+ at .* m: Direction: right 1.0, down .?0.0, forward .?0.0"),
        ("Depth", r"Vertex \d+ at .* m: Depth: [34]\.\d+ m"),
    ],
)
def test_a_click_says_what_is_there(shown, layer, words):
    page, heard = shown(map_to_turn(wall()))
    page.get_by_text(layer, exact=True).click()
    before = pixels(page)
    page.click("[data-view=path]")
    canvas = page.locator("canvas")
    box = canvas.bounding_box()
    spots = [(0.5 * box["width"] + dx, 0.3 * box["height"]) for dx in range(-60, 80, 20)]
    for x, y in spots:  # an edge is hit within 14 px
        canvas.click(position={"x": x, "y": y})
        if re.match(words, page.locator(".said").inner_text()):
            break
    assert re.match(words, page.locator(".said").inner_text()), page.locator(".said").inner_text()
    assert changed(before, pixels(page)) > 0
    canvas.click(position={"x": 3, "y": 3})
    assert page.locator(".said").inner_text() == "Nothing is there."
    assert heard.errors == []


def test_the_number_and_the_value_that_a_click_says_are_the_map_s(shown):
    map_ = ODD_MAPS["far outlier"]()  # the numbers are of the whole
    page, _ = shown(map_to_turn(map_))
    page.click("[data-view=above]")
    page.locator("canvas").click(position={"x": 390, "y": 250})
    said = page.locator(".said").inner_text().replace("\N{MINUS SIGN}", "-")
    number, *place, value = (float(x) for x in re.findall(r"-?\d+(?:\.\d+)?", said))
    corners = map_.xyz[map_.surface.faces[int(number)]]
    np.testing.assert_allclose(place, corners.mean(axis=0), atol=0.006)
    assert value == pytest.approx(map_.signals.face[int(number)], abs=0.01)


def test_keys_and_the_pointer_turn_move_and_zoom_and_all_is_reset(shown):
    page, heard = shown(map_to_turn(room()))
    start, canvas = pixels(page), page.locator("canvas")
    canvas.focus()
    for key in ("ArrowLeft", "ArrowUp", "Shift+ArrowRight", "+", "-"):
        before = pixels(page)
        page.keyboard.press(key)
        assert changed(before, pixels(page)) > 0.01, key
    page.keyboard.press("0")
    assert changed(start, pixels(page)) == 0
    box = canvas.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    for held in ("", "Shift"):
        before = pixels(page)
        if held:
            page.keyboard.down(held)
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(x + 60, y + 20, steps=3)
        page.mouse.up()
        if held:
            page.keyboard.up(held)
        assert changed(before, pixels(page)) > 0.01
    before, scrolled = pixels(page), page.evaluate("scrollY")
    redrawn(page, lambda: page.mouse.wheel(0, -200))
    assert changed(before, pixels(page)) > 0.01
    assert page.evaluate("scrollY") == scrolled
    page.click("[data-view=first]")
    assert changed(start, pixels(page)) == 0
    for view in ("above", "path"):
        before = pixels(page)
        page.click(f"[data-view={view}]")
        assert changed(before, pixels(page)) > 0.01
    assert heard.errors == []


def test_two_fingers_zoom_and_one_turns(shown):
    page, heard = shown(map_to_turn(room()), has_touch=True)
    touch = """([moves]) => {
      const canvas = document.querySelector("canvas"), box = canvas.getBoundingClientRect();
      canvas.setPointerCapture = () => {};
      for (const [type, id, x, y] of moves) canvas.dispatchEvent(new PointerEvent(type, { pointerId: id, bubbles: true,
        pointerType: "touch", clientX: box.left + x, clientY: box.top + y, isPrimary: id === 1, buttons: 1 }));
    }"""
    before = pixels(page)
    page.evaluate(touch, [[["pointerdown", 1, 200, 200], ["pointermove", 1, 260, 210], ["pointerup", 1, 260, 210]]])
    turned = pixels(page)
    assert changed(before, turned) > 0.01
    ruler = page.locator(".ruler").bounding_box()["width"], page.locator(".ruler").inner_text()
    pinch = [["pointerdown", 1, 200, 200], ["pointerdown", 2, 300, 200], ["pointermove", 2, 450, 200]]
    page.evaluate(touch, [[*pinch, ["pointerup", 1, 200, 200], ["pointerup", 2, 450, 200]]])
    assert changed(turned, pixels(page)) > 0.01
    assert ruler != (page.locator(".ruler").bounding_box()["width"], page.locator(".ruler").inner_text())
    assert page.locator(".said").inner_text().startswith("Click on the picture")
    assert heard.errors == []


def test_two_scenes_on_a_page_do_not_know_of_each_other(shown):
    page, heard = shown(map_to_turn(room()), frame_to_turn(make_frame()))
    page.wait_for_function("() => document.querySelectorAll('canvas[data-drawn]').length === 2")
    first, second = pixels(page), pixels(page, 1)
    page.locator(".space").nth(1).get_by_text("Phase", exact=True).click()
    assert changed(first, pixels(page)) == 0
    assert changed(second, pixels(page, 1)) > 0.01
    assert page.locator(".space").nth(0).locator("input:checked").first.get_attribute("value") == "0"
    assert page.locator(".wheel").count() == 1
    assert heard.errors == []


def test_nothing_is_drawn_while_nothing_changes(shown):
    page, _ = shown(map_to_turn(room()))
    pixels(page)
    before = page.locator("canvas").get_attribute("data-draws")
    for _ in range(20):
        page.evaluate(WAIT)
    assert page.locator("canvas").get_attribute("data-draws") == before


def test_a_lost_context_is_restored(shown):
    page, heard = shown(map_to_turn(room()))
    before = pixels(page)
    page.evaluate("""() => { window.lost = document.querySelector("canvas").getContext("webgl2")
      .getExtension("WEBGL_lose_context"); lost.loseContext(); }""")
    page.evaluate(WAIT)
    page.get_by_text("Magnitude", exact=True).click()
    page.get_by_text("Luminance of faces", exact=True).click()
    redrawn(page, lambda: page.evaluate("lost.restoreContext()"))
    assert changed(before, pixels(page)) < 0.001
    assert heard.errors == []


def test_without_webgl_there_is_a_sentence_and_the_page_goes_on(open_page, tmp_path):
    path = tmp_path / "page.html"
    off = "<script>HTMLCanvasElement.prototype.getContext = () => null;</script>"
    path.write_text(page_of("Scene", [off, map_to_turn(wall()), "<p>The rest.</p>"]), encoding="utf-8")
    page, heard = open_page(path)
    assert page.locator(".without").is_visible()
    assert not page.locator("canvas").is_visible()
    assert page.get_by_text("The rest.").is_visible()
    assert heard.errors == []
    page, _ = open_page(path, java_script_enabled=False)
    assert page.get_by_text("scripts are switched off").is_visible()


def test_a_dark_page_a_narrow_one_and_fine_pixels(shown):
    light, _ = shown(map_to_turn(room()))
    dark, _ = shown(map_to_turn(room()), color_scheme="dark")
    assert pixels(light)[2, 2].min() > 200
    assert pixels(dark)[2, 2].max() < 70
    dark.emulate_media(color_scheme="light")
    assert pixels(dark)[2, 2].min() > 200
    narrow, heard = shown(map_to_turn(room()), width=390, height=800, device_scale_factor=2)
    assert narrow.evaluate("document.documentElement.scrollWidth") <= 390
    assert pixels(narrow).shape[1] == 2 * narrow.locator("canvas").evaluate("canvas => canvas.clientWidth")
    redrawn(narrow, lambda: narrow.set_viewport_size({"width": 700, "height": 800}))
    assert pixels(narrow).shape[1] == 2 * narrow.locator("canvas").evaluate("canvas => canvas.clientWidth")
    assert heard.errors == []


def test_the_scene_is_printed(shown):
    page, _ = shown(map_to_turn(room()), color_scheme="dark")
    full = len(page.pdf(print_background=True))
    for name in ("surface", "path", "frustums"):
        page.uncheck(f"[name={name}]")
    pixels(page)
    assert full > 1.5 * len(page.pdf(print_background=True))


def test_nobody_is_shut_out(shown):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-playwright-python")
    for scheme in ("light", "dark"):
        page, _ = shown(map_to_turn(room(), stations=stations()), frame_to_turn(make_frame()), color_scheme=scheme)
        for layer in ("Luminance of faces", "Phase"):
            page.locator(".space").last.get_by_text(layer, exact=True).click()
            found = axe.Axe().run(page).response["violations"]
            grave = [(x["id"], x["nodes"][0]["html"]) for x in found if x["impact"] in ("serious", "critical")]
            assert grave == []


ODD = {name: lambda make=make: map_to_turn(make()) for name, make in ODD_MAPS.items()}
ODD |= {f"frame: {name}": lambda make=make: frame_to_turn(make()) for name, make in ODD_FRAMES.items()}


@pytest.mark.parametrize("first", range(0, len(ODD), 12))
def test_every_map_and_frame_is_drawn_without_a_word_of_complaint(shown, first):
    """A dozen on a page: a browser has room for sixteen."""
    names = list(ODD)[first : first + 12]
    page, heard = shown(*(f"<article>{ODD[name]()}</article>" for name in names), width=500, height=400)
    page.wait_for_function("() => document.querySelectorAll('canvas:not([data-drawn])').length === 0")
    for name, article in zip(names, page.locator("article").all(), strict=True):
        assert article.locator("canvas").count() == (name not in ("no face", "frame: no vertex")), name
    for view in ("above", "path", "first"):
        page.evaluate(f"""() => document.querySelectorAll("[data-view={view}]").forEach((button) => button.click())""")
        page.evaluate(WAIT)
    assert "NaN" not in page.locator("main").inner_text()
    assert heard.errors == []
