"""Flows along edges: integrals that are exact where the rule says so, and what Hodge makes of them."""

from itertools import pairwise

import numpy as np
import pytest

from tspslam import InputError, betti_numbers, build_complex, edge_flow, harmonic_basis, hodge_decompose
from tspslam.topology.hodge import curl, divergence, gradient


def torus(rings=24, sides=16):
    """Positions and triangles of a torus, R = 1, r = 0.4, on a regular grid; and its two angles."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij"))
    a, b = 2 * np.pi * i / rings, 2 * np.pi * j / sides
    xyz = np.column_stack([(1 + 0.4 * np.cos(b)) * np.cos(a), (1 + 0.4 * np.cos(b)) * np.sin(a), 0.4 * np.sin(b)])
    corner, right, down = i * sides + j, (i + 1) % rings * sides + j, i * sides + (j + 1) % sides
    across = (i + 1) % rings * sides + (j + 1) % sides
    faces = np.concatenate([np.column_stack([corner, right, across]), np.column_stack([corner, across, down])])
    return xyz, faces, a, b


def loops(rings=24, sides=16):
    """Vertices along the torus, and around its tube."""
    return [[*range(0, rings * sides, sides), 0], [*range(sides), 0]]


def circulation(complex_, flow, loop):
    """What flows along a closed way over vertices."""
    place = {tuple(edge): k for k, edge in enumerate(complex_.edges.tolist())}
    return sum(flow[place[i, j]] if i < j else -flow[place[j, i]] for i, j in pairwise(loop))


def scattered(dimension, n=30):
    rng = np.random.default_rng(dimension)
    complex_ = build_complex(np.sort(np.array([rng.choice(n, 3, replace=False) for _ in range(40)])), n)
    return complex_, rng.normal(size=(n, dimension)), rng


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_linear_field_is_integrated_exactly_from_its_values_at_the_vertices(dimension):
    complex_, x, rng = scattered(dimension)
    A, c = rng.normal(size=(dimension, dimension)), rng.normal(size=dimension)
    i, j = complex_.edges.T
    steps = (np.arange(1000) + 0.5) / 1000  # the midpoint rule, exact on linear fields too
    along = x[i, None] + steps[:, None] * (x[j] - x[i])[:, None]
    exact = np.einsum("esd,ed->e", along @ A.T + c, x[j] - x[i]) / 1000
    assert np.abs(edge_flow(complex_, x, x @ A.T + c) - exact).max() < 1e-9


def test_the_gradient_of_a_quartic_potential_gives_its_differences_when_the_field_is_a_function():
    complex_, x, _ = scattered(3)
    flow = edge_flow(complex_, x, lambda p: np.column_stack([4 * p[:, 0] ** 3, 3 * p[:, 1] ** 2, np.ones(len(p))]))
    assert np.abs(flow - gradient(complex_, x[:, 0] ** 4 + x[:, 1] ** 3 + x[:, 2])).max() < 1e-11


def test_a_field_seen_from_the_other_end_flows_the_other_way():
    forth = edge_flow(build_complex([], edges=[[0, 1]]), [[0, 0], [2, 1.0]], [[1, 0], [3, 2.0]])
    back = edge_flow(build_complex([], edges=[[0, 1]]), [[2, 1], [0, 0.0]], [[3, 2], [1, 0.0]])
    assert forth.tolist() == [5.0]
    assert back.tolist() == [-5.0]


def test_the_two_flows_of_a_torus_are_its_harmonic_ones():
    xyz, faces, a, b = torus()
    complex_ = build_complex(faces)
    along = np.column_stack([-np.sin(a), np.cos(a), np.zeros_like(a)])
    around = np.column_stack([-np.sin(b) * np.cos(a), -np.sin(b) * np.sin(a), np.cos(b)])
    found = [hodge_decompose(complex_, edge_flow(complex_, xyz, field)).harmonic for field in (along, around)]
    assert betti_numbers(complex_).cycles == 2
    for flow in found:
        assert np.abs(divergence(complex_, flow)).max() < 1e-9
        assert np.abs(curl(complex_, flow)).max() < 1e-9
    basis = harmonic_basis(complex_)
    assert np.linalg.matrix_rank(np.column_stack([*found, basis]), tol=1e-8) == 2
    periods = np.array([[circulation(complex_, flow, loop) for loop in loops()] for flow in found])
    assert (np.abs(np.diag(periods)) > (1, 0.5)).all()  # m, of a way of 2 π 1.4 and of 2 π 0.4
    assert (np.abs(periods[[0, 1], [1, 0]]) < 0.1).all()


@pytest.mark.parametrize(("xyz", "field", "message"), [
    (np.zeros((2, 3)), np.zeros((3, 3)), r"xyz has shape \(2, 3\), expected \(3, 3\)"),
    (np.zeros((3, 3)), np.zeros((3, 2)), r"field has shape \(3, 2\), expected \(3, 3\), a vector at each position"),
    (np.zeros((3, 3)), np.zeros(3), r"field has shape \(3,\)"),
    (np.zeros((3, 3)), lambda x: x[:, 0], r"field has shape \(3,\)"),
    (np.zeros((3, 3)), np.full((3, 3), np.nan), r"not finite at edge \[0, 1\]"),
    (np.zeros((3, 3)), "wind", "field is <U4 of shape"),
])  # fmt: skip
def test_what_is_no_field_is_named(xyz, field, message):
    with pytest.raises(InputError, match=message):
        edge_flow(build_complex([[0, 1, 2]]), xyz, field)


def test_a_vertex_without_an_edge_may_be_unknown():
    xyz = np.array([[0, 0, 1], [1, 0, 1], [0, 1, 1], [np.nan] * 3])
    assert np.isfinite(edge_flow(build_complex([[0, 1, 2]], 4), xyz, xyz)).all()
