import numpy as np
import pytest

from tspslam import InputError
from tspslam.apps import _mesh
from tspslam.apps.mesh import denoise_mesh
from tspslam.topology._stars import face_neighbours


def grid(rows, columns):
    """Triangles of an open grid, and the rows and columns of its vertices."""
    i, j = np.divmod(np.arange(rows * columns), columns)
    here = np.flatnonzero((i < rows - 1) & (j < columns - 1))
    down, right, both = here + columns, here + 1, here + columns + 1
    return np.concatenate([np.stack([here, down, both], 1), np.stack([here, both, right], 1)]), i, j


def sheet(n=20):
    faces, i, j = grid(n, n)
    return np.column_stack([i, j, 0.0 * i]), faces


def box(n=10):
    """A cube of n x n squares a side, closed, its vertices shared along the creases."""
    faces, i, j = grid(n + 1, n + 1)
    sides = []
    for axis in range(3):
        for at, turn in ((0, 1), (n, -1)):
            flat = np.column_stack([np.full(len(i), at), i, j])
            sides.append((np.roll(flat, axis, axis=1), faces[:, ::turn]))
    xyz, index = np.unique(np.concatenate([side for side, _ in sides]), axis=0, return_inverse=True)
    stacked = np.concatenate([f + k * len(i) for k, (_, f) in enumerate(sides)])
    return xyz.astype(float), index.ravel()[stacked]


def torus(rows=40, columns=80):
    i, j = np.divmod(np.arange(rows * columns), columns)
    a, b = 2 * np.pi * j / columns, 2 * np.pi * i / rows
    ring = 1 + 0.4 * np.cos(b)
    right, down = i * columns + (j + 1) % columns, (i + 1) % rows * columns + j
    both, here = (i + 1) % rows * columns + (j + 1) % columns, np.arange(rows * columns)
    faces = np.concatenate([np.stack([here, right, both], 1), np.stack([here, both, down], 1)])
    return np.column_stack([ring * np.cos(a), ring * np.sin(a), 0.4 * np.sin(b)]), faces


def normals_of(xyz, faces):
    normals = np.cross(xyz[faces[:, 1]] - xyz[faces[:, 0]], xyz[faces[:, 2]] - xyz[faces[:, 0]])
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def angle(xyz, truth, faces):
    cosine = (normals_of(xyz, faces) * normals_of(truth, faces)).sum(axis=1)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()


def across(xyz, faces, size, seed=0):
    """Noise along the vertices' normals."""
    normals = np.zeros(xyz.shape)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], normals_of(xyz, faces))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return xyz + np.random.default_rng(seed).normal(0, size, (len(xyz), 1)) * normals


def on_axes(xyz, size, seed=0):
    return xyz + np.random.default_rng(seed).normal(0, size, xyz.shape)


def noisy_meshes():
    """One along normals with creases, one folded over, one that is cut off in frequency, one open."""
    cube, faces = box()
    smooth, around = torus()
    flat, open_ = sheet()
    return [
        pytest.param(across(cube, faces, 0.3), faces, id="box"),
        pytest.param(on_axes(cube, 0.35), faces, id="folded box"),
        pytest.param(on_axes(smooth, 0.03), around, id="torus"),
        pytest.param(across(flat, open_, 0.3), open_, id="sheet"),
    ]


@pytest.mark.parametrize("mesh", [sheet(), box()], ids=["plane", "box"])
def test_what_is_flat_and_free_of_noise_stays(mesh):
    xyz, faces = mesh
    assert np.abs(denoise_mesh(xyz, faces) - xyz).max() < 0.02  # edges; a box's second differences look like noise


def test_normals_of_a_noisy_box_come_out_and_its_creases_stay():
    xyz, faces = box(14)
    noisy = across(xyz, faces, 0.3)
    denoised = denoise_mesh(noisy, faces)
    assert angle(denoised, xyz, faces) < 0.15 * angle(noisy, xyz, faces)
    crease = ((xyz == 0) | (xyz == 14)).sum(axis=1) == 2
    assert np.abs(denoised - xyz)[crease].max(axis=1).mean() < 0.25


def test_faces_that_noise_folded_over_lie_right_again():
    xyz, faces = box(14)
    noisy = on_axes(xyz, 0.35)
    turned = lambda p: ((normals_of(p, faces) * normals_of(xyz, faces)).sum(axis=1) < 0).mean()  # noqa: E731
    assert turned(noisy) > 0.05
    assert turned(denoise_mesh(noisy, faces)) < 0.005


@pytest.mark.parametrize("size", [0.01, 0.03])
def test_a_smooth_grid_is_told_from_its_noise_in_all_directions(size):
    xyz, faces = torus()
    noisy = on_axes(xyz, size)
    assert np.sqrt(((denoise_mesh(noisy, faces) - xyz) ** 2).mean()) < 0.15 * size


