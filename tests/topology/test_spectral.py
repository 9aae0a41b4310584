import numpy as np
import pytest
from scipy.linalg import expm
from scipy.sparse import csr_array, diags_array

from tspslam import (
    InputError,
    build_complex,
    chebyshev_filter,
    heat_filter,
    heat_kernel,
    sample_signals,
    smooth_signals,
    tikhonov_filter,
)
from tspslam.topology import _spectral
from tspslam.topology.laplacian import parts_of, unsigned_laplacian
from tspslam.topology.spectral import LARGEST_DENSE, spectral_filter

from .scenes import grid_faces, torus_faces

TORUS, GRID = build_complex(torus_faces(), 192), build_complex(grid_faces(), 30, edges=[[0, 29]])
LAPLACIANS = [L for c in (TORUS, GRID) for L in (c.L0, c.L1, c.L2, unsigned_laplacian(c, "edge"))]
every = pytest.mark.parametrize("L", LAPLACIANS)


def noise(L, *channels):
    return np.random.default_rng(0).normal(size=(L.shape[0], *channels))


@every
@pytest.mark.parametrize("t", [0.0, 0.3, 1.0, 10.0, 200.0])
def test_the_polynomial_is_the_exponential(L, t):
    signal = noise(L)
    expected = expm(-t * L.toarray()) @ signal
    for method in ("chebyshev", "exact"):
        got = heat_filter(L, signal, t, method=method)
        assert np.linalg.norm(got - expected) <= 2e-10 * np.linalg.norm(signal)


@every
def test_channels_are_filtered_alike(L):
    signal = noise(L, 3)
    for method in ("chebyshev", "exact"):
        both = heat_filter(L, signal, 2.0, method=method)
        single = np.column_stack([heat_filter(L, signal[:, c], 2.0, method=method) for c in range(3)])
        np.testing.assert_allclose(both, single, atol=1e-12)


@every
def test_diffusion_in_two_steps_is_diffusion_in_one(L):
    signal = noise(L)
    np.testing.assert_allclose(heat_filter(L, heat_filter(L, signal, 1.5), 2.5), heat_filter(L, signal, 4.0), atol=1e-9)


def test_graph_heat_keeps_the_mass_and_the_constants():
    signal = noise(TORUS.L0)
    assert heat_filter(TORUS.L0, signal, 7.0).sum() == pytest.approx(signal.sum(), abs=1e-9)
    np.testing.assert_allclose(heat_filter(TORUS.L0, np.full(192, 0.3), 7.0), 0.3, atol=1e-10)


RESPONSES = [np.cos, lambda x: 1 / (1 + 5 * x), lambda x: x * np.exp(-x), np.ones_like, lambda x: 1e-5 * x**3]


@every
@pytest.mark.parametrize("response", RESPONSES)
def test_a_chebyshev_polynomial_follows_any_smooth_response(L, response):
    signal = noise(L, 2)
    expected = spectral_filter(L, signal, response)
    high = max(1e-300, np.abs(response(np.linspace(0, 30, 1000))).max())
    for got in (chebyshev_filter(L, signal, response), chebyshev_filter(L, signal, response, degree=400)):
        assert np.linalg.norm(got - expected) <= 1e-9 * high * np.linalg.norm(signal)


def test_fewer_terms_are_a_coarser_filter_and_steps_need_a_number_of_terms():
    signal = noise(TORUS.L0)

    def low(values):
        return (values < 2.11) * 1.0

    with pytest.raises(InputError, match=r"16384 terms do not follow the response to 1e-10, expected .* degree="):
        chebyshev_filter(TORUS.L0, signal, low)
    exact = spectral_filter(TORUS.L0, signal, low)
    errors = [np.linalg.norm(chebyshev_filter(TORUS.L0, signal, low, degree=d) - exact) for d in (10, 100, 2000)]
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.02 * np.linalg.norm(signal)


@every
@pytest.mark.parametrize("weight", [0.0, 0.5, 100.0])
def test_tikhonov_minimises_its_cost(L, weight):
    signal = noise(L, 2)
    expected = np.linalg.solve(np.eye(L.shape[0]) + weight * L.toarray(), signal)
    np.testing.assert_allclose(tikhonov_filter(L, signal, weight), expected, atol=1e-8)
    np.testing.assert_allclose(tikhonov_filter(L, signal[:, 0], weight), expected[:, 0], atol=1e-8)


