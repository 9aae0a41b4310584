import importlib.util
import sys

import numpy as np
import pytest

from tspslam import (
    InputError,
    betti_numbers,
    build_complex,
    harmonic_basis,
    hodge_decompose,
    sample_signals,
    spectrum,
)
from tspslam.topology import hodge, solvers
from tspslam.topology.hodge import curl, divergence, gradient
from tspslam.topology.homology import closed_cochains

from .scenes import FIGURE_2, OCTAHEDRON, grid_faces, scattered, torus_faces

TORUS, SPHERE = build_complex(torus_faces(), 192), build_complex(OCTAHEDRON, 6)
FACES = grid_faces(9, 9)
HOLES = build_complex(np.delete(FACES, np.arange(3, 120, 4), axis=0), 81)  # more cycles than are projected on
TWO_PARTS = build_complex(np.concatenate([torus_faces(), OCTAHEDRON + 192]), 200, edges=[[198, 199]])
FAN = build_complex([[0, 1, k] for k in range(2, 7)], 7)  # five faces at one edge
PLANE = build_complex(
    [[0, 1, 4], [0, 1, 5], [0, 2, 3], [0, 2, 5], [0, 3, 4], [1, 2, 3], [1, 2, 4], [1, 3, 5], [2, 4, 5], [3, 4, 5]], 6
)
COMPLEXES = {
    "torus": TORUS,
    "sphere": SPHERE,
    "holes": HOLES,
    "parts": TWO_PARTS,
    "fan": FAN,
    "projective plane": PLANE,
}
every = pytest.mark.parametrize("complex_", COMPLEXES.values(), ids=COMPLEXES)
multigrid = pytest.mark.skipif(importlib.util.find_spec("pyamg") is None, reason="pyamg is not installed")
methods = pytest.mark.parametrize("method", ["factor", "cg", pytest.param("amg", marks=multigrid)])


def flow(complex_, *channels):
    return np.random.default_rng(0).normal(size=(len(complex_.edges), *channels))


def fresh(complex_):
    return build_complex(complex_.faces, complex_.n, edges=complex_.edges)


@every
@methods
def test_the_parts_are_orthogonal_and_sum_to_the_signal(complex_, method):
    signal = flow(complex_)
    parts = hodge_decompose(fresh(complex_), signal, method=method)
    np.testing.assert_allclose(sum(parts), signal, atol=1e-8)
    scale = signal @ signal
    for k, one in enumerate(parts):
        for other in parts[k + 1 :]:
            assert abs(one @ other) <= 1e-8 * scale
    B1, B2 = complex_.B1, complex_.B2
    for silent in (B2.T @ parts.gradient, B1 @ parts.curl, B1 @ parts.harmonic, B2.T @ parts.harmonic):
        assert np.linalg.norm(silent) <= 1e-8 * np.linalg.norm(signal)


@every
def test_the_parts_are_those_of_least_squares(complex_):
    signal = flow(complex_)
    parts = hodge_decompose(complex_, signal)
    for matrix, part in ((complex_.B1.T, parts.gradient), (complex_.B2, parts.curl)):
        dense = matrix.toarray().astype(float)
        np.testing.assert_allclose(part, dense @ np.linalg.lstsq(dense, signal, rcond=None)[0], atol=1e-9)


@every
def test_channels_are_split_alike(complex_):
    signal = flow(complex_, 3)
    for method in ("factor", "cg"):
        together = hodge_decompose(complex_, signal, method=method)
        for c in range(3):
            for one, all_ in zip(hodge_decompose(complex_, signal[:, c], method=method), together, strict=True):
                np.testing.assert_allclose(all_[:, c], one, atol=1e-10)


@every
def test_each_part_of_a_part_is_itself(complex_):
    parts = hodge_decompose(complex_, flow(complex_))
    for k, part in enumerate(parts):
        again = hodge_decompose(complex_, part)
        np.testing.assert_allclose(again[k], part, atol=1e-10)


def test_the_torus_has_two_cycles_and_the_sphere_none():
    assert betti_numbers(TORUS) == (1, 2, 1)
    assert betti_numbers(SPHERE) == (1, 0, 1)
    assert betti_numbers(PLANE) == (1, 0, 0)
    assert betti_numbers(TWO_PARTS) == (3, 2, 2)
    assert betti_numbers(build_complex([], 0)) == (0, 0, 0)
    for complex_, null in ((TORUS, 2), (SPHERE, 0)):
        assert (np.linalg.eigvalsh(complex_.L1.toarray()) < 1e-9).sum() == null
        assert harmonic_basis(complex_).shape[1] == null


def rank(matrix):
    return np.linalg.matrix_rank(matrix.toarray().astype(float)) if min(matrix.shape) else 0


@pytest.mark.parametrize("seed", range(40))
def test_betti_numbers_and_cocycles_of_any_complex_are_those_of_dense_ranks(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 12))
    faces = np.array([rng.choice(n, 3, replace=False) for _ in range(rng.integers(1, 30))])
    complex_ = build_complex(faces, n, edges=np.array([rng.choice(n, 2, replace=False) for _ in range(4)]))
    r1, r2 = rank(complex_.B1), rank(complex_.B2)
    cycles = len(complex_.edges) - r1 - r2
    assert betti_numbers(complex_) == (n - r1, cycles, len(complex_.faces) - r2)
    closed, basis = closed_cochains(complex_), harmonic_basis(complex_)
    assert closed.shape[1] == cycles
    assert np.abs(complex_.B2.T @ closed).max(initial=0) < 1e-12
    np.testing.assert_allclose(basis.T @ basis, np.eye(cycles), atol=1e-12)
    assert np.abs(complex_.L1 @ basis).max(initial=0) < 1e-10


