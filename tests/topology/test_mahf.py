import sys

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation

from tspslam import InputError, Surface, build_complex, heat_filter, mahf, mahf_bank
from tspslam.topology.mahf import conformal_laplacian, tangent_axes

from .scenes import grid_faces, torus_faces


def torus(rows=12, columns=16):
    i, j = np.divmod(np.arange(rows * columns), columns)
    a, b = 2 * np.pi * i / rows, 2 * np.pi * j / columns
    ring = 1 + 0.4 * np.cos(a)
    xyz = np.column_stack([ring * np.cos(b), ring * np.sin(b), 0.4 * np.sin(a)])
    return torus_faces(rows, columns), xyz @ Rotation.from_euler("x", 45, degrees=True).as_matrix().T + [0, 0, 4]


def sheet(n=150, seed=0):
    """An open wavy surface before the camera: a grid, so that no triangle is a sliver."""
    rows = 12
    v, u = np.divmod(np.arange(rows * rows), rows)
    rng = np.random.default_rng(seed)
    jitter = rng.uniform(-0.2, 0.2, (2, rows * rows))
    x, y = u + jitter[0] - 5.5, v + jitter[1] - 5.5
    return grid_faces(rows, rows), np.column_stack([x, y, 12 + np.sin(x) + 0.5 * np.cos(y)]) / 10


MESHES = {"torus": torus(), "sheet": sheet()}
every = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
kinds = pytest.mark.parametrize("laplacian", ["graph", "conformal", "robust"])


def noise(xyz, *channels):
    return np.random.default_rng(1).random((len(xyz), *channels))


def axes_by_hand(faces, xyz, i):
    normal = np.zeros(3)
    for face in faces[(faces == i).any(axis=1)]:
        a, b, c = xyz[face]
        one = np.cross(b - a, c - a)
        normal += one if one @ (a + b + c) > 0 else -one
    n = normal / np.linalg.norm(normal)
    x, y = np.eye(3)[:2]
    if abs(x @ n) > 0.99:
        t2 = y - (y @ n) * n
        t2 /= np.linalg.norm(t2)
        return np.cross(t2, n), t2
    t1 = x - (x @ n) * n
    t1 /= np.linalg.norm(t1)
    return t1, np.cross(n, t1)


def by_hand(faces, xyz, signal, order, t, L):
    """Eq. (9), vertex by vertex."""
    K = expm(-t * L.toarray())
    z = np.zeros(len(xyz), complex)
    for i in range(len(xyz)):
        t1, t2 = axes_by_hand(faces, xyz, i)
        d = xyz - xyz[i]
        phi = np.arctan2(d @ t2, d @ t1)
        terms = K[i] * np.exp(1j * order * phi) * signal
        if order:
            flat = np.hypot(d @ t1, d @ t2) < 1e-9 * np.linalg.norm(d, axis=1)
            terms[flat] = 0
            terms[i] = 0
        z[i] = terms.sum()
    return z


def conformal_by_hand(faces, xyz):
    L = np.zeros((len(xyz), len(xyz)))
    for face in faces:
        for k in range(3):
            i, j, o = face[k], face[(k + 1) % 3], face[(k + 2) % 3]
            u, w = xyz[i] - xyz[o], xyz[j] - xyz[o]
            cot = np.clip(u @ w / np.linalg.norm(np.cross(u, w)), -1e3, 1e3)
            L[[i, j], [j, i]] -= cot / 2
            L[[i, j], [i, j]] += cot / 2
    return L


@every
@pytest.mark.parametrize("order", [0, 1, 2, 5])
@pytest.mark.parametrize(("laplacian", "t"), [("graph", 1.0), ("conformal", 1.0), ("graph", 3.0), ("conformal", 0.2)])
def test_the_filter_is_the_sum_of_equation_9(mesh, order, laplacian, t):
    faces, xyz = mesh
    L = build_complex(faces, len(xyz)).L0 if laplacian == "graph" else conformal_laplacian(faces, xyz)
    expected = by_hand(faces, xyz, noise(xyz), order, t, L)
    for method, tolerance in (("exact", 1e-11), ("chebyshev", 1e-5), ("eigs", 1e-9)):
        got = mahf(faces, xyz, noise(xyz), order, t, method, laplacian, eigenpairs=len(xyz))
        np.testing.assert_allclose(got.z, expected, atol=tolerance)
        assert got.defined.all()


@every
def test_the_conformal_laplacian_is_that_of_the_cotangents(mesh):
    np.testing.assert_allclose(conformal_laplacian(*mesh).toarray(), conformal_by_hand(*mesh), atol=1e-12)


@every
@kinds
def test_a_smaller_error_is_a_smaller_error(mesh, laplacian):
    faces, xyz = mesh
    exact = mahf(faces, xyz, noise(xyz), method="exact", laplacian=laplacian).z
    for error in (1e-2, 1e-4, 1e-7):
        assert np.abs(mahf(faces, xyz, noise(xyz), laplacian=laplacian, error=error).z - exact).max() <= error


