"""Pictures and pages of what was made of a map."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from view_maps import ODD_MAPS, room

from tspslam.errors import InputError
from tspslam.topology.complex import build_complex
from tspslam.view import _style as style
from tspslam.view.uses import region_colours, write_denoised_picture, write_regions_picture, write_use_page


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(style, "DPI", 35)


@pytest.mark.parametrize("name", ODD_MAPS)
def test_every_map_can_be_drawn_in_regions_and_denoised(name, tmp_path):
    map_ = ODD_MAPS[name]()
    labels = np.arange(len(map_.surface.faces)) // 3
    paths = [
        write_regions_picture(map_, labels, tmp_path / "new" / "r.png"),
        write_denoised_picture(map_, map_, tmp_path / "d.png"),
    ]
    for path in paths:
        with Image.open(path) as picture:
            assert picture.size[0] == 350
    page = write_use_page(map_, "<Regions>", [("regions", 3)], paths, tmp_path / "a.html", labels=labels)
    assert "<h1>&lt;Regions&gt;</h1>" in page.read_text("utf-8")


def test_the_same_regions_give_the_same_bytes(tmp_path):
    labels = np.arange(len(room().surface.faces)) % 5
    first, second = (write_regions_picture(room(), labels, tmp_path / name).read_bytes() for name in "ab")
    assert first == second


def test_neighbouring_numbers_differ_in_colour():
    colours = region_colours(np.arange(500))
    assert np.abs(np.diff(colours, axis=0)).max(axis=1).min() > 0.2
    assert np.array_equal(colours[[7, 7]], region_colours(np.array([7, 7])))


def test_labels_that_do_not_fit_are_refused(tmp_path):
    count = len(room().surface.faces)
    with pytest.raises(InputError, match=f"view: 3 labels for {count} faces, expected one a face"):
        write_regions_picture(room(), np.arange(3), tmp_path / "a.png")
    with pytest.raises(InputError, match=f"view: 3 labels for {count} faces, expected one a face"):
        write_use_page(room(), "", [], [], tmp_path / "a.html", labels=np.arange(3))


def test_maps_with_other_faces_are_refused(tmp_path):
    complex_ = room().complex_
    other = replace(room(), complex_=build_complex(complex_.faces[::-1], complex_.n))
    with pytest.raises(InputError, match="view: the two maps have other faces"):
        write_denoised_picture(room(), other, tmp_path / "a.png")
