"""What a new user gives by mistake is named, with the way on; what is plainly meant works."""

import numpy as np
import pytest
from PIL import Image

import tspslam
from tspslam import InputError, Rig, StereoPair, build_cells, build_complex, sample_signals
from tspslam.topology.texture import luminance
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.features.orb import OrbDetector

RIG = Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)
SINGLE = Rig(fx=50, fy=50, cx=10, cy=5, width=20, height=10)
GREY = np.random.default_rng(0).integers(0, 256, (10, 20), np.uint8)
FLOAT = GREY / 255
UV = np.array([[2, 2], [12, 2], [2, 8], [12, 8.0]])
SQUARE = build_complex([[0, 1, 2], [1, 2, 3]])
SIGNALS = sample_signals(GREY, UV, SQUARE)
XYZ = np.column_stack([(UV - (10, 5)) / 50 * 4, np.full(4, 4.0)])
CLOUD = tspslam.Cloud(XYZ, UV, np.full(4, 1.25))
SURFACE = tspslam.Surface(SQUARE.faces)
PAIR = StereoPair(GREY, GREY, RIG)


def refused(function, *arguments, **settings):
    """The one line with which a call is refused."""
    with pytest.raises(InputError) as caught:
        function(*arguments, **settings)
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 250
    return line


@pytest.mark.parametrize(("call", "said", "reader"), [
    (lambda: sample_signals("a.png", UV, SQUARE), "image is the path 'a.png'", "tspslam.io.read_image(path)"),
    (lambda: tspslam.sample_vectors("a.png", UV, SQUARE), "image is the path 'a.png'", "tspslam.io.read_image"),
    (lambda: tspslam.chf("a.png"), "image is the path 'a.png'", "tspslam.io.read_image"),
    (lambda: tspslam.interop.from_arrays(XYZ, SQUARE.faces, "a.png", RIG), "image is the path", "tspslam.io.read_image"),
    (lambda: StereoPair("l.png", "r.png", RIG), "pair: left is the path 'l.png'", "tspslam.read_pair(left, right, cal"),
    (lambda: StereoPair(GREY, GREY, "c.yaml"), "pair: rig is the path 'c.yaml'", "tspslam.load_rig(path)"),
    (lambda: tspslam.reconstruct("a.png"), "pair is the path 'a.png'", "tspslam.read_pair(left, right, calib)"),
    (lambda: tspslam.Session("c.yaml"), "rig is the path 'c.yaml'", "tspslam.load_rig(path)"),
    (lambda: tspslam.delaunay_surface("x.ply"), "cloud is the path 'x.ply'", "tspslam.reconstruct(pair)"),
    (lambda: build_complex("x.ply"), "faces is the path 'x.ply'", "tspslam.io.read_mesh(path)"),
    (lambda: build_cells("x.ply"), "cells is the path 'x.ply'", "tspslam.io.read_mesh(path)"),
    (lambda: tspslam.cloud_from_depth(RIG, "z.png", UV), "depth map is the path", "tspslam.datasets.read_map(path)"),
    (lambda: tspslam.evaluate_trajectory("a.txt", "b.txt"), "estimate is the path", "tspslam.io.read_trajectory(path)"),
])  # fmt: skip
def test_the_path_of_a_file_is_not_what_it_holds_and_its_reader_is_named(call, said, reader):
    line = refused(call)
    assert said in line
    assert reader in line


@pytest.mark.parametrize("call", [
    lambda image: sample_signals(image, UV, SQUARE), luminance, tspslam.chf,
    lambda image: tspslam.sample_vectors(image, UV, SQUARE),
    lambda image: tspslam.interop.from_arrays(XYZ, SQUARE.faces, image, RIG),
    lambda image: tspslam.reconstruct(StereoPair(image, image, RIG)),
], ids=["signals", "luminance", "chf", "vectors", "from_arrays", "reconstruct"])  # fmt: skip
@pytest.mark.parametrize("colour", [False, True])
def test_float_images_are_luminance_in_0_to_1_wherever_one_enters(call, colour):
    def image(values):
        return np.stack([values] * 3, axis=2) if colour else values

    for dtype in (np.float32, np.float64):
        assert "expected 0 to 1 (float images)" in refused(call, image(GREY.astype(dtype)))
        assert refused(call, image(GREY.astype(dtype))).endswith("divide by 255")
    assert refused(call, image(257 * GREY.astype(np.float64))).endswith("divide by 65535")
    assert "from -0.5 to 0.5" in refused(call, image(np.linspace(-0.5, 0.5, 200).reshape(10, 20)))
    assert "np.clip(image, 0, 1)" in refused(call, image(1.02 * FLOAT / FLOAT.max()))
    holed = FLOAT.copy()
    holed[3, 3] = np.nan
    assert "no NaN" in refused(call, image(holed))


