from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from view_maps import ODD_MAPS, PATH, map_of, room, sheet, wall

from tspslam.errors import InputError, OutputError
from tspslam.view import _map_page as page
from tspslam.view import _raster as raster
from tspslam.view import _style as style
from tspslam.view import _viewpoints as viewpoints
from tspslam.view import map_pictures as p
from tspslam.view import write_map_pictures
from tspslam.view._map import tangents

NAMES = ["map_path", "map_above", "map_response", "map_variance"]


@pytest.fixture
def coarse(monkeypatch):
    """Small pictures, for the sake of time."""
    monkeypatch.setattr(style, "DPI", 35)


def words(figure):
    return " ".join(t.get_text().replace("\n", " ") for t in figure.texts)


def legend(axes):
    found = axes.get_legend()
    return [t.get_text() for t in found.get_texts()] if found else []


def both(map_):
    return viewpoints.from_above(map_), viewpoints.from_path(map_)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize("name", ODD_MAPS)
def test_every_map_gives_every_picture_without_a_warning(name, tmp_path):
    paths = write_map_pictures(ODD_MAPS[name](), tmp_path / "new" / "pictures")
    assert [path.stem for path in paths] == NAMES
    assert sorted((tmp_path / "new" / "pictures").iterdir()) == sorted(paths)
    for path in paths:
        with Image.open(path) as picture:
            assert picture.size[0] == 350
            assert len(picture.convert("RGB").getcolors(1 << 20)) > 20


@pytest.mark.usefixtures("coarse")
def test_the_same_map_gives_the_same_bytes(tmp_path):
    first, second = (write_map_pictures(room(), tmp_path / k) for k in "ab")
    assert [x.read_bytes() for x in first] == [x.read_bytes() for x in second]


def test_the_nearest_face_is_seen_whatever_the_order():
    near, far = (np.array([[0.0, 0, k], [9, 0, k], [0, 9, k]]) for k in (2.0, 1.0))
    for order in ((0, 1), (1, 0)):
        owner = raster.find_owners(np.stack([near, far])[list(order)], np.array(order), (6, 6))
        assert set(np.unique(owner)) == {-1, 0}


def test_triangles_that_meet_leave_no_gap():
    rng = np.random.default_rng(0)
    xyz, faces = sheet((0, 0, 1), (40, 0, 0), (0, 40, 0), 8)
    xyz[:, :2] += rng.uniform(-2, 2, (len(xyz), 2)) * ((xyz[:, :2] > 0) & (xyz[:, :2] < 40))
    owner = raster.find_owners(xyz[faces], np.arange(len(faces)), (41, 41))
    assert (owner >= 0).all()


def test_what_reaches_behind_the_viewer_is_cut_not_dropped():
    ground = np.array([[[-50.0, 1, -3], [50, 1, -3], [0, 1, 200]]])
    corners, rows = raster.cut_near(ground, 0.1)
    assert (corners[..., 2] >= 0.1 - 1e-9).all()
    assert set(rows) == {0}
    total = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    width = 100 * (200 - 0.1) / 203
    assert total == pytest.approx(width * (200 - 0.1) / 2)


def test_the_picture_from_above_is_not_mirrored_and_its_longer_side_lies_across():
    map_ = map_of([sheet((-2, 1, 20), (4, 0, 0), (0, 0, -20), 6)], PATH)
    outlook = viewpoints.from_above(map_)
    np.testing.assert_allclose(np.linalg.det(outlook.axes), 1)
    ahead, right = (outlook.place(np.array([x])) - outlook.place(np.zeros((1, 3))) for x in ([0, 0, 1.0], [1.0, 0, 0]))
    np.testing.assert_allclose(ahead, [[outlook.scale, 0]], atol=1e-9)
    np.testing.assert_allclose(right, [[0, outlook.scale]], atol=1e-9)  # what is at the right hand lies below


def test_ceilings_are_left_out_from_above_and_counted():
    map_ = room()
    is_down = viewpoints.is_overhead(map_)
    assert is_down.sum() == len(map_.surface.faces) / 3
    outlook = viewpoints.from_above(map_)
    assert not outlook.pixels[is_down].any()
    assert f"{is_down.sum()} faces that look down" in words(p.above_picture(map_, both(map_)))


def test_most_of_a_plane_is_shown_in_its_colour_where_it_is():
    map_ = room()
    outlook = viewpoints.from_above(map_)
    middle = map_.xyz[map_.surface.faces].mean(axis=1)
    floor = np.flatnonzero((outlook.pixels > 0) & (np.abs(middle[:, 1] - 1.5) < 1e-9))
    column, row = (np.rint(outlook.place(middle[floor]) * viewpoints.FINER).astype(int)).T
    assert (outlook.owner[row, column] == floor).mean() > 0.9