@every
def test_the_bound_holds_the_spectrum(L):
    high = _spectral.largest_eigenvalue(*parts_of(csr_array(L)))
    assert np.linalg.eigvalsh(L.toarray())[-1] <= high + 1e-12


def test_a_matrix_with_negative_eigenvalues_is_told_by_what_grows_and_left_to_its_eigenvectors():
    L = csr_array(TORUS.L0 - 3 * diags_array(np.ones(192)))
    signal = noise(L)
    with pytest.raises(InputError, match="L has negative eigenvalues: the signal grows"):
        heat_filter(L, signal, 2.0)
    expected = expm(-2 * L.toarray()) @ signal
    np.testing.assert_allclose(heat_filter(L, signal, 2.0, method="exact"), expected, rtol=1e-6, atol=1e-6)


def test_rows_of_the_kernel_are_those_of_the_exponential():
    kernel, dense = heat_kernel(GRID.L0, 0.7), expm(-0.7 * GRID.L0.toarray())
    np.testing.assert_allclose(kernel.rows([3, 17, 3]), dense[[3, 17, 3]], atol=1e-10)
    np.testing.assert_allclose(kernel.rows(5)[0], dense[5], atol=1e-10)


def test_any_function_of_the_eigenvalues_is_a_filter():
    signal = noise(TORUS.L0)
    twice = spectral_filter(TORUS.L0, signal, lambda values: values**2)
    np.testing.assert_allclose(twice, TORUS.L0 @ (TORUS.L0 @ signal), atol=1e-9)


@pytest.mark.parametrize("level", ["vertex", "edge", "face"])
def test_unsigned_neighbours_are_those_that_touch(level):
    c = GRID
    corners = {"vertex": np.arange(30)[:, None], "edge": c.edges, "face": c.faces}[level]
    pairs = {frozenset(edge) for edge in c.edges.tolist()}

    def touch(a, b):
        shared = len(set(a) & set(b))
        return {"vertex": frozenset((*a, *b)) in pairs, "edge": shared == 1, "face": shared == 2}[level]

    rows = corners.tolist()
    A = np.array([[float(i != j and touch(rows[i], rows[j])) for j in range(len(rows))] for i in range(len(rows))])
    np.testing.assert_array_equal(unsigned_laplacian(c, level).toarray(), np.diag(A.sum(axis=1)) - A)


def test_smoothing_keeps_constants_and_marked_elements_and_does_not_see_the_numbering():
    faces, uv = grid_faces(), np.random.default_rng(1).uniform(2, 40, (30, 2))
    uv[4] = np.nan
    flat = sample_signals(np.full((50, 50), 0.4), uv, GRID)
    smooth = smooth_signals(GRID, flat, 3.0)
    for level in ("vertex", "edge", "face"):
        ok = getattr(flat, f"{level}_ok")
        np.testing.assert_allclose(getattr(smooth, level), np.where(ok, 0.4, 0.0), atol=1e-9)
    image = np.random.default_rng(2).random((50, 50))
    order = np.random.default_rng(3).permutation(30)
    place = np.argsort(order)
    plain = build_complex(faces, 30)
    moved = build_complex(place[faces], 30)
    one = smooth_signals(plain, sample_signals(image, uv, plain), 1.0)
    other = smooth_signals(moved, sample_signals(image, uv[order], moved), 1.0)
    np.testing.assert_allclose(one.vertex[order], other.vertex, atol=1e-12)
    np.testing.assert_allclose(one.face, other.face, atol=1e-12)
    np.testing.assert_allclose(np.sort(one.edge), np.sort(other.edge), atol=1e-12)


def test_tiny_matrices_are_symmetric_too():
    signal = noise(TORUS.L0)
    np.testing.assert_allclose(
        heat_filter(TORUS.L0 * 1e-250, signal, 1e250), heat_filter(TORUS.L0, signal, 1.0), atol=1e-9
    )


def test_empty_and_lonely_complexes_are_filtered():
    assert heat_filter(build_complex([], 0).L0, [], 1.0).shape == (0,)
    np.testing.assert_array_equal(heat_filter(build_complex([], 3).L0, [1.0, 2, 3], 5.0), [1, 2, 3])


