import numpy as np
import pytest

from tspslam import InputError, build_complex, geometry_signals, sample_signals, sample_vectors, stack_signals, tmahf
from tspslam.topology.vectors import CHANNELS

from .scenes import noise, scattered
from .truth import line_pixels, to_luminance, triangle_pixels

UV, COMPLEX = scattered(50)
MARKED = np.where(np.arange(50)[:, None] % 13 == 5, np.nan, UV)
SQUARE = np.array([[3.0, 4], [20, 4], [3, 31], [20, 31]])  # upright and level sides, and pixels on a row


def pixels_of(uv, complex_):
    """Pixels (u, v) of every edge and every face."""
    edges = [line_pixels(*(tuple(int(np.floor(x + 0.5)) for x in uv[end]) for end in edge)) for edge in complex_.edges]
    return {"edge": edges, "face": [triangle_pixels(uv[face]) for face in complex_.faces]}


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float64])
@pytest.mark.parametrize(("uv", "complex_"), [(UV, COMPLEX), (SQUARE, build_complex([[0, 1, 2], [1, 2, 3]], 4))])
def test_every_channel_is_a_statistic_of_the_pixels(dtype, uv, complex_):
    image = noise((40, 60, 3), dtype=dtype)
    signals, grey = sample_vectors(image, uv, complex_, CHANNELS), to_luminance(image)
    colour = [to_luminance(image[:, :, c]) for c in range(3)]
    planes = dict(zip(("red", "green", "blue"), colour, strict=True)) | {
        "luminance": grey, "gradient_u": np.gradient(grey, axis=1), "gradient_v": np.gradient(grey, axis=0)}  # fmt: skip
    checked = 0
    for level, elements in pixels_of(uv, complex_).items():
        for x, pixels in enumerate(elements):
            if len(pixels) < 2:
                assert not getattr(signals, level)[x, [CHANNELS.index("variance"), CHANNELS.index("range")]].any()
                continue
            checked += 1
            for c, name in enumerate(CHANNELS):
                plane = planes.get(name, grey)
                values = np.array([plane[v, u] for u, v in pixels])
                expected = {"variance": values.var(), "range": np.ptp(values)}.get(name, values.mean())
                assert getattr(signals, level)[x, c] == pytest.approx(expected, abs=1e-12)
    assert checked > 3
    statistics = signals.vertex[:, [CHANNELS.index("variance"), CHANNELS.index("range")]]
    assert not statistics.any()


def test_marked_elements_have_no_vectors_and_the_filter_takes_the_channels_one_by_one():
    signals = sample_vectors(noise((40, 60, 3)), MARKED, COMPLEX, CHANNELS)
    for level in ("vertex", "edge", "face"):
        assert not getattr(signals, level)[~getattr(signals, f"{level}_ok")].any()
    response = tmahf(COMPLEX, MARKED, signals)
    assert response.z.shape == (50, 8)
    plain = tmahf(COMPLEX, MARKED, sample_signals(noise((40, 60, 3)), MARKED, COMPLEX))
    np.testing.assert_allclose(response.z[:, 0], plain.z, atol=1e-12)


def test_variance_is_never_negative_and_0_on_constants():
    for value in (0.0, 0.1, 1 / 3, 1.0):
        signals = sample_vectors(np.full((40, 60), value), UV, COMPLEX, ("variance", "range", "gradient_u"))
        for level in ("edge", "face"):
            assert (getattr(signals, level) >= 0).all()
            np.testing.assert_allclose(getattr(signals, level), 0, atol=1e-14)


def test_a_strip_of_an_image_has_gradients():
    thin = sample_vectors(
        np.array([[0.0, 0.2, 0.4]]),
        [[0, 0], [1, 0], [2, 0]],
        build_complex([[0, 1, 2]], 3),
        ("gradient_u", "gradient_v", "range"),
    )
    np.testing.assert_allclose(thin.face, [[0.2, 0, 0.4]])


