"""What a page holds of a map or a frame: nothing is lost but what is said."""

from __future__ import annotations

import base64
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from view_maps import ODD_MAPS, PATH, map_of, room, sheet, wall

from tests.view.conftest import ODD_FRAMES
from tspslam.errors import InputError
from tspslam.view import _html
from tspslam.view import _thinning as thinning
from tspslam.view import _turning as turning
from tspslam.view._layers import layers_of_frame, layers_of_map, steps_of, table, ticks_of
from tspslam.view._space import QUANTA, STATES, Station, in_reach, pack, space_of_frame, space_of_map
from tspslam.view._thinning import kept


class Unpacked:
    """A scene as the browser reads it."""

    def __init__(self, words):
        self.meta = json.loads(words)
        self.data = base64.b64decode(self.meta["data"])
        self.n, self.f, self.e = (self.meta[x][2] // k for x, k in (("places", 3), ("faces", 3), ("edges", 2)))
        self.rows = {
            level: self.mask(self.meta["rows"][level], None, count)
            for level, count in (("vertex", self.n), ("edge", self.e), ("face", self.f))
        }

    def array(self, entry):
        kind, at, count = entry
        assert at % 4 == 0
        return np.frombuffer(self.data, np.dtype(kind).newbyteorder("<"), count, at)

    def bits(self, entry, count):
        if entry is None:
            return np.ones(count, bool)
        return np.unpackbits(self.array(entry), bitorder="little")[:count].astype(bool)

    def mask(self, entry, _, count):
        return np.arange(count) if entry is None else np.flatnonzero(self.bits(entry, 8 * entry[2]))

    @property
    def xyz(self):
        return np.array(self.meta["low"]) + self.array(self.meta["places"]).reshape(-1, 3) * self.meta["quantum"]


def unpacked(shown, most=thinning.MOST_FACES):
    return Unpacked(pack(shown, most).json())


def of_map(map_, stations=(), others=(), regions=None):
    return space_of_map(map_, layers_of_map(map_, regions), stations, others)


MAPS = [name for name in ODD_MAPS if name != "no face"]
FRAMES = [name for name in ODD_FRAMES if name not in ("no vertex",)]


@pytest.mark.parametrize("name", MAPS)
def test_every_value_of_a_map_keeps_its_step_and_every_place_to_half_a_quantum(name):
    map_ = ODD_MAPS[name]()
    check_all(of_map(map_), layers_of_map(map_), map_.xyz, map_.complex_)


@pytest.mark.parametrize("name", FRAMES)
def test_every_value_of_a_frame_keeps_its_step_and_every_place_to_half_a_quantum(name):
    frame = ODD_FRAMES[name]()
    layers = [x for x in layers_of_frame(frame) if x.level != "face" or len(frame.complex_.faces)]
    check_all(space_of_frame(frame), layers, frame.cloud.xyz, frame.complex_)


def check_all(space, layers, xyz, complex_):
    got = unpacked(space)
    rows = got.rows
    quantum = np.array(got.meta["quantum"])
    off = np.abs(got.xyz - xyz[rows["vertex"]])
    assert (off <= quantum / 2 * (1 + 1e-9) + 1e-12 * np.abs(xyz[rows["vertex"]])).all()
    assert quantum.max() <= max(np.ptp(xyz[rows["vertex"]], axis=0).max(), 1e-9) / QUANTA * (1 + 1e-9)
    for level, entry, width in (("face", "faces", 3), ("edge", "edges", 2)):
        corners = rows["vertex"][got.array(got.meta[entry]).reshape(-1, width).astype(np.int64)]
        assert np.array_equal(np.sort(corners, axis=1), getattr(complex_, entry)[rows[level]])
    assert [x["name"] for x in got.meta["layers"]] == [x.name for x in layers]
    for stored, layer in zip(got.meta["layers"], layers, strict=True):
        steps, chosen = got.array(stored["steps"]), rows[layer.level]
        ok = got.bits(stored["ok"], len(chosen))
        assert np.array_equal(ok, layer.ok[chosen])
        if layer.scale == "rgb":
            expected = np.rint(255 * layer.values[chosen]).astype(np.uint8)
            assert np.array_equal(steps.reshape(-1, 3)[ok], expected[ok])
        else:
            assert np.array_equal(steps, steps_of(layer)[chosen])
            assert np.array_equal(got.array(got.meta["tables"][layer.scale]).reshape(-1, 3), table(layer.scale))
        assert stored["ticks"] == [list(tick) for tick in ticks_of(layer)]


def test_the_same_map_gives_the_same_bytes():
    assert turning.map_to_turn(room()) == turning.map_to_turn(room())


def test_vertices_far_off_are_left_out_and_counted():
    space = of_map(ODD_MAPS["far outlier"]())
    got = unpacked(space)
    assert np.abs(got.xyz).max() < 10
    assert got.n == len(space.xyz) - 1
    assert "Vertices not shown, far off: 1." in turning.map_to_turn(ODD_MAPS["far outlier"]())


def test_nothing_of_no_vertices_is_in_reach():
    assert in_reach(np.zeros((0, 3))).shape == (0,)


def test_a_ceiling_is_marked_in_a_room_and_nowhere_else():
    got = unpacked(of_map(room()))
    below = got.bits(got.meta["ceiling"], got.f)
    assert (below.sum(), (~below).sum()) == (196, 98)
    assert unpacked(of_map(wall())).meta["ceiling"] is None
    assert 'name="ceiling"' in turning.map_to_turn(room())
    assert 'name="ceiling" checked' not in turning.map_to_turn(room())
    assert 'name="ceiling"' not in turning.map_to_turn(wall())


def test_the_keyframes_are_the_path_unless_stations_are_given():
    map_ = wall()
    stored = unpacked(of_map(map_))
    stations = stored.meta["stations"]
    assert np.array_equal(stored.array(stations["numbers"]), map_.keyframes)
    np.testing.assert_allclose(
        stored.array(stations["places"]).reshape(-1, 3), map_.T_world_camera[:, :3, 3], rtol=1e-6
    )
    lost = np.full((4, 4), np.nan)
    given = [Station(k, T, state) for k, (T, state) in enumerate(zip([np.eye(4)] * 4 + [lost], STATES, strict=True))]
    stored = unpacked(of_map(map_, given, [("the true path", PATH)]))
    stations = stored.meta["stations"]
    assert stored.array(stations["states"]).tolist() == [0, 1, 2, 3, 4]
    assert np.isnan(stored.array(stations["places"]).reshape(-1, 3)[4]).all()
    assert stored.array(stations["axes"])[:6].tolist() == [32767, 0, 0, 0, 32767, 0]
    assert stored.meta["others"][0]["words"] == "the true path"
    np.testing.assert_allclose(stored.array(stored.meta["others"][0]["places"]).reshape(-1, 3), PATH, rtol=1e-6)


def test_a_station_that_is_none_is_refused():
    with pytest.raises(
        InputError, match="view: frame 3 is 'gone', expected one of keyframe, tracked, weak, lost, loop"
    ):
        of_map(wall(), [Station(3, np.eye(4), "gone")])
    with pytest.raises(InputError, match=r"view: the pose of frame 3 has shape \(3, 4\), expected \(4, 4\)"):
        of_map(wall(), [Station(3, np.eye(4)[:3], "weak")])
    with pytest.raises(InputError, match=r"view: truth has places of shape \(6, 2\), expected \(T, 3\)"):
        of_map(wall(), others=[("truth", PATH[:, :2])])


def test_words_of_a_path_cannot_end_the_script():
    evil = "</script><script>alert(1)</script><!--"
    page = turning.map_to_turn(wall(), others=[(evil, PATH)])
    assert page.count("</script") == 2
    assert "<!--" not in page
    assert "</script" not in turning._script()


def test_a_page_may_run_no_words_as_script():
    assert not re.search(r"unsafe-eval|blob:|https?:", _html.POLICY)


def test_two_scenes_on_a_page_share_no_id():
    assert not re.search(r"\sid=", re.sub(r"<script.*?</script>", "", turning.map_to_turn(room()), flags=re.DOTALL))


def test_a_map_of_regions_begins_with_their_colours(monkeypatch):
    regions = np.linspace(0, 1, 3 * len(wall().surface.faces)).reshape(-1, 3)
    stored = unpacked(of_map(wall(), regions=regions))
    first = stored.meta["layers"][0]
    assert (first["name"], first["ticks"]) == ("regions", [])
    assert np.array_equal(stored.array(first["steps"]).reshape(-1, 3), np.rint(255 * regions).astype(np.uint8))
    assert re.search(r'value="0" checked><span>Regions<', turning.map_to_turn(wall(), regions))


def test_a_frame_without_faces_begins_with_its_points(odd):
    page = turning.frame_to_turn(odd("no faces"))
    assert "The points in space" in page
    assert re.search(r"checked><span>Luminance of vertices<", page)
    assert 'name="points" checked' in page
    assert 'name="surface"' not in page
    assert "This frame has no points to show" in turning.frame_to_turn(odd("no vertex"))


def test_a_map_without_a_value_is_still_shown():
    page = turning.map_to_turn(ODD_MAPS["all marked"]())
    assert "<canvas" in page
    assert 'value="' in page


# ---- thinning ----


def tube(turns=60, rings=40):
    """A closed tube, a torus, as vertices, faces and edges."""
    a, b = (x.ravel() for x in np.meshgrid(np.arange(turns), np.arange(rings), indexing="ij"))
    u, v = 2 * np.pi * a / turns, 2 * np.pi * b / rings
    far = 3 + np.cos(v) * (1 + 0.2 * np.sin(5 * u))
    xyz = np.stack([far * np.cos(u), np.sin(v), far * np.sin(u)], axis=1)

    def at(i, j):
        return (i % turns) * rings + j % rings

    square = np.stack([at(a, b), at(a + 1, b), at(a + 1, b + 1), at(a, b + 1)], axis=1)
    faces = np.concatenate([square[:, [0, 1, 2]], square[:, [0, 2, 3]]])
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1), axis=0)
    return xyz, faces, edges