def test_a_texture_is_refused_by_filters_of_one_level():
    signals = sample_signals(np.zeros((9, 9)), np.zeros((192, 2)), TORUS)
    with pytest.raises(InputError, match="signal is a Signals, expected an array of one level"):
        heat_filter(TORUS.L1, signals, 1.0)


@pytest.mark.parametrize(("call", "message"), [
    (lambda: tikhonov_filter(TORUS.L0, np.zeros(192), -1.0), r"weight is -1\.0, expected a finite number >= 0"),
    (lambda: tikhonov_filter(TORUS.L0 - 9 * diags_array(np.ones(192)), noise(TORUS.L0), 1.0), "cannot be solved"),
    (lambda: chebyshev_filter(TORUS.L0, np.zeros(192), np.cos, degree=0), "degree is 0, expected an integer from 1"),
    (lambda: chebyshev_filter(TORUS.L0, np.zeros(192), np.cos, error=1.0), r"error is 1\.0"),
    (lambda: chebyshev_filter(TORUS.L0, np.zeros(192), lambda x: x[:3]), r"response gives shape \(3,\)"),
    (lambda: chebyshev_filter(TORUS.L0, np.zeros(192), lambda x: x * np.nan), "finite values"),
])  # fmt: skip
def test_bad_filters_are_named(call, message):
    with pytest.raises(InputError, match=message):
        call()


def skewed():
    return csr_array(np.triu(np.ones((4, 4))))


@pytest.mark.parametrize(("arguments", "message"), [
    ({"t": -1.0}, "t is -1.0, expected a finite number >= 0"),
    ({"t": np.inf}, "t is inf"),
    ({"t": "1"}, "t is '1'"),
    ({"t": 1e12}, "expected a smaller t: over 100000 terms"),
    ({"method": "magic"}, "method is 'magic'"),
    ({"error": 0.0}, "error is 0.0"),
    ({"signal": np.zeros(7)}, r"signal is float64 of shape \(7,\), expected \(192,\)"),
    ({"signal": np.full(192, np.nan)}, "signal is not finite at element 0"),
    ({"signal": np.zeros(192, complex)}, "signal is complex128"),
    ({"L": np.eye(192)}, "expected a square sparse matrix"),
    ({"L": csr_array((192, 3))}, "expected a square sparse matrix"),
    ({"L": skewed(), "signal": np.zeros(4)}, "L is not symmetric"),
    ({"L": csr_array(np.full((2, 2), np.nan)), "signal": np.zeros(2)}, "L holds values that are not finite"),
    ({"L": TORUS.L0 * 1e200}, "L holds values that are not finite or too large"),
    ({"signal": np.full(192, 1e200)}, "signal is too large at element 0"),
    ({"L": csr_array(np.eye(2) * 1j), "signal": np.zeros(2)}, "L is complex128"),
])  # fmt: skip
def test_bad_input_is_named(arguments, message):
    given = {"L": TORUS.L0, "signal": np.zeros(192), "t": 1.0} | arguments
    with pytest.raises(InputError, match=message):
        heat_filter(**given)


def test_work_that_is_too_large_is_refused_with_its_size():
    many = csr_array(diags_array(np.ones(LARGEST_DENSE + 1)))
    with pytest.raises(InputError, match="4001 rows are too many for eigenvectors"):
        heat_filter(many, np.zeros(LARGEST_DENSE + 1), 1.0, method="exact")
    huge = heat_kernel(csr_array(diags_array(np.ones(1_000_000))), 1.0)
    with pytest.raises(InputError, match=r"400 rows of 1000000 take 3.0 GiB, expected at most 2"):
        huge.rows(np.arange(400))
    for bad in ([192], [-1], [0.5], [[1]]):
        with pytest.raises(InputError, match="expected 0 to 191"):
            heat_kernel(TORUS.L0, 1.0).rows(bad)


def test_wrong_levels_masks_and_responses_are_named():
    with pytest.raises(InputError, match="level is 'cell'"):
        unsigned_laplacian(TORUS, "cell")
    with pytest.raises(InputError, match=r"ok is int64 of shape \(3,\), expected \(192,\) bool"):
        unsigned_laplacian(TORUS, "vertex", [1, 0, 1])
    with pytest.raises(InputError, match=r"response gives shape \(2,\), expected \(192,\) finite"):
        spectral_filter(TORUS.L0, np.zeros(192), lambda values: values[:2])