def test_depth_is_the_mean_over_the_vertices_and_normals_point_away_from_the_camera():
    rng = np.random.default_rng(0)
    xyz = np.column_stack([UV / 30 - 1, 3 + 0.2 * rng.random(50)])
    signals = geometry_signals(COMPLEX, xyz, sample_signals(noise(), MARKED, COMPLEX))
    for f in np.flatnonzero(signals.face_ok):
        a, b, c = xyz[COMPLEX.faces[f]]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal) * np.sign(normal @ (a + b + c))
        np.testing.assert_allclose(signals.face[f], [(a + b + c)[2] / 3, *normal], atol=1e-9)
    e = np.flatnonzero(signals.edge_ok)
    np.testing.assert_allclose(signals.edge[e, 0], xyz[COMPLEX.edges[e], 2].mean(axis=1))
    for level in ("vertex", "edge", "face"):
        ok = getattr(signals, f"{level}_ok")
        np.testing.assert_allclose(np.linalg.norm(getattr(signals, level)[ok, 1:], axis=1), 1)
        assert not getattr(signals, level)[~ok].any()


def test_on_a_plane_every_normal_is_the_planes_and_loose_edges_look_along_the_sight():
    n = np.array([0.2, -0.1, 1]) / np.linalg.norm([0.2, -0.1, 1])
    rays = np.column_stack([UV / 30 - 1, np.ones(50)])
    xyz = rays * (3 / (rays @ n))[:, None]
    for complex_ in (COMPLEX, build_complex(COMPLEX.faces[:, ::-1], 50)):
        signals = geometry_signals(complex_, xyz, sample_signals(noise(), UV, complex_))
        for level in ("vertex", "edge", "face"):
            np.testing.assert_allclose(
                getattr(signals, level)[:, 1:], np.tile(n, (len(getattr(signals, level)), 1)), atol=1e-9
            )
    loose = build_complex([], 2, edges=[[0, 1]])
    signals = geometry_signals(loose, [[0, 0, 2], [0, 0, 4.0]], sample_signals(noise(), [[1, 1], [9, 9]], loose))
    assert signals.edge.tolist() == [[3.0, 0, 0, 1]]


def test_texture_and_geometry_stand_side_by_side():
    texture = sample_vectors(noise(), MARKED, COMPLEX)
    xyz = np.column_stack([UV / 30 - 1, np.full(50, 3.0)])
    xyz[~texture.vertex_ok] = np.nan
    both = stack_signals([texture, geometry_signals(COMPLEX, xyz, texture)])
    assert both.face.shape == (len(COMPLEX.faces), 8)
    np.testing.assert_array_equal(both.edge[:, :4], texture.edge)
    assert np.isfinite(both.edge).all()


SIGNALS = sample_signals(noise(), UV, COMPLEX)


@pytest.mark.parametrize(("call", "message"), [
    (lambda: sample_vectors(noise(), UV, COMPLEX, ("mean",)), "channel is 'mean', expected one of luminance, red"),
    (lambda: sample_vectors(noise(), UV, COMPLEX, ("range", "range")), "expected at least one, each once"),
    (lambda: sample_vectors(noise(), UV, COMPLEX, ()), "expected at least one"),
    (lambda: sample_vectors(noise(), UV, COMPLEX, ("red",)), "image is grey, expected a colour image"),
    (lambda: geometry_signals(COMPLEX, UV, SIGNALS), r"xyz has shape \(50, 2\)"),
    (lambda: geometry_signals(COMPLEX, np.full((50, 3), np.nan), SIGNALS), "xyz is not finite at vertex 0"),
    (lambda: stack_signals([]), "no signals to stack"),
    (lambda: stack_signals([SIGNALS, sample_signals(noise(), MARKED, COMPLEX)]), "differ in where vertex signals are"),
])  # fmt: skip
def test_bad_input_is_named(call, message):
    with pytest.raises(InputError, match=message):
        call()