def parts(count, edges):
    graph = coo_array((np.ones(len(edges)), edges.T), shape=(count, count))
    return connected_components(graph, directed=False)[0]


@pytest.mark.parametrize("most", [2000, 700, 60, 4])
def test_a_thinned_surface_keeps_under_its_limit_and_within_a_cell(most):
    xyz, faces, edges = tube()
    left = kept(xyz, faces, edges, np.ones(len(xyz), bool), most)
    assert len(left.faces) <= most
    assert most < 60 or len(left.faces) > most // 4  # not far less than there is room for
    assert cKDTree(xyz[left.vertices]).query(xyz)[0].max() <= np.sqrt(3) * left.cell
    for rows, corners, whole in ((left.faces, left.corners, faces), (left.edges, left.ends, edges)):
        assert (np.diff(rows) > 0).all()
        assert (np.diff(np.sort(corners, axis=1), axis=1) > 0).all()
        assert len(np.unique(np.sort(corners, axis=1), axis=0)) == len(corners)
        moved = np.linalg.norm(xyz[left.vertices[corners]] - xyz[whole[rows]], axis=2)
        assert moved.max(initial=0) <= np.sqrt(3) * left.cell


@pytest.mark.parametrize("most", [2000, 700, 60, 4])
def test_what_was_connected_stays_connected(most):
    xyz, faces, edges = tube()
    both, twice = np.concatenate([xyz, xyz + np.array([20.0, 0, 0])]), len(xyz)
    faces, edges = (np.concatenate([x, x + twice]) for x in (faces, edges))
    left = kept(both, faces, edges, np.ones(len(both), bool), most)
    side = xyz[:, 0].max() < both[left.vertices, 0]
    for part in (side, ~side):
        inside = part[left.ends].all(axis=1)
        assert parts(len(part), left.ends[inside]) - (~part).sum() == 1
    assert not (side[left.ends[:, 0]] ^ side[left.ends[:, 1]]).any()


