"""The report in a real browser, from disk, with the network cut."""

import itertools
from dataclasses import replace

import pytest

from tspslam import InputError, StereoPair
from tspslam.run.config import resolve
from tspslam.run.mesh import filter_mesh
from tspslam.run.pipeline import OnePair, run
from tspslam.run.report import write_page
from tspslam.topology.harmonic import Tmahf

from ..sequences import SETTINGS, SMALL_RIG, corridor

HOSTILE = "</script><img src=x onerror=alert(1)>\"'\u202e" + "long" * 75


class Drive:
    """A corridor with a name that would do harm, two dark pairs and a bad one, and its true path."""

    name = HOSTILE

    def __init__(self):
        self.pairs = corridor(6.0, SMALL_RIG)
        self.rig, self.truth, self.stamps = self.pairs.rig, self.pairs.truth, self.pairs.stamps

    def __len__(self):
        return len(self.pairs)

    def __getitem__(self, index):
        if index == 9:
            raise InputError(f"{HOSTILE}: is torn")
        pair = replace(self.pairs[index], name=f"{HOSTILE}{index}")
        dark = {"left": 0 * pair.left, "right": 0 * pair.right}
        return StereoPair(**{**vars(pair), **dark}) if index in (6, 7) else pair


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("report") / "drive"
    run(Drive(), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture(scope="module")
def handed_on(made, tmp_path_factory):
    return write_page(made, tmp_path_factory.mktemp("page") / "page.html").path


def findings(page):
    """What axe-core finds that is serious, a line each."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe-playwright-python").Axe()
    violations = axe.run(page).response["violations"]
    return [
        f"{one['id']}: {node['html'][:200]}"
        for one in violations
        if one["impact"] in ("serious", "critical")
        for node in one["nodes"]
    ]


def test_a_run_s_own_report_asks_for_nothing(made, open_page):
    page, heard = open_page(made / "report.html")
    page.wait_for_function("[...document.images].filter((i) => i.loading !== 'lazy').every((i) => i.complete)")
    assert heard.errors == []
    asked = [url.rsplit("/", 1)[-1] for url in heard.requests if url.startswith("file:")]
    assert asked == ["report.html"]
    assert heard.foreign == []
    page.get_by_text("timings.json beside it has them").wait_for()


def test_the_page_to_hand_on_asks_for_nothing_at_all(handed_on, open_page):
    page, heard = open_page(handed_on)
    assert heard.errors == []
    assert [url for url in heard.requests if not url.startswith(("data:", "blob:"))] == [f"file://{handed_on}"]
    assert page.evaluate("document.querySelector('.timings img').naturalWidth") == 640


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 390])
def test_axe_finds_nothing_serious(handed_on, open_page, scheme, width):
    page, _ = open_page(handed_on, width=width, color_scheme=scheme)
    assert findings(page) == []


def test_nothing_is_wider_than_a_phone(handed_on, open_page):
    page, _ = open_page(handed_on, width=390, has_touch=True, is_mobile=True, device_scale_factor=2)
    for details in page.locator("details").all():
        details.evaluate("(it) => { it.open = true; }")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_headings_are_in_order_and_landmarks_are_there(handed_on, open_page):
    page, _ = open_page(handed_on)
    levels = page.evaluate("[...document.querySelectorAll('h1, h2, h3')].map((h) => Number(h.tagName[1]))")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.locator("main").count() == page.locator("nav").count() == page.locator("body > footer").count() == 1
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.className") == "skip"
    page.keyboard.press("Enter")
    assert page.evaluate("document.activeElement.id") == "main"


def pixels(page):
    """The drawing over the image: how many pixels are drawn on, and their sum."""
    return page.evaluate(
        """() => { const c = document.querySelector(".screen canvas");
        const data = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
        let drawn = 0, sum = 0;
        for (let k = 0; k < data.length; k += 4) { drawn += data[k + 3] > 0; sum += data[k] * data[k + 3]; }
        return [drawn, sum]; }"""
    )


def test_the_gallery_is_paged_by_buttons_keys_and_previews(handed_on, open_page):
    page, heard = open_page(handed_on)
    said, large = page.locator(".gallery .said"), page.locator(".large")
    count = page.locator(".previews button").count()
    assert said.inner_text().startswith(f"1 of {count}: frame 0,")
    first = large.get_attribute("src")
    page.get_by_role("button", name="Next").click()
    assert said.inner_text().startswith(f"2 of {count}:")
    assert large.get_attribute("src") != first
    page.keyboard.press("ArrowLeft")
    assert large.get_attribute("src") == first
    assert page.locator(".previous").get_attribute("aria-disabled") == "true"
    page.keyboard.press("ArrowRight")
    page.get_by_role("button", name="Previous").click()
    assert said.inner_text().startswith("1 of")
    page.keyboard.press("End")
    assert said.inner_text().startswith(f"{count} of {count}:")
    page.locator(".previews button").nth(1).click()
    assert said.inner_text().startswith("2 of")
    page.keyboard.press("ArrowRight")
    assert said.inner_text().startswith("3 of")
    assert page.evaluate("document.activeElement.getAttribute('aria-current')") == "true"
    assert page.locator(".previews [aria-current]").count() == 1
    assert heard.errors == []


def test_keypoints_and_mesh_are_drawn_and_can_be_switched_off(handed_on, open_page):
    page, _ = open_page(handed_on)
    both = pixels(page)
    page.get_by_label("Mesh").uncheck()
    points = pixels(page)
    page.get_by_label("Keypoints by depth").uncheck()
    none = pixels(page)
    page.get_by_label("Mesh").check()
    mesh = pixels(page)
    assert none == [0, 0]
    assert both[0] > max(points[0], mesh[0]) > min(points[0], mesh[0]) > 100


def test_previews_have_a_size_and_show_their_image(handed_on, open_page):
    page, _ = open_page(handed_on)
    page.locator(".previews").scroll_into_view_if_needed()
    for preview in page.locator(".previews img").all():
        box = preview.bounding_box()
        assert box["height"] == 64
        assert box["width"] > 60


def test_names_of_strangers_do_nothing(handed_on, open_page):
    page, heard = open_page(handed_on)
    dialogs = []
    page.on("dialog", lambda dialog: dialogs.append(dialog.message))
    page.get_by_role("button", name="Next").click()
    assert page.locator("img[src='x']").count() == 0
    assert page.locator("h1").inner_text().startswith("</script><img")
    assert "\u202e" not in page.locator("body").inner_text()
    assert dialogs == heard.errors == []


def test_without_script_the_first_image_shows(handed_on, open_page):
    page, _ = open_page(handed_on, java_script_enabled=False)
    assert page.locator(".stage").is_hidden()
    assert page.locator(".previews img").first.bounding_box()["width"] > 200
    assert page.locator(".cells").is_visible()


def test_it_prints_with_one_frame_and_folded_tables(handed_on, open_page, tmp_path):
    page, _ = open_page(handed_on)
    page.emulate_media(media="print")
    assert page.locator(".previews img:visible").count() == 1
    assert page.locator(".on-paper").is_visible()
    assert page.locator(".stage").is_hidden()
    assert page.locator("details[open]").count() == 0
    assert page.locator("nav").is_hidden()
    pdf = page.pdf(path=tmp_path / "page.pdf", print_background=True)
    assert len(pdf) > 50_000
    assert pdf.count(b"/Type /Page\n") + pdf.count(b"/Type /Page ") >= 3


def test_a_single_pair_shows_its_image_without_a_strip_of_one(tmp_path, open_page):
    run(OnePair(Drive()[0]), tmp_path / "one", resolve(assignments=SETTINGS))
    page, heard = open_page(tmp_path / "one/report.html", width=390)
    assert page.locator(".screen").is_visible()
    assert page.locator(".previews").is_hidden()
    assert page.get_by_role("button", name="Next").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    page.emulate_media(media="print")
    assert page.locator(".previews img").is_visible()
    assert heard.errors == []


def test_a_page_of_a_mesh_is_sound_too(made, tmp_path, open_page, sequence):
    filter_mesh(made / "map.ply", sequence / "left/000.png", sequence / "calib.yaml", tmp_path / "mesh", Tmahf())
    page, heard = open_page(tmp_path / "mesh/report.html", width=390)
    assert heard.errors == []
    assert findings(page) == []
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_the_slider_and_the_gallery_follow_each_other(handed_on, open_page):
    page, heard = open_page(handed_on)
    said, slider = page.locator(".gallery .said"), page.locator(".space input[type=range]")
    last = slider.get_attribute("max")
    slider.fill(last)
    page.wait_for_function("() => !document.querySelector('.gallery .said').textContent.startsWith('1 of')")
    thumb = page.locator(".space .thumb")
    assert thumb.get_attribute("src") == page.locator(".gallery .large").get_attribute("src")
    page.locator(".gallery .previews button").first.click()
    assert said.inner_text().startswith("1 of")
    assert slider.input_value() == "0"
    assert thumb.get_attribute("src") == page.locator(".gallery .large").get_attribute("src")
    assert heard.errors == []