@every
def test_order_0_is_heat_diffusion(mesh):
    faces, xyz = mesh
    got = mahf(faces, xyz, noise(xyz), order=0, t=2.0, laplacian="graph", error=1e-9)
    np.testing.assert_allclose(got.z, heat_filter(build_complex(faces, len(xyz)).L0, noise(xyz), 2.0), atol=1e-8)


@every
@kinds
def test_turning_mesh_and_camera_leaves_the_magnitude(mesh, laplacian):
    faces, xyz = mesh
    for seed in range(3):
        turned = xyz @ Rotation.from_quat(np.random.default_rng(seed).normal(size=4)).as_matrix().T
        one, other = (mahf(faces, points, noise(xyz), 2, laplacian=laplacian) for points in (xyz, turned))
        np.testing.assert_allclose(one.magnitude, other.magnitude, atol=2e-5)


@every
@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_mirroring_in_x_conjugates_up_to_sign(mesh, order):
    faces, xyz = mesh
    one = mahf(faces, xyz, noise(xyz), order, error=1e-9)
    other = mahf(faces, xyz * [-1, 1, 1], noise(xyz), order, error=1e-9)
    np.testing.assert_allclose(other.z, (-1) ** order * one.z.conj(), atol=1e-8)


def test_on_a_plane_before_the_camera_the_angle_is_that_of_the_image():
    faces, xyz = sheet()
    xyz[:, 2] = 3.0
    np.testing.assert_allclose(tangent_axes(xyz, faces), np.tile(np.eye(3)[:2].ravel(), (len(xyz), 1)), atol=1e-12)


def test_winding_and_numbering_do_not_matter():
    faces, xyz = sheet()
    rng = np.random.default_rng(3)
    flipped = np.where(rng.random(len(faces))[:, None] < 0.5, faces, faces[:, ::-1])
    order = rng.permutation(len(xyz))
    place = np.argsort(order)
    one = mahf(faces, xyz, noise(xyz), error=1e-9)
    np.testing.assert_allclose(mahf(flipped, xyz, noise(xyz), error=1e-9).z, one.z, atol=1e-8)
    moved = mahf(place[faces], xyz[order], noise(xyz)[order], error=1e-9)
    np.testing.assert_allclose(moved.z, one.z[order], atol=1e-8)


def test_a_bank_holds_the_single_responses_and_channels_are_filtered_alike():
    faces, xyz = torus()
    bank = mahf_bank(faces, xyz, noise(xyz, 2), (2, 0, 1), (0.5, 2.0))
    assert (len(bank), bank.orders.tolist(), bank.scales.tolist()) == (6, [2, 0, 1] * 2, [0.5] * 3 + [2.0] * 3)
    for k in range(6):
        for c in range(2):
            one = mahf(Surface(faces), xyz, noise(xyz, 2)[:, c], int(bank.orders[k]), float(bank.scales[k]))
            np.testing.assert_allclose(bank[k].z[:, c], one.z, atol=2e-5)
    assert bank[3].order == 2


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch):
    faces, xyz = torus(60, 80)
    one = mahf(faces, xyz, noise(xyz)).z
    monkeypatch.setattr("tspslam._threads._CORES", 1)
    assert mahf(faces, xyz, noise(xyz)).z.tobytes() == one.tobytes()


def test_what_has_no_signal_or_face_stays_out():
    faces, xyz = sheet()
    ok = np.random.default_rng(4).random(len(xyz)) < 0.7
    signal = np.where(ok, noise(xyz), np.nan)
    got = mahf(faces, xyz, signal, ok=ok)
    expected = mahf(faces, xyz, np.where(ok, noise(xyz), 0))
    np.testing.assert_array_equal(got.z, np.where(ok, expected.z, 0))
    np.testing.assert_array_equal(got.defined, ok)
    lonely = np.concatenate([xyz, [[0, 0, 0], [1, 2, 3]]])
    for laplacian in ("graph", "conformal", "robust"):
        more = mahf(faces, lonely, np.append(noise(xyz), [1, 1]), laplacian=laplacian)
        assert more.defined.tolist() == [True] * len(xyz) + [False] * 2
        assert more.z[-2:].tolist() == [0, 0]
        np.testing.assert_allclose(more.z[:-2], mahf(faces, xyz, noise(xyz), laplacian=laplacian).z, atol=2e-5)


BAD_MESHES = {
    "five faces at an edge": ([[0, 1, k] for k in range(2, 7)], 7),
    "one face": ([[0, 1, 2]], 3),
    "the same face twice": ([[0, 1, 2], [2, 1, 0], [1, 2, 3]], 4),
    "no face": (np.empty((0, 3), int), 3),
    "nothing": (np.empty((0, 3), int), 0),
}


@pytest.mark.parametrize(("faces", "n"), BAD_MESHES.values(), ids=BAD_MESHES)
@pytest.mark.parametrize("laplacian", ["graph", "conformal"])
@pytest.mark.parametrize("method", ["chebyshev", "exact", "eigs"])
def test_strange_meshes_have_finite_responses(faces, n, laplacian, method):
    xyz = np.random.default_rng(5).normal(5, 1, (n, 3))
    got = mahf(faces, xyz, np.ones(n), method=method, laplacian=laplacian)
    assert np.isfinite(got.z).all()


