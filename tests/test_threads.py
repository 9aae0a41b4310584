"""One budget of threads: with one, none is started, and the bytes are the same."""

import pytest

import tspslam
from tspslam import InputError, Session, Settings, _threads

from .sequences import DETECTOR, RIG, corridor


@pytest.fixture
def budget():
    yield tspslam.set_threads
    tspslam.set_threads(None)


def bytes_of(pairs):
    with Session(RIG, Settings(detector=DETECTOR)) as session:
        frames = [session.process(pair) for pair in pairs]
        path = session.finish()
    return path.T_world_camera.tobytes() + frames[0].response.z.tobytes()


def test_one_thread_or_many_give_the_same_bytes_and_one_is_one(budget, monkeypatch):
    pairs = list(corridor(3.0))
    budget(4)
    many = bytes_of(pairs)
    budget(1)
    monkeypatch.setattr(_threads, "ThreadPoolExecutor", None)  # a second thread would fail
    assert bytes_of(pairs) == many


def test_what_a_worker_of_one_thread_raises_is_raised_by_the_result(budget):
    budget(1)
    with _threads.Worker() as worker:
        assert worker.submit(max, 1, 2).result() == 2
        with pytest.raises(ZeroDivisionError):
            worker.submit(lambda: 1 / 0).result()


@pytest.mark.parametrize("count", [0, -1, 2000, True, "2", 1.5])
def test_a_budget_out_of_range_is_refused(budget, count):
    with pytest.raises(InputError, match=r"threads is .*, expected 1 to 1024, or None for one a core"):
        budget(count)