def test_other_fields_than_light_are_sampled_as_they_are():
    depth = 4 + 10 * FLOAT
    signals = sample_signals(depth, UV, SQUARE, channels="all")
    assert np.allclose(signals.vertex, 4 + 10 * SIGNALS.vertex)
    features = np.stack([depth, -depth, FLOAT, depth], axis=2)
    assert np.allclose(sample_signals(features, UV, SQUARE).face[:, 1], -signals.face)
    assert "divide by 255" in refused(sample_signals, np.stack([255 * FLOAT] * 3, 2), UV, SQUARE, channels="all")


def test_integers_are_not_looked_at():
    class Untouched(np.ndarray):
        def min(self, *_, **__):
            raise AssertionError("looked at")

        max = min

    for image in (GREY, GREY.astype(np.uint16)):
        sample_signals(image.view(Untouched), UV, SQUARE)


@pytest.mark.parametrize(("image", "said"), [
    (GREY.tolist(), "image is list, expected an array"),
    (GREY.astype(int), "image is int64, expected uint8, uint16 or float"),
    (GREY > 9, "image is bool, expected"),
    (np.zeros((3, 10, 20), np.uint8), r"channels last, np.moveaxis(image, 0, -1)"),
    (np.ma.masked_less(FLOAT, 0.5), "image is a masked array"),
    (PAIR, "image is StereoPair, expected an array"),
])  # fmt: skip
def test_what_is_no_image_is_said(image, said):
    assert said in refused(sample_signals, image, UV, SQUARE)


class OnADevice:
    """Like a tensor that NumPy cannot have."""

    def __array__(self, dtype=None, copy=None):
        raise TypeError("can't convert cuda:0 device type tensor to numpy")


@pytest.mark.parametrize(("uv", "said"), [
    (UV.T, "shape is (2, 4), expected (4, 2)"),
    (UV[:, :1], "shape is (4, 1), expected (4, 2)"),
    (CLOUD, "uv is Cloud (give its .uv)"),
    (OnADevice(), "uv is OnADevice and gives no array (can't convert cuda:0"),
    (np.ma.masked_less(UV, 5), "uv is a masked array, expected a plain one, such as uv.filled(np.nan)"),
    ([[1, 2], [3]], "rows of different lengths"),
    ([["a", "b"]] * 4, "real numbers"),
    (np.zeros((0, 2)), "shape is (0, 2), expected (4, 2)"),
])  # fmt: skip
def test_what_are_no_projections_is_said(uv, said):
    assert said in refused(sample_signals, GREY, uv, SQUARE)


def test_lists_and_tables_are_arrays():
    class Table:
        """Like a data frame: it gives an array of its numbers."""

        def __array__(self, dtype=None, copy=None):
            return UV

    for uv in (UV.tolist(), Table()):
        assert np.array_equal(sample_signals(GREY, uv, SQUARE).face, SIGNALS.face)


