"""One budget of threads: with one, none is started, and the bytes are the same."""

import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

import tspslam
from tspslam import InputError, Session, Settings, _threads

from .patience import PATIENCE
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


def test_halves_of_halves_and_those_of_other_threads_do_not_wait_for_each_other(budget):
    budget(2)
    done = []

    def split(rows, depth=0):
        if depth < 3:
            _threads.both(lambda part: split(part, depth + 1), (rows, rows))
        else:
            done.append(threading.get_ident())

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(split, range(4)))
    assert len(done) == 4 * 2**3
    assert len(set(done)) > 1


def test_an_error_in_one_half_waits_for_the_other(budget):
    budget(2)
    done = []

    def work(number):
        if number:
            raise ZeroDivisionError
        time.sleep(0.05)
        done.append(number)

    with pytest.raises(ZeroDivisionError):
        _threads.both(work, (0, 1))
    assert done == [0]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no process is forked there")
def test_a_forked_process_starts_threads_of_its_own():
    code = (
        "import os\n"
        "from tspslam import _threads as t\n"
        "t.set_threads(2)\n"
        "t.both(abs, (1, 2))\n"
        "child = os.fork()\n"
        "if not child: os._exit(t.both(abs, (-3, -4)) != (3, 4))\n"
        "print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.stdout == "0\n", done.stderr


@pytest.mark.parametrize("count", [0, -1, 2000, True, "2", 1.5])
def test_a_budget_out_of_range_is_refused(budget, count):
    with pytest.raises(InputError, match=r"threads is .*, expected 1 to 1024, or None for one a core"):
        budget(count)
