from __future__ import annotations

import io
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PathCollection, PolyCollection
from matplotlib.quiver import Quiver
from PIL import Image

from tspslam.errors import InputError, OutputError
from tspslam.types import Cloud, Response
from tspslam.view import _solid as solid
from tspslam.view import _style as style
from tspslam.view import pictures as p
from tspslam.view import write_pictures
from tspslam.view._frame import log_magnitude
from tspslam.view.paths import _plan_picture, beside_path

ALWAYS = {"keypoints", "mesh_depth", "signals", "magnitude", "phase", "view3d_signal", "view3d_magnitude"}


def _dots(figure):
    return [c for c in figure.axes[0].collections if isinstance(c, PathCollection)]


def _words(figure):
    return " ".join(t.get_text().replace("\n", " ") for t in figure.texts)


def _at_depths(frame, depths):
    xyz = frame.cloud.xyz.copy()
    xyz[:, 2] = np.resize(depths, len(xyz))
    return replace(frame, cloud=Cloud(xyz, frame.cloud.uv, frame.cloud.disparity))


@pytest.fixture
def coarse(monkeypatch):
    """Small pictures, for the sake of time."""
    monkeypatch.setattr(style, "DPI", 35)


@pytest.mark.usefixtures("coarse")
def test_every_frame_gives_every_picture_without_a_warning(odd_frame, tmp_path):
    paths = write_pictures(odd_frame, tmp_path / "new" / "pictures")
    assert {path.stem for path in paths} >= ALWAYS
    for path in paths:
        with Image.open(path) as picture:
            assert picture.size[0] == 350
            assert 50 < picture.size[1] < 400
            assert picture.info["Software"] == "tspslam"


@pytest.mark.usefixtures("coarse")
def test_the_same_frame_gives_the_same_bytes(frame, tmp_path):
    first, second = (write_pictures(frame, tmp_path / k) for k in "ab")
    assert [x.read_bytes() for x in first] == [x.read_bytes() for x in second]


@pytest.mark.usefixtures("coarse")
def test_nothing_but_pictures_is_left_in_the_folder(frame, tmp_path):
    paths = write_pictures(frame, tmp_path)
    assert sorted(tmp_path.iterdir()) == sorted(paths)


def test_classes_of_depth_have_the_paper_s_bounds_and_sum_to_the_points(frame):
    at = _at_depths(frame, [7.999, 8.0, 29.9, 30.0, 59.9, 60.0, np.nan, -1.0, 1.0])
    assert p._depth_classes(at).tolist() == [8, 8, 8, 4, 8]


def test_legend_counts_sum_to_the_points_drawn(odd):
    frame = odd("unseen points")
    figure = p.keypoints_picture(frame)
    legend = [int(t.get_text().strip("\N{FIGURE SPACE}").split()[0]) for t in figure.axes[0].get_legend().get_texts()]
    drawn = [len(c.get_offsets()) for c in _dots(figure)]
    assert legend == drawn
    assert sum(legend) + 3 == frame.complex_.n
    assert "3 points without a place" in _words(figure)


@pytest.mark.usefixtures("coarse")
@pytest.mark.parametrize(("depths", "second"), [([3.0], True), ([3.0, 12.0], False), ([np.nan], False)])
def test_a_continuous_scale_is_added_where_one_class_holds_nearly_all(frame, tmp_path, depths, second):
    names = {path.stem for path in write_pictures(_at_depths(frame, depths), tmp_path)}
    assert ("keypoints_depth" in names) is second


@pytest.mark.parametrize(("far", "logarithmic"), [(12.0, False), (80.0, True)])
def test_depth_has_a_logarithmic_scale_where_its_range_is_wide(frame, far, logarithmic):
    axes = p.mesh_depth_picture(_at_depths(frame, np.geomspace(2, far, 36))).axes[1]
    assert (axes.get_yscale() == "log") is logarithmic


def test_elements_without_a_signal_are_left_out_and_counted(frame):
    signals = frame.signals
    edge_ok, face_ok = signals.edge_ok.copy(), signals.face_ok.copy()
    edge_ok[:7], face_ok[:5] = False, False
    figure = p.signals_picture(replace(frame, signals=replace(signals, edge_ok=edge_ok, face_ok=face_ok)))
    assert [len(c.get_offsets()) for c in _dots(figure)] == [edge_ok.sum(), face_ok.sum()]
    assert "12 elements without a signal" in _words(figure)


