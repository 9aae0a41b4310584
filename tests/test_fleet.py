"""The simulated scheduler of `benchmarks.fleet`: laws where the answer is known."""

import math

import numpy as np
import pytest

from benchmarks.fleet.costs import Sample, fit_costs
from benchmarks.fleet.simulate import Cluster, Task, simulate

EQUAL = [Task(2.0)] * 12


def test_one_worker_takes_the_sum_of_all_times():
    outcome = simulate([Task(seconds) for seconds in (3.0, 1.0, 2.5)], Cluster(1, start_seconds=0.5))
    assert outcome.makespan == pytest.approx(7.0)
    assert outcome.computing == pytest.approx(6.5 / 7.0)


@pytest.mark.parametrize("workers", [1, 2, 3, 4, 5, 12, 20])
def test_equal_tasks_take_rounds(workers):
    assert simulate(EQUAL, Cluster(workers)).makespan == pytest.approx(2.0 * math.ceil(12 / workers))


def test_a_list_schedule_is_within_its_longest_task_of_the_best():
    random = np.random.default_rng(0)
    for workers in (2, 7, 30):
        seconds = sorted(random.lognormal(3.0, 1.0, 100), reverse=True)
        best = max(sum(seconds) / workers, seconds[0])  # no schedule is shorter
        made = simulate([Task(each) for each in seconds], Cluster(workers)).makespan
        assert made >= best * (1 - 1e-12)
        assert made <= sum(seconds) / workers + seconds[0]  # any list schedule (Graham 1966)


def test_a_scheduler_serves_so_many_messages_a_second():
    outcome = simulate([Task(0.01)] * 1000, Cluster(500, scheduler_seconds=0.002))
    assert outcome.makespan == pytest.approx(1000 * 2 * 0.002, rel=0.01)
    assert outcome.scheduler > 0.99
    assert outcome.limit == "scheduler"


def test_one_storage_is_shared_by_all():
    tasks = [Task(0.1, reads=1e8, writes=5e7)] * 200
    outcome = simulate(tasks, Cluster(100, bandwidth=1e9, link=1e9))
    assert outcome.makespan >= 200 * 1.5e8 / 1e9
    assert outcome.makespan == pytest.approx(30.0, rel=0.05)
    assert outcome.limit == "storage"


def test_a_link_of_its_own_holds_back_one_worker():
    outcome = simulate([Task(1.0, reads=1e9)], Cluster(1, bandwidth=1e10, link=1e8))
    assert outcome.makespan == pytest.approx(11.0)
    assert outcome.storage == 0.0


def test_flows_that_come_and_go_share_evenly():
    outcome = simulate([Task(0.0, reads=1e9), Task(0.0, reads=3e9)], Cluster(2, bandwidth=1e9))
    assert outcome.makespan == pytest.approx(4.0)  # both at half speed for 2 s, then one for 2 s


def test_deaths_cost_at_most_what_lies_between_checkpoints():
    tasks = [Task(100.0, reads=1e7, writes=1e7)] * 40
    there = Cluster(8, link=1e8, bandwidth=1e9, lifetime=300.0, checkpoint_seconds=10.0, start_seconds=3.0)
    outcome = simulate(tasks, there)
    assert outcome.deaths > 5
    assert 0 < outcome.lost_seconds <= 10.0 * outcome.deaths
    without = simulate(tasks, Cluster(8, link=1e8, bandwidth=1e9, lifetime=300.0, start_seconds=3.0))
    assert without.lost_seconds > outcome.lost_seconds
    assert without.makespan > outcome.makespan


def test_the_same_seed_gives_the_same_run():
    runs = [simulate(EQUAL, Cluster(3, lifetime=5.0, seed=seed)) for seed in (1, 1, 2)]
    assert runs[0] == runs[1] != runs[2]


def test_costs_that_are_sums_of_parts_are_found_again():
    samples = [
        Sample((f, f * p), 2.0 + 0.01 * f + 0.05 * f * p, 3e8 + 1e5 * f, 1e6 * f * p, 5e4 * f)
        for f in (10, 40, 200)
        for p in (0.08, 0.3, 0.45)
    ]
    model = fit_costs(samples)
    assert model.seconds == pytest.approx((2.0, 0.01, 0.05))
    assert model.memory(1000, 450) == pytest.approx(4e8)
    task = model.task(1000, 450)
    assert (task.seconds, task.reads, task.writes) == pytest.approx((34.5, 4.5e8, 5e7))
    assert model.worst < 1e-9


def test_costs_tell_how_far_they_are_off():
    model = fit_costs([Sample((1.0,), 1.0, 1, 1, 1), Sample((2.0,), 1.5, 1, 1, 1), Sample((4.0,), 4.0, 1, 1, 1)])
    assert 0.1 < model.worst < 0.5