@pytest.mark.parametrize(("xyz", "faces"), noisy_meshes())
def test_moving_turning_and_scaling_commute_with_denoising(xyz, faces):
    R = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)
    shift = np.array([3.0, -2, 5])
    moved = denoise_mesh(7 * xyz @ R.T + shift, faces)
    np.testing.assert_allclose(moved, 7 * denoise_mesh(xyz, faces) @ R.T + shift, atol=1e-7)


@pytest.mark.parametrize(("xyz", "faces"), noisy_meshes())
def test_numbers_of_vertices_and_faces_do_not_matter(xyz, faces):
    rng = np.random.default_rng(2)
    order = rng.permutation(len(xyz))
    renumbered = np.argsort(order)[faces][rng.permutation(len(faces))]
    np.testing.assert_allclose(denoise_mesh(xyz[order], renumbered), denoise_mesh(xyz, faces)[order], atol=1e-8)


@pytest.mark.parametrize(("xyz", "faces"), noisy_meshes())
def test_winding_does_not_matter(xyz, faces):
    mixed = faces.copy()
    mixed[::3] = mixed[::3, ::-1]
    np.testing.assert_allclose(denoise_mesh(xyz, mixed), denoise_mesh(xyz, faces), atol=1e-8)


@pytest.mark.parametrize(("xyz", "faces"), noisy_meshes())
def test_the_same_input_gives_the_same_bytes_and_is_left_alone(xyz, faces):
    kept = xyz.copy(), faces.copy()
    assert denoise_mesh(xyz, faces).tobytes() == denoise_mesh(xyz, faces).tobytes()
    assert np.array_equal(xyz, kept[0])
    assert np.array_equal(faces, kept[1])


def test_huge_and_tiny_meshes_are_denoised_alike():
    xyz, faces = box(6)
    noisy = across(xyz, faces, 0.3)
    plain = denoise_mesh(noisy, faces)
    for scale in (2.0**-500, 2.0**300):
        np.testing.assert_allclose(denoise_mesh(noisy * scale, faces) / scale, plain, atol=1e-9)


def test_an_open_sheet_keeps_its_border():
    xyz, faces = sheet()
    denoised = denoise_mesh(on_axes(xyz, 0.35), faces)
    for axis in range(2):
        low, high = denoised[xyz[:, axis] == 0, axis].mean(), denoised[xyz[:, axis] == 19, axis].mean()
        assert abs(low) < 0.3
        assert abs(high - 19) < 0.3


def test_vertices_without_a_face_stay():
    xyz, faces = torus(20, 40)
    alone = np.array([[9.0, 8, 7], [0, 0, 0]])
    denoised = denoise_mesh(np.concatenate([alone[:1], on_axes(xyz, 0.03), alone[1:]]), faces + 1)
    np.testing.assert_array_equal(denoised[[0, -1]], alone)


def test_two_components_are_denoised():
    xyz, faces = box()
    both = np.concatenate([across(xyz, faces, 0.3), across(xyz, faces, 0.3, seed=1) + 50])
    denoised = denoise_mesh(both, np.concatenate([faces, faces + len(xyz)]))
    assert angle(denoised[: len(xyz)], xyz, faces) < 6
    assert angle(denoised[len(xyz) :], xyz, faces) < 6


def test_degenerate_faces_and_edges_of_three_faces_give_finite_vertices():
    xyz, faces = sheet(8)
    noisy = np.concatenate([on_axes(xyz, 0.3), [[3.0, 3, 4], [3, 3, 4]]])
    odd = [[5, 5, 6], [7, 7, 7], [27, 28, 64], [64, 65, 27], faces[0], faces[0]]
    assert np.isfinite(denoise_mesh(noisy, np.concatenate([faces, odd]))).all()


@pytest.mark.parametrize(
    ("xyz", "faces"),
    [
        (np.empty((0, 3)), np.empty((0, 3), int)),
        (np.ones((3, 3)), []),
        (np.ones((3, 3)), [[0, 1, 2]]),
        (np.zeros((3, 3)), [[0, 1, 2]]),
        (np.ones((3, 3)), [[0, 0, 2]]),
    ],
    ids=["nothing", "no face", "one place", "the origin", "no proper face"],
)
def test_where_nothing_can_be_done_vertices_stay(xyz, faces):
    np.testing.assert_array_equal(denoise_mesh(xyz, faces), xyz)


def test_one_face_and_pure_noise_stay_finite():
    assert np.isfinite(denoise_mesh(np.eye(3), [[0, 1, 2]])).all()
    _, faces = sheet(12)
    assert np.isfinite(denoise_mesh(np.random.default_rng(3).normal(size=(144, 3)), faces)).all()


def test_noise_of_zero_leaves_everything():
    xyz, faces = torus(10, 20)
    np.testing.assert_array_equal(denoise_mesh(xyz, faces, noise=0), xyz)