def test_a_surface_that_fits_is_left_as_it_is():
    xyz, faces, edges = tube()
    keep = xyz[:, 0] > 0
    left = kept(xyz, faces, edges, keep)
    assert left.cell == 0
    assert np.array_equal(left.vertices, np.flatnonzero(keep))
    assert np.array_equal(left.vertices[left.corners], faces[keep[faces].all(axis=1)])
    assert np.array_equal(left.vertices[left.ends], edges[keep[edges].all(axis=1)])


def test_of_faces_that_fall_together_the_largest_stays():
    xyz = np.array([[0, 0, 0], [10, 0, 0], [0, 10, 0], [0.1, 0, 0], [10, 0.2, 0], [0, 10.3, 0], [5, 5, 40.0]])
    faces = np.array([[0, 1, 2], [3, 4, 5], [0, 1, 6]])
    edges = np.array([[0, 1], [3, 4], [0, 3]])
    left = thinning._merged(kept(xyz, faces, edges, np.ones(7, bool)), xyz, 1.0)
    assert left.faces.tolist() == [1, 2]
    assert left.edges.tolist() == [0]


def test_a_thinned_map_says_so_and_keeps_the_values_of_what_is_left(monkeypatch):
    big = map_of([sheet((-3, -2, 4), (6, 0, 0), (0, 4, 0), 30)], PATH)
    space = of_map(big)
    got = unpacked(space, 300)
    assert got.f <= 300
    for stored, layer in zip(got.meta["layers"], space.layers, strict=True):
        if layer.scale != "rgb":
            assert np.array_equal(got.array(stored["steps"]), steps_of(layer)[got.rows[layer.level]])
    np.testing.assert_allclose(got.xyz, big.xyz[got.rows["vertex"]], atol=1e-4)
    packed = pack(space, 300)
    words = turning._left_out(packed)
    assert f"from 1682 faces to {got.f}: vertices in one cell of {packed.kept.cell:.2g} m are one" in words
    assert pack(space, 300).json() == packed.json()


def test_many_points_are_thinned_too(build):
    frame = build(faces=np.empty((0, 3), np.int32))
    packed = pack(space_of_frame(frame), 20)
    assert len(packed.kept.vertices) <= 20
    assert "from 36 points to" in turning._left_out(packed)


def test_places_that_are_one_pack(build):
    frame = ODD_FRAMES["all at one place"]()
    assert unpacked(space_of_frame(frame), 10).n == 1
    assert unpacked(of_map(replace(wall(), xyz=np.ones_like(wall().xyz)))).f == 128