@pytest.mark.parametrize(("call", "said"), [
    (lambda: sample_signals(GREY, SQUARE, UV), "complex_ is float64 of shape (4, 2), expected a Complex"),
    (lambda: sample_signals(GREY, UV, SURFACE), "complex_ is Surface, expected a Complex"),
    (lambda: tspslam.tmahf(SQUARE, SIGNALS, UV), "signals is float64 of shape (4, 2), expected a Signals"),
    (lambda: tspslam.tmahf(SURFACE, UV, SIGNALS), "complex_ is Surface, expected a Complex"),
    (lambda: tspslam.tmahf_bank(SQUARE, UV, SIGNALS.vertex), "signals is float64 of shape (4,), expected a Signals"),
    (lambda: tspslam.hodge_decompose(np.zeros(5), SQUARE), "complex_ is float64 of shape (5,), expected a Complex"),
    (lambda: tspslam.harmonic_basis(SURFACE), "complex_ is Surface"),
    (lambda: tspslam.betti_numbers(SURFACE), "complex_ is Surface"),
    (lambda: tspslam.unsigned_laplacian(SURFACE, "edge"), "complex_ is Surface"),
    (lambda: tspslam.smooth_signals(SQUARE, SIGNALS.vertex, 1.0), "signals is float64 of shape (4,)"),
    (lambda: tspslam.geometry_signals(SQUARE, CLOUD, SIGNALS), "xyz is Cloud (give its .xyz)"),
    (lambda: tspslam.stack_signals(SIGNALS), "signals are one Signals, expected a sequence"),
    (lambda: tspslam.stack_signals([SIGNALS.vertex]), "one of the signals is float64 of shape (4,)"),
    (lambda: tspslam.sample_vectors(GREY, UV, SQUARE, "range"), "channels are 'range', expected a sequence"),
    (lambda: tspslam.heat_filter(SQUARE, SIGNALS.vertex, 1.0), "L is a complex, expected one of its Laplacians"),
    (lambda: tspslam.chebyshev_filter(SQUARE.L0, SIGNALS.vertex, 1.0), "response is float, expected a callable"),
    (lambda: tspslam.mahf(SQUARE, XYZ, SIGNALS.vertex), "faces is Complex (give its .faces)"),
    (lambda: tspslam.merge_cells(SURFACE, [0, 0]), "complex_ is Surface"),
    (lambda: tspslam.grow_labels(SURFACE, 2), "complex_ is Surface"),
    (lambda: tspslam.diagnose_surface(SURFACE, XYZ), "faces is Surface (give its .faces)"),
    (lambda: tspslam.delaunay_surface(XYZ), "cloud is float64 of shape (4, 3), expected a Cloud"),
    (lambda: tspslam.delaunay_surface(tspslam.Cloud(XYZ.tolist(), UV, UV[:, 0])), "xyz is list, expected an array"),
    (lambda: tspslam.visible_uv(XYZ, RIG), "rig is float64 of shape (4, 3), expected a Rig"),
    (lambda: tspslam.reconstruct((GREY, GREY)), "pair is tuple, expected a StereoPair"),
    (lambda: tspslam.reconstruct(PAIR, detector="sift"), "detector is 'sift', expected a callable, such as OrbDetector"),
    (lambda: tspslam.reconstruct(PAIR, detector=OrbDetector), "expected a callable, such as OrbDetector()"),
    (lambda: tspslam.reconstruct(PAIR, max_disparity="64"), "max_disparity is '64', expected a number or None"),
    (lambda: tspslam.Session(PAIR), "rig is StereoPair, expected a Rig"),
    (lambda: tspslam.Session(RIG, {"detector": "orb"}), "settings is dict, expected a Settings"),
    (lambda: tspslam.Session(RIG).process((GREY, GREY)), "pair is tuple, expected a StereoPair"),
    (lambda: tspslam.Settings(detector="sift"), "settings: detector is 'sift', expected a callable"),
    (lambda: tspslam.rectification(RIG), "rig is Rig, expected a RawRig"),
    (lambda: tspslam.load_rig(RIG), "path is Rig, expected the path of a file"),
    (lambda: tspslam.read_pair(GREY, GREY, RIG), "left image is uint8 of shape (10, 20), expected the path of a file"),
    (lambda: tspslam.datasets.StereoFolder(GREY), "path is uint8 of shape (10, 20), expected the path"),
    (lambda: tspslam.datasets.open_sequence(GREY), "path is uint8 of shape (10, 20), expected the path"),
    (lambda: tspslam.io.read_image(GREY), "path is uint8 of shape (10, 20), expected the path"),
    (lambda: tspslam.io.read_trajectory(XYZ), "path is float64 of shape (4, 3), expected the path"),
    (lambda: tspslam.load_run(RIG), "path is Rig, expected the path"),
    (lambda: tspslam.io.write_frame("x.npz", CLOUD), "frame is Cloud, expected a Frame: Session.process(pair) gives one"),
    (lambda: tspslam.io.write_ply("x.ply", CLOUD, SQUARE.faces), "xyz is Cloud (give its .xyz)"),
    (lambda: tspslam.io.write_vtu("x.vtu", SURFACE, XYZ), "complex_ is Surface, expected a Complex"),
    (lambda: tspslam.view.write_pictures(CLOUD, "pictures"), "frame is Cloud, expected a Frame"),
    (lambda: tspslam.interop.to_toponetx(SURFACE), "complex_ is Surface, expected a Complex"),
])  # fmt: skip
def test_one_thing_for_another_is_said_with_the_way_on(call, said):
    assert said in refused(call)


def test_the_number_of_vertices_is_that_of_the_faces_unless_it_is_given():
    faces = [[0, 3, 1], [1, 2, 3]]
    assert build_complex(faces).n == 4
    assert np.array_equal(build_complex(faces).edges, build_complex(faces, 4).edges)
    assert build_complex(faces, 6).n == 6
    assert build_complex(faces, edges=[[1, 7]]).n == 8
    assert build_complex([]).n == build_complex(np.zeros((0, 3), int)).n == 0
    assert build_complex([], edges=[[0, 4]]).n == 5
    assert build_cells([[0, 1, 2, 5]]).n == 6
    assert build_cells([], edges=[[0, 4]]).n == 5
    for wrong in (4.0, True, XYZ):
        assert "n is" in refused(build_complex, faces, wrong)