def test_vertices_move_along_the_direction_in_which_they_are_unsure():
    xyz, faces = box()
    ray = np.array([0.48, 0.6, 0.64])
    noisy = xyz + np.random.default_rng(0).normal(0, 0.3, (len(xyz), 1)) * ray
    covariance = np.broadcast_to(np.outer(ray, ray), (len(xyz), 3, 3))
    step = denoise_mesh(noisy, faces, covariance=covariance) - noisy
    assert np.abs(step - (step @ ray)[:, None] * ray).max() < 1e-9
    assert angle(noisy + step, xyz, faces) < 0.5 * angle(noisy, xyz, faces)


def test_vertices_that_are_sure_stay_and_the_scale_of_the_covariance_does_not_matter():
    xyz, faces = box()
    noisy = across(xyz, faces, 0.3)
    covariance = np.tile(np.eye(3), (len(xyz), 1, 1))
    covariance[::2] = 0
    denoised = denoise_mesh(noisy, faces, covariance=covariance)
    np.testing.assert_array_equal(np.abs(denoised - noisy)[::2] < 1e-9, True)
    np.testing.assert_allclose(denoise_mesh(noisy, faces, covariance=covariance * 1e-6), denoised, atol=1e-9)


def test_kernel_of_means_is_the_sum_that_it_says():
    rng = np.random.default_rng(4)
    faces = sheet(5)[1].astype(np.int32)
    count = len(faces)
    normals, guide, centres = rng.normal(size=(3, count, 3))
    areas = rng.uniform(0.5, 1, count)
    shared = (faces[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    square = lambda x: ((x[:, None] - x[None]) ** 2).sum(axis=2)  # noqa: E731
    exponent = square(centres) / (2 * 1.5**2) + square(guide) / (2 * 0.7**2)
    means = (shared * areas * np.maximum(1 - exponent / 8, 0) ** 8) @ normals
    start, at = face_neighbours(25, faces)
    out = np.empty((count, 3))
    _mesh.average_normals(normals, guide, centres, areas, *_mesh.rings(faces, start, at), 1.5, 0.7, out)
    np.testing.assert_allclose(out, means / np.linalg.norm(means, axis=1, keepdims=True), atol=1e-12)


def test_gain_of_second_differences_is_that_of_the_matrix():
    xyz, faces = sheet(5)
    start, at = face_neighbours(len(xyz), faces)
    step = np.zeros((len(xyz), len(xyz)))
    for a, b, c in faces:
        step[[a, a, b, b, c, c], [b, c, a, c, a, b]] += 1
    twice = np.eye(len(xyz)) - step / step.sum(axis=1, keepdims=True)
    twice = twice @ twice
    np.testing.assert_allclose(_mesh.second_gain(faces, start, at), (twice**2).sum(axis=1))


@pytest.mark.parametrize(
    ("xyz", "faces", "more", "line"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], {}, r"xyz is float64 of shape \(3, 2\), expected \(N, 3\)"),
        ([[0, 0, 0], [np.nan, 0, 0], [0, 1, 0]], [[0, 1, 2]], {}, "at vertex 1, expected finite"),
        ([[0, 0, 0], [1e200, 0, 0], [0, 1, 0]], [[0, 1, 2]], {}, "at vertex 1, expected finite, at most 1e"),
        (np.eye(3), [[0, 1]], {}, r"faces is int64 of shape \(1, 2\), expected \(F, 3\) integers"),
        (np.eye(3), [[0.0, 1, 2]], {}, "faces is float64"),
        (np.eye(3), [[0, 1, 5]], {}, r"faces is \[0, 1, 5\] at face 0, expected vertices in 0..2"),
        (np.eye(3), [[-1, 1, 2]], {}, "at face 0, expected vertices in 0..2"),
        (np.eye(3), [[1, 2, 3]], {}, "counted from 1, so give faces - 1"),
        (np.eye(3), [[0, 1, 2]], {"noise": -1.0}, "noise is -1.0, expected a number from 0"),
        (np.eye(3), [[0, 1, 2]], {"noise": "much"}, "noise is <U4 of shape \\(\\), expected a single number"),
        (np.eye(3), [[0, 1, 2]], {"covariance": np.eye(3)}, r"expected \(3, 3, 3\) real numbers"),
        (np.eye(3), [[0, 1, 2]], {"covariance": np.full((3, 3, 3), np.inf)}, "covariance is not finite"),
        (np.eye(3), [[0, 1, 2]], {"covariance": -np.tile(np.eye(3), (3, 1, 1))}, "semidefinite at vertex 0"),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(xyz, faces, more, line):
    with pytest.raises(InputError, match=line) as caught:
        denoise_mesh(xyz, faces, **more)
    assert "\n" not in str(caught.value)
