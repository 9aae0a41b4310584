"""Speed, as ratios to a named reference in the same run. Machines are shared: the best of three attempts counts."""

import pytest

from benchmarks import slam, spectral, topology


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
    """Measured 6 to 22 times."""
    attempts = [spectral.heat_figures("torus, 20 000", 10.0) for _ in range(3)]
    assert max(f["error"] for f in attempts) < 1e-10
    assert min(f["us"] / f["expm_multiply_us"] for f in attempts) < 0.4


def test_hodge_is_faster_than_the_factors_of_both_laplacians_and_later_much_faster():
    """Measured: 0.5 of them at first, 0.02 later."""
    attempts = [spectral.hodge_figures("torus, 20 000") for _ in range(3)]
    assert min(f["first_us"] / f["scipy_factors_us"] for f in attempts) < 0.9
    assert min(f["later_us"] / f["scipy_factors_us"] for f in attempts) < 0.06
    assert max(f["laws"] for f in attempts) < 1e-8


def test_four_responses_cost_less_than_two_and_a_half():
    assert best(spectral.bank_figures) < 0.62


def test_t_mahf_costs_a_small_share_of_our_own_mahf():
    """The paper: 0.6; measured: 0.01 to 0.03."""
    assert best(lambda: spectral.stage_figures(1_000)) < 0.2


def test_a_street_is_processed_faster_than_opencvs_parts_go_from_frame_to_frame():
    """Measured 1.4 times as fast, with maps, complexes and files; OpenCV's parts make a path only."""
    source = slam.held("street", slam.street(12.0))
    assert min(slam.ours(source)[1] / slam.naive(source)[1] for _ in range(3)) < 1.0