@pytest.mark.parametrize(("faces", "said"), [
    ([[1, 2, 3], [2, 3, 4]], "they look counted from 1, so give faces - 1"),
    (np.array([[0.0, 1, 2]]), "faces are float64, expected integers"),
    ([[0, 1, 2, 3]], "expected (count, 3); build_cells takes polygons"),
    ([[0, 1, -1]], "face 0 is [0, 1, -1]"),
    (SURFACE, "faces is Surface (give its .faces)"),
])  # fmt: skip
def test_what_are_no_faces_is_said(faces, said):
    assert said in refused(build_complex, faces, 4)


def test_a_single_camera_needs_no_baseline_where_there_is_no_stereo():
    assert SINGLE.baseline == 0
    assert Rig(50, 50, 10, 5, 0, 20, 10) == SINGLE
    textured = tspslam.interop.from_arrays(XYZ, SQUARE.faces, GREY, SINGLE)
    paired = tspslam.interop.from_arrays(XYZ, SQUARE.faces, GREY, RIG)
    assert np.array_equal(textured.signals.face, paired.signals.face)
    assert np.isnan(textured.cloud.disparity).all()


@pytest.mark.parametrize("call", [
    lambda: tspslam.reconstruct(StereoPair(GREY, GREY, SINGLE)), lambda: tspslam.Session(SINGLE),
    lambda: tspslam.cloud_from_disparity(SINGLE, np.ones((10, 20)), UV),
    lambda: tspslam.cloud_from_depth(SINGLE, np.ones((10, 20)), UV),
])  # fmt: skip
def test_stereo_without_a_baseline_is_refused(call):
    assert "the rig has no baseline (a single camera), expected one, m" in refused(call)


@pytest.mark.parametrize(("kind", "hint"), [("depth", "for a depth map any will do"), ("disparity", "z = fx")])
def test_only_a_depth_map_may_take_any_baseline(tmp_path, kind, hint):
    Image.fromarray(GREY).save(tmp_path / "l.png")
    np.save(tmp_path / "map.npy", np.ones(GREY.shape))
    save_cameras(SINGLE, tmp_path / "single.yaml")
    files = (tmp_path / "l.png", tmp_path / "map.npy", tmp_path / "single.yaml")
    assert f"expected one, m: {hint}" in refused(tspslam.datasets.pair_from_map, *files, kind=kind)


def test_a_rig_without_a_size_is_refused():
    assert "rig: width is 0, expected a whole number from 1" in refused(Rig, fx=50, fy=50, cx=10, cy=5)


def test_a_pair_is_read_in_one_line_with_a_calibration_file_or_the_cameras(tmp_path):
    for name in ("l.png", "r.png"):
        Image.fromarray(GREY).save(tmp_path / name)
    save_cameras(RIG, tmp_path / "calib.yaml")
    for calib in (tmp_path / "calib.yaml", str(tmp_path / "calib.yaml"), RIG):
        pair = tspslam.read_pair(tmp_path / "l.png", tmp_path / "r.png", calib)
        assert np.array_equal(pair.left, GREY)
        assert (pair.rig, pair.name) == (RIG, "l")
    save_cameras(SINGLE, tmp_path / "single.yaml")
    assert tspslam.load_rig(tmp_path / "single.yaml") == SINGLE
    line = refused(tspslam.read_pair, tmp_path / "l.png", tmp_path / "r.png", tmp_path / "single.yaml")
    assert "single.yaml: has no baseline; expected that of a pair of cameras, m" in line


def test_a_mesh_around_the_camera_shows_what_is_before_it_and_marks_the_rest():
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(1, 24), np.arange(48), indexing="ij"))
    polar, turn = np.pi * i / 24, 2 * np.pi * j / 48
    ball = 5 * np.column_stack([np.sin(polar) * np.cos(turn), np.cos(polar), np.sin(polar) * np.sin(turn)])
    here = np.arange(22)[:, None] * 48 + np.arange(48)
    right = np.arange(22)[:, None] * 48 + (np.arange(48) + 1) % 48
    quads = np.stack([here, right, right + 48, here + 48], axis=2).reshape(-1, 4)
    camera = Rig(fx=20, fy=20, cx=31.5, cy=23.5, width=64, height=48)
    image = np.random.default_rng(1).random((48, 64))
    textured = tspslam.interop.from_arrays(ball, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]), image, camera)
    seen, behind = textured.signals.vertex_ok, ball[:, 2] <= 0
    assert seen.sum() > 100
    assert behind.sum() > 400
    assert not (seen & behind).any()
    assert np.isnan(textured.cloud.uv[behind]).all()
    assert not textured.signals.face_ok[behind[textured.complex_.faces].any(axis=1)].any()
    response = tspslam.tmahf(textured.complex_, textured.cloud.uv, textured.signals)
    assert len(response) == len(ball)
    assert np.isfinite(response.z).all()
    assert not (response.defined & behind).any()