def test_faces_that_stand_up_are_seen_from_above():
    map_ = wall()
    outlook = viewpoints.from_above(map_)
    assert (outlook.owner >= 0).any(axis=0).mean() > 0.5
    assert (outlook.owner >= 0).sum(axis=0).max() >= 3


def test_a_stray_vertex_does_not_set_the_extent():
    xyz, faces = sheet((-2, 1, 6), (4, 0, 0), (0, 0, -6), 20)
    near = viewpoints.from_above(map_of([(xyz, faces)], PATH)).scale
    xyz[-1] = 1e5
    assert viewpoints.from_above(map_of([(xyz, faces)], PATH)).scale == pytest.approx(near, rel=0.1)


def test_from_the_path_backs_of_faces_hide_nothing():
    map_ = map_of([sheet((-3, -2, 4), (6, 0, 0), (0, 4, 0), 5), sheet((3, -2, 3), (-6, 0, 0), (0, 4, 0), 5)], PATH)
    assert viewpoints.from_path(map_).pixels[: len(map_.surface.faces) // 2].any()
    assert not viewpoints.from_path(map_).pixels[len(map_.surface.faces) // 2 :].any()


def test_the_viewer_stands_at_the_keyframe_of_the_middle_that_sees_most():
    map_ = wall()
    weight = map_.observations.weight * (map_.observations.keyframe != 2)
    assert viewpoints.middle_keyframe(map_) == 2
    blind = replace(map_, observations=replace(map_.observations, weight=weight))
    assert viewpoints.middle_keyframe(blind) == 3


@pytest.mark.parametrize(
    ("direction", "angle"), [((1.0, 0, 0), 0.0), ((0, 1.0, 0), np.pi / 2), ((0, -1.0, 0), -np.pi / 2)]
)
def test_directions_in_the_wall_lie_so_on_the_picture_from_the_path(direction, angle):
    map_ = wall()
    map_ = replace(map_, direction=np.tile(direction, (len(map_), 1)))
    outlook = replace(viewpoints.from_path(map_), axes=np.eye(3), eye=np.zeros(3))
    found, length = tangents(map_, outlook)
    np.testing.assert_allclose(found, angle, atol=1e-9)
    np.testing.assert_allclose(length, 1)


def test_directions_across_the_picture_are_grey():
    map_ = wall()
    map_ = replace(map_, direction=np.tile([0, 1.0, 0], (len(map_), 1)))
    angle, length = tangents(map_, viewpoints.from_above(map_))
    np.testing.assert_allclose(length, 0, atol=1e-9)
    rgb = page.direction_colours(angle, length, np.ones(len(angle)))
    np.testing.assert_allclose(np.ptp(rgb, axis=1), 0, atol=1e-9)


def test_pale_faces_are_named_only_where_there_are_some():
    whole, marked = wall(), ODD_MAPS["all marked"]()
    seen = "seen by no keyframe, or too slanted"
    assert seen not in legend(p.above_picture(whole, both(whole)).axes[0])
    assert seen in legend(p.above_picture(marked, both(marked)).axes[0])
    once = replace(whole, view_count=type(whole.view_count)(*(np.ones_like(x) for x in whole.view_count)))
    assert "seen by fewer than two keyframes" in legend(p.variance_picture(once, both(once)).axes[0])


def test_the_response_is_shown_where_more_of_it_is_seen():
    assert "From the middle of the path" in words(p.response_picture(wall(), both(wall())))
    floor = map_of([sheet((-20, 1.5, 60), (40, 0, 0), (0, 0, -60), 20)], PATH)
    assert "From above" in words(p.response_picture(floor, both(floor)))


def test_the_scale_bar_is_of_a_round_length_and_true():
    map_ = room()
    outlook = viewpoints.from_above(map_)
    axes = p.above_picture(map_, (outlook, outlook)).axes[0]
    (label,) = [t.get_text() for t in axes.texts if t.get_text().endswith(" m")]
    (bar,) = [line for line in axes.lines if len(line.get_xdata()) == 4 and line.get_color() == style.INK]
    assert float(label[:-2]) * outlook.scale == pytest.approx(np.ptp(bar.get_xdata()))
    assert label[:-2].strip("0.") in {"1", "2", "5", "25"}


@pytest.mark.parametrize(
    "change",
    [
        lambda m: replace(m, direction=m.direction[1:]),
        lambda m: replace(m, keyframes=m.keyframes[:0], T_world_camera=m.T_world_camera[:0]),
        lambda m: replace(m, xyz=np.where(np.arange(len(m))[:, None] == 2, np.nan, m.xyz)),
        lambda m: m.xyz,
    ],
)
def test_a_map_whose_parts_do_not_belong_together_is_an_input_error(change, tmp_path):
    with pytest.raises(InputError, match="map"):
        write_map_pictures(change(wall()), tmp_path / "pictures")
    assert not (tmp_path / "pictures").exists()


def test_a_folder_that_cannot_be_made_is_an_output_error(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(OutputError):
        write_map_pictures(wall(), tmp_path / "taken")