def test_faces_without_area_and_points_at_one_place_have_finite_responses_or_are_named():
    faces, xyz = [[0, 1, 2], [1, 2, 3]], np.array([[0, 0, 1], [0, 0, 1], [1, 0, 1], [1, 1, 1.0]])
    assert np.isfinite(mahf(faces, xyz, np.ones(4), laplacian="graph").z).all()
    line = np.array([[0, 0, 1], [1, 0, 1], [3, 0, 1], [1, 1, 1.0]])
    for method in ("chebyshev", "exact"):
        with pytest.raises(InputError, match=r"heat grows at vertex \d; face 0 \[0, 1, 2\] is a sliver"):
            mahf(faces, line, np.ones(4), method=method)


def test_slivers_of_a_delaunay_mesh_are_named_and_the_robust_laplacian_takes_them():
    uv = np.random.default_rng(0).random((2000, 2))
    faces, xyz = Delaunay(uv).simplices, np.column_stack([uv, np.ones(2000)])
    with pytest.raises(InputError, match=r"is a sliver whose cotangents were clamped, expected .* laplacian='robust'"):
        mahf(faces, xyz, np.ones(2000))
    assert np.isfinite(mahf(faces, xyz, noise(xyz), laplacian="robust").z).all()


def test_an_axis_along_x_is_no_trouble():
    faces, xyz = sheet()
    turned = xyz[:, [2, 1, 0]]
    assert np.isfinite(tangent_axes(turned, faces)).all()
    np.testing.assert_allclose(
        mahf(faces, turned, noise(xyz)).magnitude, mahf(faces, xyz, noise(xyz)).magnitude, atol=2e-5
    )


@pytest.mark.parametrize(("arguments", "message"), [
    ({"order": -1}, "mahf: order is -1, expected an integer from 0 to 1000"),
    ({"t": -1.0}, r"t is -1\.0, expected a finite number >= 0"),
    ({"t": 1e13}, "expected a smaller t"),
    ({"method": "magic"}, "method is 'magic', expected 'chebyshev', 'eigs' or 'exact'"),
    ({"laplacian": "magic"}, "laplacian is 'magic', expected 'conformal', 'graph' or 'robust'"),
    ({"error": 0.0}, r"error is 0\.0, expected 1e-12 to 1"),
    ({"method": "eigs", "eigenpairs": 0}, "k is 0"),
    ({"signal": np.zeros(3)}, r"signal is float64 of shape \(3,\), expected \(192,\)"),
    ({"signal": np.full(192, np.nan)}, "signal is not finite at vertex 0"),
    ({"xyz": [[0, 0, 1], [1, 1]]}, "xyz has rows of different lengths"),
    ({"signal": "abc"}, "signal is <U3"),
    ({"xyz": np.zeros((192, 2))}, r"xyz has shape \(192, 2\), expected \(N, 3\)"),
    ({"xyz": np.full((192, 3), np.inf)}, r"xyz is \[inf, inf, inf\] at vertex 0, expected at most 1e\+09"),
    ({"xyz": np.full((192, 3), 1e200)}, "at vertex 0, expected at most"),
    ({"xyz": np.ones((192, 3)), "laplacian": "robust"}, "robust_laplacian cannot use this mesh"),
    ({"signal": np.full(192, 1e200)}, r"signal is too large at vertex 0, expected finite values, at most 1e\+100"),
    ({"surface": [[0, 1, 2], [3, 4]]}, "faces are rows of different lengths"),
    ({"surface": [[0, 1, 192]]}, r"face 0 is \[0, 1, 192\]"),
    ({"ok": np.zeros(3, bool)}, r"ok is bool of shape \(3,\)"),
])  # fmt: skip
def test_bad_input_is_named(arguments, message):
    faces, xyz = torus()
    given = {"surface": faces, "xyz": xyz, "signal": noise(xyz)} | arguments
    with pytest.raises(InputError, match=message):
        mahf(**given)


def test_what_is_empty_too_large_or_missing_is_said(monkeypatch):
    faces, xyz = torus()
    with pytest.raises(InputError, match="0 orders and 1 scales"):
        mahf_bank(faces, xyz, noise(xyz), ())
    with pytest.raises(InputError, match="4001 vertices are too many for method 'exact'"):
        mahf([[0, 1, 2]], np.ones((4001, 3)), np.zeros(4001), method="exact", laplacian="graph")
    monkeypatch.setattr("tspslam.topology.harmonic.LARGEST_BANK", 100)
    with pytest.raises(InputError, match=r"mahf: responses take 0\.0 GiB, expected at most 4"):
        mahf(faces, xyz, noise(xyz))
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "robust_laplacian", None)
    with pytest.raises(InputError, match=r"needs robust_laplacian: pip install 'tspslam\[mesh\]'"):
        mahf(faces, xyz, noise(xyz), laplacian="robust")
