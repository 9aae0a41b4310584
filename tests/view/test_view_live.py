"""What the live viewer draws and says, without a browser; none of it needs viser."""

from __future__ import annotations

import http.client
import http.server
import json
import socket
import struct
import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from view_maps import ODD_MAPS, room, wall

from tests.patience import PATIENCE
from tspslam.errors import InputError, OutputError
from tspslam.view._layers import Layer, layers_of_map
from tspslam.view.live import _drawn
from tspslam.view.live._drawn import draw_frame, draw_map
from tspslam.view.live._element import element_at, element_of, value_of
from tspslam.view.live._gate import Gate, is_loopback
from tspslam.view.live._glb import LINES, glb_of
from tspslam.view.live._images import OVERLAYS, PATCH, jpeg_of, overlaid, patch, pixels_of, sheet, shrunk
from tspslam.view.live._server import free_port
from tspslam.view.live._stage import frustums, quaternion
from tspslam.view.live._words import element_page, legend, status_page
from tspslam.view.live.world import World

LEVELS = ("vertex", "edge", "face")


def unpacked(data):
    """Document and body of a binary glTF, its lengths checked."""
    magic, version, length, text = struct.unpack_from("<4sIII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    document = json.loads(data[20 : 20 + text])
    size, kind = struct.unpack_from("<I4s", data, 20 + text)
    assert kind == b"BIN\0"
    assert size == document["buffers"][0]["byteLength"] == len(data) - 28 - text
    return document, data[28 + text :]


@pytest.mark.parametrize("mode", [LINES, 4])
def test_places_and_colours_survive_packing(mode):
    random = np.random.default_rng(0)
    xyz, rgb = random.normal(size=(6, 3)), random.integers(0, 256, (6, 3)).astype(np.uint8)
    document, body = unpacked(glb_of(xyz, rgb, mode))
    assert document["meshes"][0]["primitives"][0]["mode"] == mode
    np.testing.assert_array_equal(np.frombuffer(body[:72], "<f4").reshape(6, 3), xyz.astype(np.float32))
    linear = np.frombuffer(body[72:], "<u2").reshape(6, 4)[:, :3] / 65535
    back = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    np.testing.assert_array_equal(np.rint(255 * back), rgb)
    assert glb_of(xyz, rgb, mode) == glb_of(xyz, rgb, mode)


@pytest.mark.parametrize("name", ODD_MAPS)
def test_every_map_is_drawn(name):
    map_ = ODD_MAPS[name]()
    drawn = draw_map(map_)
    rows = drawn.rows(has_ceiling=True)
    assert sorted(rows) == np.flatnonzero(drawn.is_in_reach[drawn.faces].all(axis=1)).tolist()
    for layer in [None, *drawn.layers]:
        assert drawn.corner_colours(layer, rows).shape == (3 * len(rows), 3)
        assert legend(layer)
    for level in LEVELS:
        for number in range(min(3, len(getattr(map_.signals, level)))):
            assert element_page(element_of(drawn, level, number))


def test_every_frame_is_drawn(odd_frame):
    T = np.eye(4)
    T[:3, 3] = 1, 2, 3
    drawn = draw_frame(odd_frame, T)
    for layer in [None, *drawn.layers]:
        rows = drawn.rows(has_ceiling=False)
        assert drawn.corner_colours(layer, rows).shape == (3 * len(rows), 3)
    good = np.isfinite(odd_frame.cloud.xyz).all(axis=1)
    np.testing.assert_allclose(drawn.xyz[good], odd_frame.cloud.xyz[good] + T[:3, 3])
    for name in OVERLAYS.values():
        pixels = overlaid(odd_frame, name)
        assert pixels.dtype == np.uint8
        assert pixels.shape[2] == 3


def test_tiles_are_places():
    """Faces that follow each other are near each other: the mean step is a small part of the whole."""
    drawn = draw_map(wall())
    centres = drawn.xyz[drawn.faces[drawn.rows(has_ceiling=True)]].mean(axis=1)
    assert np.linalg.norm(np.diff(centres, axis=0), axis=1).mean() < 0.2 * np.linalg.norm(np.ptp(centres, axis=0))


def nearest_by_hand(drawn, origin, along, rows):
    """Distance to the nearest of some faces along a ray: each is solved for by itself."""
    found = np.inf
    for a, b, c in drawn.xyz[drawn.faces[rows]]:
        matrix = np.stack([-along, b - a, c - a], axis=1)
        if abs(np.linalg.det(matrix)) > 1e-12:
            t, u, v = np.linalg.solve(matrix, origin - a)
            if t > 0 and u >= 0 and v >= 0 and u + v <= 1:
                found = min(found, t)
    return found


def test_a_ray_meets_the_nearest_face():
    drawn, random = draw_map(room()), np.random.default_rng(1)
    hits = 0
    for _ in range(60):
        along = random.normal(size=3)
        along /= np.linalg.norm(along)
        origin = random.uniform((-1, -1, 1), (1, 1, 4))
        for has_ceiling in (True, False):
            expected = nearest_by_hand(drawn, origin, along, drawn.rows(has_ceiling=has_ceiling))
            found = drawn.hit(origin, along, has_ceiling=has_ceiling)
            assert (found is None) == np.isinf(expected)
            if found is not None:
                hits += 1
                assert np.linalg.norm(found[1] - origin) == pytest.approx(expected)
    assert hits > 20


def test_a_hidden_ceiling_is_not_met():
    drawn, up = draw_map(room()), np.array([0.0, -1.0, 0.0])
    assert drawn.is_ceiling.any()
    above = drawn.hit(np.array([0.1, 0.0, 3.1]), up, has_ceiling=True)
    assert drawn.is_ceiling[above[0]]
    assert drawn.hit(np.array([0.1, 0.0, 3.1]), up, has_ceiling=False) is None


def test_the_element_next_to_a_click_is_of_the_level_that_is_coloured():
    drawn = draw_map(wall())
    face = 17
    a, b, c = drawn.xyz[drawn.faces[face]]
    point = 0.9 * a + 0.07 * b + 0.03 * c
    assert element_at(drawn, face, point, "face").number == face
    assert element_at(drawn, face, point, "vertex").number == drawn.faces[face][0]
    edge = element_at(drawn, face, point, "edge")
    assert sorted(edge.vertices) == sorted(drawn.faces[face][:2]) == sorted(drawn.edges[edge.number])


def test_a_point_next_to_a_ray_is_found_without_a_surface():
    drawn = draw_map(wall())
    along = drawn.xyz[7] / np.linalg.norm(drawn.xyz[7])
    assert drawn.nearest_vertex(np.zeros(3), along) == 7
    assert drawn.nearest_vertex(np.zeros(3), -along) is None


def test_an_element_is_seen_where_all_its_vertices_are():
    map_ = wall()
    seen = map_.observations
    keep = ~((seen.vertex == 40) & (seen.keyframe == 3))
    start = np.searchsorted(seen.vertex[keep], np.arange(len(map_) + 1))
    fewer = replace(
        seen, start=start, keyframe=seen.keyframe[keep], uv=seen.uv[keep], disparity=seen.disparity[keep],
        weight=seen.weight[keep],
    )  # fmt: skip
    drawn = draw_map(replace(map_, observations=fewer))
    face = int(np.flatnonzero((drawn.faces == 40).any(axis=1))[0])
    numbers = {each.number for each in element_of(drawn, "face", face).sightings}
    all_numbers = {each.number for each in element_of(draw_map(map_), "face", face).sightings}
    assert all_numbers - numbers == {int(map_.keyframes[3])}
    assert numbers


def test_a_sighting_is_where_the_camera_has_the_place():
    map_ = wall()
    T = map_.T_world_camera.copy()
    T[0, :3, 3] = map_.xyz[40] - (0, 0, 2)  # straight before it
    first = element_of(draw_map(replace(map_, T_world_camera=T)), "vertex", 40).sightings[0]
    np.testing.assert_allclose(first.uv, (map_.rig.cx, map_.rig.cy))
    assert first.number == map_.keyframes[0]


def test_values_have_their_units():
    two = np.ones(2, bool)

    def said(values, unit, scale="viridis", **more):
        return value_of(Layer("x", "X", "vertex", np.asarray(values, float), two, unit, scale, (0, 1), "", **more), 1)

    assert said([0, 1.0], "m", is_log=True) == "10 m"
    assert said([0, 3.0], "keyframes") == "3 keyframes"
    assert said([0, 0.5], "luminance") == "0.5"
    assert said([0, -1.25], "arg r [rad]", "phase") == "-1.25 rad"
    assert said([[0, 0, 0], [1, 0.5, 0]], "", "rgb") == "1.00, 0.50, 0.00"
    missing = Layer("x", "X", "vertex", np.zeros(2), ~two, "m", "viridis", (0, 1), "")
    assert value_of(missing, 0) == "none"


def test_a_legend_says_unit_ticks_and_scale():
    layer = next(each for each in layers_of_map(wall()) if each.name == "magnitude")
    page = legend(layer)
    assert "|r|, logarithmic" in page
    assert "linear-gradient" in page
    assert page.count("<span") >= 2


def test_names_from_files_are_text():
    hard = World("<script>a</script>", "live", is_live=True, missing=("<img src=x>",) * 30)
    page = status_page(hard, ["<b>"])
    assert "<script" not in page
    assert "<img" not in page
    assert "&lt;img" in page
    assert "and 19 more" in page


def test_points_are_drawn_where_they_are(frame):
    plain, marked = overlaid(frame, None), overlaid(frame, "depth")
    changed = np.argwhere((plain != marked).any(axis=2))
    spots = frame.cloud.uv[:, ::-1]
    gaps = np.linalg.norm(changed[:, None] - spots[None], axis=2)
    assert gaps.min(axis=0).max() < 1.5
    assert gaps.min(axis=1).max() < 4


def test_a_patch_is_centred_on_its_place():
    image = np.zeros((60, 90), np.uint8)
    image[20:27, 40:47] = 255
    found = patch(image, np.array([43.0, 23.0]), "frame 0")[:PATCH]
    bright = np.argwhere(found.min(axis=2) > 200)
    np.testing.assert_allclose(bright.mean(axis=0), (PATCH - 1) / 2, atol=1.5)
    assert sheet([found] * 4).shape[0] > PATCH < sheet([found] * 4).shape[1]


def test_images_survive_as_jpeg():
    image = np.add.outer(np.arange(60), np.arange(90)).astype(np.uint8)
    small = shrunk(image, 45)
    assert small.shape == (30, 45, 3)
    assert np.abs(pixels_of(jpeg_of(small)).astype(int) - small).mean() < 3


def test_quaternions_are_the_rotations():
    turns = [*Rotation.random(20, random_state=0), *Rotation.from_rotvec(np.pi * np.eye(3)), Rotation.identity()]
    for turn in turns:
        w, x, y, z = quaternion(turn.as_matrix())
        assert w >= -1e-12
        np.testing.assert_allclose(Rotation.from_quat([x, y, z, w]).as_matrix(), turn.as_matrix(), atol=1e-9)


def test_a_frustum_ends_at_the_corners_of_the_image():
    map_ = wall()
    ends = frustums(map_.T_world_camera, map_.rig, 0.5).reshape(len(map_.keyframes), 8, 2, 3)
    for lines, T in zip(ends, map_.T_world_camera, strict=True):
        x, y, z = ((lines[:4, 1] - T[:3, 3]) @ T[:3, :3]).T
        np.testing.assert_allclose(z, 0.5)
        u, v = map_.rig.fx * x / z + map_.rig.cx, map_.rig.fy * y / z + map_.rig.cy
        assert sorted(u.tolist()) == pytest.approx([-0.5, -0.5, 89.5, 89.5])
        assert sorted(v.tolist()) == pytest.approx([-0.5, -0.5, 59.5, 59.5])


def test_a_busy_port_is_passed_over():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        port = taken.getsockname()[1]
        assert port < free_port("127.0.0.1", port) < port + 100


def test_a_host_that_is_not_this_machine_is_refused():
    for host in ("192.0.2.1", "a" * 300, ".....", "no\nname"):
        with pytest.raises(InputError, match=r"--host .*expected an address of this machine") as error:
            free_port(host, 8080)
        assert "\n" not in str(error.value)


def test_ports_may_run_out(monkeypatch):
    from tspslam.view.live import _server

    monkeypatch.setattr(_server, "TRIED", 1)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen(1)
        with pytest.raises(OutputError, match="are in use"):
            free_port("127.0.0.1", taken.getsockname()[1])


class Inside(http.server.BaseHTTPRequestHandler):
    """What the gate guards."""

    def do_GET(self):
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"the run")

    def log_message(self, *_):
        pass


