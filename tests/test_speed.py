"""Speed, as ratios to a named reference in the same run. Machines are shared: the best of three attempts counts."""

import pytest

from benchmarks import topology


def best(figures, key="ratio", attempts=3):
    return min(figures()[key] for _ in range(attempts))


@pytest.mark.parametrize(("centering", "limit"), [("none", 2.5), ("harmonic", 4.0)])
def test_the_filter_costs_a_few_sparse_products(centering, limit):
    assert best(lambda: topology.filter_figures(centering)) <= limit


@pytest.mark.parametrize("n", [2_000, 20_000])
def test_the_stage_costs_what_thirty_sparse_products_do(n):
    """1.5 µs a vertex where the product takes 0.05 µs."""
    assert best(lambda: topology.stage_figures(n)) <= 30


def test_sixteen_times_the_pixels_cost_six_times_the_time():
    assert best(topology.resolution_figures) <= 6


def test_construction_is_eighty_times_faster_than_one_object_a_simplex():
    assert topology.construction_figures()["times_faster"] >= 80


def test_heat_is_faster_than_the_exponential_of_scipy():
    """Measured 3.5 to 10 times at t = 1, 19 at t = 10."""
    assert topology.heat_figures(10.0)["times_faster_than_scipy"] > 5
