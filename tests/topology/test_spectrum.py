import numpy as np
import pytest

from tspslam import InputError, build_complex, spectrum, unsigned_laplacian

from .scenes import torus_faces

SMALL, LARGE = build_complex(torus_faces(), 192), build_complex(torus_faces(24, 31), 744)
LAPLACIANS = [L for c in (SMALL, LARGE) for L in (c.L0, c.L1, c.L2, unsigned_laplacian(c, "face"))]
every = pytest.mark.parametrize("L", LAPLACIANS)


@every
@pytest.mark.parametrize("which", ["lowest", "highest"])
def test_the_ends_of_the_spectrum_are_those_of_the_dense_one(L, which):
    found, dense = spectrum(L, 12, which), np.linalg.eigvalsh(L.toarray())
    np.testing.assert_allclose(found.values, dense[:12] if which == "lowest" else dense[-12:], atol=1e-8)
    np.testing.assert_allclose(L @ found.vectors, found.vectors * found.values, atol=1e-7)
    np.testing.assert_allclose(found.vectors.T @ found.vectors, np.eye(12), atol=1e-9)


@every
def test_the_transform_keeps_energy_and_its_inverse_gives_the_signal_back(L):
    whole, signal = spectrum(L), np.random.default_rng(0).normal(size=(L.shape[0], 2))
    coefficients = whole.transform(signal)
    assert np.linalg.norm(coefficients) == pytest.approx(np.linalg.norm(signal))
    np.testing.assert_allclose(whole.inverse(coefficients), signal, atol=1e-10)


def test_the_torus_has_the_eigenvalues_of_its_closed_form():
    i, j = (2 * np.pi * np.arange(count) / count for count in (24, 31))
    i, j = np.meshgrid(i, j)
    closed_form = np.sort((6 - 2 * (np.cos(i) + np.cos(j) + np.cos(i + j))).ravel())
    np.testing.assert_allclose(spectrum(LARGE.L0).values, closed_form, atol=1e-9)
    np.testing.assert_allclose(spectrum(LARGE.L0, 9).values, closed_form[:9], atol=1e-9)


def test_the_same_vectors_come_each_time():
    one, other = spectrum(LARGE.L1, 5), spectrum(LARGE.L1, 5)
    assert one.vectors.tobytes() == other.vectors.tobytes()
    assert (one.vectors[np.abs(one.vectors).argmax(axis=0), range(5)] > 0).all()


def test_small_matrices_have_spectra():
    assert spectrum(build_complex([], 0).L0).vectors.shape == (0, 0)
    assert spectrum(build_complex([], 2).L0, 1).values.tolist() == [0.0]
    assert spectrum(build_complex([], 600).L0, 2, "highest").values.tolist() == [0.0, 0.0]
    np.testing.assert_allclose(spectrum(build_complex([[0, 1, 2]], 600).L0, 3, "highest").values, [0, 3, 3], atol=1e-9)


def test_an_iteration_that_ends_without_a_result_is_said(monkeypatch):
    from scipy.sparse import linalg

    def fails(*_arguments, **_options):
        raise linalg.ArpackNoConvergence("no convergence", np.zeros(0), np.zeros((0, 0)))

    monkeypatch.setattr(linalg, "eigsh", fails)
    with pytest.raises(InputError, match=r"eigenvalues do not converge: .*no convergence"):
        spectrum(LARGE.L0, 3)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"k": 0}, "k is 0, expected an integer from 1 to 192"),
    ({"k": 193}, "k is 193"),
    ({"which": "middle"}, "which is 'middle'"),
    ({"L": build_complex([], 4001).L0}, "4001 rows are too many for all eigenvectors"),
    ({"L": build_complex([], 4001).L0, "k": 2000}, r"2000 vectors of 4001 take 0\.1 GiB"),
])  # fmt: skip
def test_bad_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        spectrum(**({"L": SMALL.L0} | arguments))


def test_signals_that_do_not_fit_are_named():
    whole = spectrum(SMALL.L0, 3)
    with pytest.raises(InputError, match=r"signal is float64 of shape \(3,\), expected \(192,\)"):
        whole.transform(np.zeros(3))
    with pytest.raises(InputError, match=r"coefficients is float64 of shape \(192,\), expected \(3,\)"):
        whole.inverse(np.zeros(192))
