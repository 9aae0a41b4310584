"""Every example has its place in the gallery, with a picture that its own objects draw."""

import importlib.util
import re
from pathlib import Path

import pytest
from PIL import Image

ROOT = Path(__file__).parents[1]
EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("[0-9]*.py"))  # ros2_node draws nothing
PAGE = (ROOT / "docs" / "gallery.rst").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def gallery():
    spec = importlib.util.spec_from_file_location("gallery", ROOT / "docs" / "gallery.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_each_example_has_a_picture_and_a_section_in_order(gallery):
    assert list(gallery.DRAWN) == EXAMPLES
    assert re.findall(r"^\.\. image:: images/gallery_(\w+)\.png$", PAGE, re.MULTILINE) == EXAMPLES
    assert re.findall(r":download:`(\w+)\.py <\.\./examples/\1\.py>`", PAGE) == EXAMPLES
    assert PAGE.count("   :alt: ") == len(EXAMPLES)
    kept = [ROOT / "docs" / "images" / f"gallery_{name}.png" for name in EXAMPLES]
    assert {size_of(path)[0] for path in kept} == {gallery.WIDTH}
    assert max(path.stat().st_size for path in kept) < 250_000


def size_of(path):
    with Image.open(path) as picture:
        return picture.size


@pytest.mark.parametrize("name", ["04_train_a_network", "05_flows_on_a_torus"])
def test_an_example_is_drawn_from_what_it_made(gallery, tmp_path, name):
    path = gallery.draw_example(name, tmp_path)
    assert size_of(path) == size_of(ROOT / "docs" / "images" / path.name)
    with Image.open(path) as picture:
        assert len(picture.convert("L").getcolors()) > 50  # something is on it