def test_three_channels_are_drawn_in_their_colours(build):
    frame = build(channels=3)
    squares, circles = _dots(p.signals_picture(frame))
    np.testing.assert_allclose(squares.get_facecolors()[:, :3], frame.signals.edge)
    np.testing.assert_allclose(circles.get_facecolors()[:, :3], frame.signals.face)


@pytest.mark.parametrize("draw", [p.magnitude_picture, p.phase_picture])
def test_undefined_and_zero_responses_are_left_out_and_counted(frame, draw):
    z, defined = frame.response.z.copy(), frame.response.defined.copy()
    z[:3], defined[30:] = 0, False
    figure = draw(replace(frame, response=Response(z, 1, defined)))
    assert len(_dots(figure)[0].get_offsets()) == 27
    assert "3 vertices where it is exactly 0" in _words(figure)
    assert "6 vertices where it is not defined" in _words(figure)


def test_log_magnitude_is_finite_for_every_response(frame):
    z = frame.response.z.copy()
    z[:4] = [0, 1e-320, complex(np.nan, 0), complex(np.inf, 0)]
    shown, zeros = log_magnitude(replace(frame, response=Response(z, 1, frame.response.defined)))
    assert np.isfinite(shown.values).all()
    assert zeros == 1
    assert shown.ok[:4].tolist() == [False, True, False, False]


@pytest.mark.parametrize("order", [1, 2])
def test_arrows_stand_on_the_strongest_tenth_and_point_down_for_positive_v(build, order):
    frame = build(order=order)
    (arrows,) = (c for c in p.phase_picture(frame).axes[0].collections if isinstance(c, Quiver))
    strongest = np.arange(36)[::-1][:4]
    np.testing.assert_allclose(arrows.XY, frame.cloud.uv[strongest])
    psi = np.angle(frame.response.z[strongest]) / order
    np.testing.assert_allclose(np.arctan2(arrows.V, arrows.U), psi)


def test_a_response_of_order_0_has_no_arrows(build):
    assert not any(isinstance(c, Quiver) for c in p.phase_picture(build(order=0)).axes[0].collections)


def test_channels_of_a_response_show_as_the_response_to_their_mean(frame):
    z = np.stack([frame.response.z, 3 * frame.response.z], axis=1)
    shown, _ = log_magnitude(replace(frame, response=Response(z, 1, frame.response.defined)))
    np.testing.assert_allclose(shown.values, np.log10(2 * np.abs(frame.response.z)))