@pytest.fixture(params=[True])
def gate(request):
    inner = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Inside)
    thread = threading.Thread(target=inner.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    made = Gate("127.0.0.1", 0, inner.server_address[1], is_open=request.param)
    yield made
    made.close()
    inner.shutdown()
    inner.server_close()
    thread.join()


def asked(gate, path="/", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=PATIENCE)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, answer.read(), answer.getheader("Set-Cookie")
    connection.close()
    return found


def test_without_the_token_nothing_is_served(gate):
    wrong = [("/", {}), ("/?token=", {}), ("/?token=x" + gate.token, {}), ("/", {"Cookie": f"tspslam_{gate.port}=no"})]
    for path, headers in [*wrong, ("/x?token=", {"Upgrade": "websocket"})]:
        status, body, cookie = asked(gate, path, **headers)
        assert (status, cookie) == (403, None)
        assert b"the run" not in body
        assert gate.token.encode() not in body


def test_with_the_token_all_is_served(gate):
    status, body, cookie = asked(gate, f"/?token={gate.token}")
    assert status == 303
    assert not body
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert asked(gate, Cookie=cookie.split(";")[0])[:2] == (200, b"the run")


def test_a_page_from_elsewhere_is_refused(gate):
    cookie = f"tspslam_{gate.port}={gate.token}"
    assert asked(gate, Cookie=cookie, Origin="http://elsewhere.example")[0] == 403
    assert asked(gate, Cookie=cookie, Origin=f"http://127.0.0.1:{gate.port}")[0] == 200


@pytest.mark.parametrize("gate", [False], indirect=True)
def test_on_this_machine_only_its_own_page_is_served(gate):
    own = f"127.0.0.1:{gate.port}"
    assert gate.token is None
    assert asked(gate)[:2] == (200, b"the run")
    assert asked(gate, Host=f"localhost:{gate.port}", Origin=f"http://localhost:{gate.port}")[0] == 200
    wrong = {"Host": "evil.example"}, {"Host": f"evil.example:{gate.port}"}, {"Origin": "http://evil.example"}
    for headers in (*wrong, {"Host": own, "Origin": "null"}, {"Host": own, "Origin": "http://["}):
        assert asked(gate, **headers)[0] == 403
        assert asked(gate, Upgrade="websocket", Connection="Upgrade", **headers)[0] == 403


@pytest.mark.parametrize(("host", "is_own"), [("127.1", True), ("0x7f.1", True), ("::1", True), ("LOCALHOST", True),
                                          ("0.0.0.0", False), ("a" * 300, False), ("", False)])  # fmt: skip
def test_this_machine_has_several_names(host, is_own):
    assert is_loopback(host) is is_own


@pytest.mark.parametrize("gate", [True, False], indirect=True)
def test_what_is_no_request_is_refused_without_a_word(gate, capfd):
    for data in (b"\x00\xff\r\n\r\n", b"GET\r\n\r\n", b"A" * 70_000, b"GET //[ HTTP/1.1\r\nHost: x\r\n\r\n"):
        with socket.create_connection(("127.0.0.1", gate.port), timeout=PATIENCE) as guest:
            guest.sendall(data)
            assert guest.recv(12) == b"HTTP/1.1 403"
    assert capfd.readouterr() == ("", "")


def test_a_large_map_is_sent_in_tiles():
    assert _drawn.TILE * 56 < 2e6  # bytes of a message, of 3 corners of 20 bytes a face less
