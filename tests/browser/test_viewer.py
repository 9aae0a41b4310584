"""The viewer in a real browser: it draws, answers, follows, and stays on this machine."""

import importlib.util
import io
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tspslam.run.config import resolve
from tspslam.run.pipeline import run

from ..sequences import SETTINGS, corridor
from ..serving import served

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("viser") is None, reason="no viser: pip install 'tspslam[viewer]'"
)
SCENE = {"x": 0, "y": 170, "width": 550, "height": 420}  # clear of the panel, and of a warning of software rendering
PATIENCE = 60_000  # ms
SWITCHES = ("Surface", "Edges", "Points", "Path", "Cameras", "Pictures")


@pytest.fixture(scope="module")
def sequence():
    return corridor(2.5)


@pytest.fixture(scope="module")
def finished(sequence, tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs") / "corridor"
    run(sequence, folder, resolve(assignments=SETTINGS))
    return folder


@pytest.fixture
def viewer(finished):
    """Process and address of a viewer of a finished run."""
    with served(finished, "--port", 0) as (process, lines):
        yield process, lines[-1].split()[1]


def scene(page):
    """What the canvas shows, as levels of grey."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot(clip=SCENE))).convert("L")).astype(float)


def settled(page, good):
    """The scene, once it is as it should be and stays so."""
    before = scene(page)
    for _ in range(120):
        page.wait_for_timeout(250)
        now = scene(page)
        if good(now) and np.abs(now - before).max() == 0:
            return now
        before = now
    raise AssertionError("the scene does not come to be as expected")


def is_drawn(pixels):
    return pixels.std() > 5


def is_flat(pixels):
    return pixels.std() < 0.5


def differs(before):
    return lambda now: np.count_nonzero(np.abs(now - before) > 10) > 20  # pixels


def control(page, label):
    name = page.locator("label", has_text=re.compile(f"^{label}$")).last.get_attribute("for")
    return page.locator(f'[id="{name}"]')


def choose(page, label, words):
    control(page, label).click()
    page.get_by_role("option", name=words, exact=True).click()


def opened(open_page, address):
    page, heard = open_page(address, width=1000, height=600)
    page.set_default_timeout(PATIENCE)
    page.get_by_text("Layers", exact=True).wait_for()
    return page, heard


def listening(process):
    """Addresses at which a process listens, as the system's tables have them."""
    links = [link.readlink() for link in Path(f"/proc/{process.pid}/fd").iterdir() if link.is_symlink()]
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[3] == "0A" and Path(f"socket:[{columns[9]}]") in links:
                found.append(columns[1].split(":")[0])
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="no /proc/net here")
def test_it_listens_on_this_machine_alone(viewer):
    assert set(listening(viewer[0])) == {"0100007F"}  # 127.0.0.1: the door, and viser behind it


def test_it_draws_and_is_flat_where_all_is_hidden(viewer, open_page):
    """The same measure that sees the surface sees that nothing is there: so it is the surface that it saw."""
    page, heard = opened(open_page, viewer[1])
    settled(page, is_drawn)
    for name in ("Path", "Cameras", "Pictures"):
        control(page, name).click()
    settled(page, is_drawn)
    control(page, "Surface").click()
    settled(page, is_flat)
    assert not heard.foreign
    assert len(heard.requests) > 1
    assert not heard.errors


def test_each_switch_and_each_colour_changes_the_picture(viewer, open_page):
    page, heard = opened(open_page, viewer[1])
    before = settled(page, is_drawn)
    for name in SWITCHES:
        control(page, name).click()
        before = settled(page, differs(before))
    for name in SWITCHES:
        control(page, name).click()
    before = settled(page, differs(before))
    control(page, "Colour").click()
    options = page.get_by_role("option").all_inner_texts()
    page.keyboard.press("Escape")
    assert "Magnitude" in options
    assert "Luminance of faces" in options
    for words in [
        each for each in options if each in ("Magnitude", "Direction", "Views of faces", "Luminance of edges")
    ]:
        choose(page, "Colour", words)
        before = settled(page, differs(before))
    assert not heard.errors


def test_the_slider_moves_the_camera_and_the_image(viewer, open_page):
    page, heard = opened(open_page, viewer[1])
    before = settled(page, is_drawn)
    page.get_by_text("frame 0, keyframe").wait_for()
    page.get_by_role("slider").first.focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    page.get_by_text(re.compile("^frame 3, ")).wait_for()
    settled(page, differs(before))
    image = page.locator("img").last
    plain = image.get_attribute("src")
    choose(page, "Over the image", "Mesh")
    page.wait_for_function("([image, plain]) => image.src !== plain", arg=[image.element_handle(), plain])
    assert not heard.errors


def test_a_click_is_answered(viewer, open_page):
    page, heard = opened(open_page, viewer[1])
    settled(page, is_drawn)
    page.get_by_text("Click on the surface").wait_for()
    pixels = scene(page)
    for v, u in np.argwhere(np.abs(pixels - np.median(pixels[-20:])) > 60)[:: max(1, pixels.size // 2000)][:40]:
        page.mouse.click(int(u) + SCENE["x"], int(v) + SCENE["y"])
        page.wait_for_timeout(300)
        if page.get_by_text(re.compile(r"^face \d+$")).count():
            break
    page.get_by_text(re.compile(r"^face \d+$")).wait_for()
    page.get_by_text(re.compile(r"matched in \d+ frame")).wait_for()
    assert page.get_by_text("Views of faces", exact=True).count()
    assert not heard.errors


def test_a_run_is_followed_while_it_is_written(sequence, tmp_path, open_page):
    with served(tmp_path, "--port", 0) as (process, lines):
        page, heard = opened(open_page, lines[-1].split()[1])
        page.get_by_text("no run here yet").wait_for()
        empty = settled(page, lambda now: True)

        def on_frame(frame):
            if frame.index == len(sequence) - 1:  # what was stored so far is seen before the run ends
                page.get_by_text(re.compile("live: [1-9]")).wait_for()
                settled(page, differs(empty))

        run(sequence, tmp_path / ".", resolve(assignments=SETTINGS), on_frame=on_frame)
        page.get_by_text("complete: ").wait_for()
        page.get_by_text("Surface of", exact=True).wait_for()
        settled(page, is_drawn)
        assert process.poll() is None
        page.context.close()  # nobody looks any more
        again, more = opened(open_page, lines[-1].split()[1])
        settled(again, is_drawn)
        assert not heard.foreign + more.foreign
        assert not heard.errors + more.errors


def test_one_frame_is_shown_by_itself(finished, open_page):
    with served(finished, "--port", 0, "--frame", 0) as (_, lines):
        page, heard = opened(open_page, lines[-1].split()[1])
        settled(page, is_drawn)
        choose(page, "Colour", "Phase")
        page.get_by_text("arg r [rad]").wait_for()
        assert not heard.errors