def test_a_far_outlier_neither_sets_the_view_nor_is_drawn(odd):
    far = odd("far outlier")
    figure = p.signal_view(far)
    (mesh,) = (c for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    assert len(mesh.get_paths()) == (~(far.complex_.faces == 40).any(axis=1)).sum()
    assert "far off the rest" in _words(figure)


def test_the_painter_draws_the_farthest_face_first(build):
    frame = build()
    faces = np.flatnonzero(np.ones(len(frame.complex_.faces), bool))
    corners = frame.cloud.xyz[frame.complex_.faces[faces]]
    viewer = solid.viewer_of(frame.cloud.xyz)
    (mesh,) = (c for c in p.signal_view(frame).axes[0].collections if isinstance(c, PolyCollection))
    plane, depth = viewer.project(corners.reshape(-1, 3))
    order = np.argsort(-depth.reshape(-1, 3).mean(axis=1), kind="stable")
    drawn = np.array([path.vertices[:3] for path in mesh.get_paths()])
    np.testing.assert_allclose(drawn, plane.reshape(-1, 3, 2)[order])


def test_the_viewer_stands_above_and_upright(frame):
    viewer = solid.viewer_of(frame.cloud.xyz)
    np.testing.assert_allclose(viewer.axes @ viewer.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(viewer.axes) == pytest.approx(1)
    assert viewer.eye[1] < np.median(frame.cloud.xyz[:, 1])
    assert viewer.axes[1, 1] > 0  # its down is the camera's down
    assert (viewer.project(frame.cloud.xyz)[1] > viewer.near).all()


@pytest.mark.parametrize(("extent", "step"), [(8.0, 1.0), (8.1, 2.0), (3.9, 0.5), (0.4, 0.05), (40.0, 5.0)])
def test_grid_steps_are_round(extent, step):
    assert solid.grid_step(extent) == pytest.approx(step)


def test_phase_colours_close_the_circle_at_one_lightness():
    colours = style.phase_map()(np.linspace(0, 1, 512))[:, :3]
    np.testing.assert_allclose(colours[0], colours[-1], atol=0.01)
    steps = np.linalg.norm(np.diff(colours, axis=0), axis=1)
    assert steps.max() < 0.03
    luma = colours @ [0.2126, 0.7152, 0.0722]
    assert np.ptp(luma) < 0.2


def test_text_is_plain_and_only_of_characters_that_the_font_has():
    assert style.drawable("a$b_{ ψ ≥\t漢") == "a$b_{ ψ ≥??"


@pytest.mark.parametrize("shape", [(0, 5), (5,), (5, 5, 2)])
def test_what_is_not_an_image_is_refused(frame, tmp_path, shape):
    with pytest.raises(InputError, match="image of shape"):
        write_pictures(replace(frame, image=np.zeros(shape, np.uint8)), tmp_path)


def test_parts_that_do_not_belong_together_are_refused(frame, tmp_path):
    with pytest.raises(InputError, match=r"response\.z of length 35, expected 36"):
        write_pictures(replace(frame, response=Response(np.ones(35, complex), 1, np.ones(35, bool))), tmp_path)


def test_a_folder_that_cannot_be_made_is_an_output_error(frame, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match="cannot be written"):
        write_pictures(frame, tmp_path / "file" / "pictures")


@pytest.mark.usefixtures("coarse")
def test_a_failed_write_leaves_the_old_picture_and_no_temporary_file(frame, tmp_path, monkeypatch):
    (tmp_path / "keypoints.png").write_bytes(b"old")

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_pictures(frame, tmp_path)
    assert [x.read_bytes() for x in tmp_path.iterdir()] == [b"old"]


def test_a_picture_is_1400_pixels_wide(frame):
    with Image.open(io.BytesIO(style.png(p.mesh_depth_picture(frame)))) as picture:
        assert picture.format == "PNG"
        assert picture.size[0] == 1400


def test_pictures_need_no_pyplot():
    code = "import sys, tspslam.view.pictures, tspslam.view.report; print('matplotlib.pyplot' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def street(length):
    """A straight path, points 4 m to both sides of it, and some far off to one side of its middle."""
    path = np.zeros((length + 1, 3))
    path[:, 2] = np.arange(length + 1)
    beside = path.repeat(10, axis=0)
    beside[:, 0] = np.resize((-4, 4), len(beside))
    far = np.random.default_rng(0).normal((90, 0, length / 2), (5, 1, 5), (length // 2, 3))
    return path, beside, far


def test_a_plan_shows_the_whole_path_and_all_that_is_beside_it():
    path, beside, far = street(300)
    near = beside_path(path, np.vstack([beside, far]))
    assert near[: len(beside)].all()
    assert not near[len(beside) :].all()
    low, high = _plan_picture(path, np.vstack([beside, far])).axes[0].get_xlim()
    assert low < 0 < 300 < high


def test_a_plan_is_seen_from_above():
    path, beside, far = street(30)
    ahead_is_right = _plan_picture(path, np.vstack([beside, far])).axes[0]
    assert (ahead_is_right.get_xlabel(), ahead_is_right.get_ylabel()) == ("z, m", "x, m")
    assert ahead_is_right.yaxis_inverted()  # x, to the right of who goes ahead, is down
    path, beside, far = (each[:, [2, 1, 0]] for each in street(30))
    right_is_right = _plan_picture(path, np.vstack([beside, far])).axes[0]
    assert (right_is_right.get_xlabel(), right_is_right.get_ylabel()) == ("x, m", "z, m")
    assert not right_is_right.yaxis_inverted()


def test_a_plan_without_points_shows_the_path():
    low, high = _plan_picture(street(30)[0], np.empty((0, 3))).axes[0].get_xlim()
    assert low < 0 < 30 < high