def test_the_harmonic_basis_is_the_null_space_of_the_dense_laplacian():
    values, vectors = np.linalg.eigh(TORUS.L1.toarray())
    null = vectors[:, values < 1e-9]
    basis = harmonic_basis(TORUS)
    np.testing.assert_allclose(basis @ basis.T, null @ null.T, atol=1e-9)


def test_gradient_divergence_and_curl_are_the_incidence_matrices():
    toy = build_complex(FIGURE_2, 5)
    p, s = np.arange(5.0) ** 2, flow(toy)
    np.testing.assert_array_equal(gradient(toy, p), p[toy.edges[:, 1]] - p[toy.edges[:, 0]])
    assert abs(curl(toy, gradient(toy, p))).max() == 0
    assert gradient(toy, p) @ s == pytest.approx(p @ divergence(toy, s))


def test_numbering_and_orientation_do_not_matter():
    order = np.random.default_rng(1).permutation(192)
    moved = build_complex(order[torus_faces()], 192)
    signal = flow(TORUS)
    ends = order[TORUS.edges]
    place = {tuple(edge): k for k, edge in enumerate(moved.edges.tolist())}
    where = np.array([place[tuple(sorted(edge))] for edge in ends.tolist()])
    sign = np.where(ends[:, 0] < ends[:, 1], 1.0, -1.0)
    carried = np.empty_like(signal)
    carried[where] = sign * signal
    for one, other in zip(hodge_decompose(TORUS, signal), hodge_decompose(moved, carried), strict=True):
        np.testing.assert_allclose(sign * other[where], one, atol=1e-10)


def test_the_basis_that_is_kept_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        harmonic_basis(TORUS)[0, 0] = 1


def test_the_factor_is_kept_with_the_complex(monkeypatch):
    complex_ = build_complex(torus_faces(), 192)
    hodge_decompose(complex_, flow(complex_))
    monkeypatch.setattr(solvers.Solver, "prepare", None)
    hodge_decompose(complex_, flow(complex_))


@pytest.mark.parametrize("installed", [pytest.param(True, marks=multigrid), False])
def test_large_systems_go_to_multigrid_or_conjugate_gradients(monkeypatch, installed):
    monkeypatch.setattr(solvers, "LARGEST_FACTOR", 100)
    if not installed:
        monkeypatch.setattr(solvers.importlib.util, "find_spec", lambda name: None)
    assert solvers._chosen("auto", 100) == "factor"
    assert solvers._chosen("auto", 101) == ("amg" if installed else "cg")
    parts = hodge_decompose(fresh(TORUS), flow(TORUS))
    for one, other in zip(parts, hodge_decompose(TORUS, flow(TORUS)), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)


def test_small_and_broken_complexes_are_split():
    for complex_ in (
        build_complex([], 0),
        build_complex([], 4),
        build_complex([[0, 1, 2]], 3),
        build_complex([], 2, edges=[[0, 1]]),
    ):
        signal = flow(complex_)
        np.testing.assert_allclose(sum(hodge_decompose(complex_, signal)), signal, atol=1e-12)


def test_a_texture_is_refused_by_the_hodge_tools():
    uv, complex_ = scattered()
    signals = sample_signals(np.zeros((40, 60)), uv, complex_)
    with pytest.raises(InputError, match="a Signals is unsigned"):
        hodge_decompose(complex_, signals)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"edge_signal": np.zeros(5)}, r"edge signal is float64 of shape \(5,\), expected \(576,\)"),
    ({"edge_signal": np.full(576, np.inf)}, "edge signal is not finite at edge 0"),
    ({"edge_signal": np.zeros(576, complex)}, "edge signal is complex128"),
    ({"method": "lu"}, "method is 'lu', expected 'auto', 'factor', 'cg' or 'amg'"),
])  # fmt: skip
def test_bad_input_is_named(arguments, message):
    with pytest.raises(InputError, match=message):
        hodge_decompose(TORUS, **({"edge_signal": np.zeros(576)} | arguments))


def test_what_is_missing_too_large_or_does_not_converge_is_said(monkeypatch):
    monkeypatch.setattr(hodge, "LARGEST_BASIS", 1000)
    with pytest.raises(InputError, match=r"a basis for 2 cycles takes 0\.0 GiB"):
        harmonic_basis(fresh(TORUS))
    monkeypatch.setattr(solvers, "TOLERANCE", 1e-30)
    with pytest.raises(InputError, match="conjugate gradients do not converge"):
        hodge_decompose(fresh(TORUS), flow(TORUS), method="cg")
    monkeypatch.setitem(sys.modules, "pyamg", None)
    monkeypatch.setattr(solvers.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"needs pyamg, expected .* pip install 'tspslam\[mesh\]'"):
        hodge_decompose(fresh(TORUS), flow(TORUS), method="amg")


def test_a_factor_that_does_not_fit_is_refused(monkeypatch):
    from scipy.sparse import linalg

    def full(*_arguments, **_options):
        raise MemoryError

    monkeypatch.setattr(linalg, "splu", full)
    with pytest.raises(InputError, match="a factor of 192 rows does not fit into memory, expected method='cg'"):
        hodge_decompose(fresh(TORUS), flow(TORUS), method="factor")
    with pytest.raises(InputError, match="a factor of 576 rows does not fit into memory, expected fewer"):
        spectrum(TORUS.L1, 3)
