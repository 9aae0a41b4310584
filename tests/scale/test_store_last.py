"""What threads of a process keep of images: each its own, what two share once, and no more than there are threads."""

import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import tspslam.io
from tspslam.scale.stores import hidden, tiled_filter
from tspslam.scale.stores._last import LastMade

from .test_store_hidden import two_walls

LONG = 60  # s, after which a test that waits for ever fails


class Value:
    """Something that can be seen to go."""

    alive = 0

    def __init__(self):
        Value.alive += 1

    def __del__(self):
        Value.alive -= 1


def test_two_threads_on_two_keys_get_their_own_and_make_them_once():
    kept, together, made = LastMade(), threading.Barrier(2, timeout=LONG), []

    def make(key):
        made.append(key)
        together.wait()  # both are in the middle of it
        return key

    def ask(key):
        found = []
        for _ in range(5):
            found.append(kept.get(key, lambda: make(key)))
            together.wait()  # the other one has asked too
        return found

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(ask, "ab")) == [["a"] * 5, ["b"] * 5]
    assert sorted(made) == ["a", "b"]


def test_two_threads_on_one_key_share_what_is_made_once():
    kept, begun, made = LastMade(), threading.Event(), []

    def make():
        begun.set()
        made.append(object())
        return made[-1]

    def ask_later(_):
        assert begun.wait(LONG)
        return kept.get("a", make)

    with ThreadPoolExecutor(3) as pool:
        later = [pool.submit(ask_later, k) for k in range(2)]
        first = pool.submit(kept.get, "a", make)
        assert {id(each.result(LONG)) for each in [*later, first]} == {id(made[0])}
    assert len(made) == 1


def test_a_thread_keeps_one_value_and_what_it_had_goes_before_the_next_is_made():
    kept, before = LastMade(), Value.alive

    def make():
        assert Value.alive == before
        return Value()

    for key in "abca":
        kept.get(key, make)
        assert Value.alive == before + 1
    thread = threading.Thread(target=kept.get, args=("d", Value))
    thread.start()
    thread.join(LONG)
    assert Value.alive == before + 1  # that of the thread went with it


def test_what_could_not_be_made_is_made_by_the_next_and_nothing_is_a_value_too():
    kept, made = LastMade(), []
    with pytest.raises(ZeroDivisionError):
        kept.get("a", lambda: 1 / 0)
    assert [kept.get("a", lambda: made.append(1)) for _ in range(3)] == [None] * 3
    assert made == [1]


@pytest.mark.parametrize(
    ("module", "ask", "owner", "maker"),
    [
        (hidden, hidden._kept_depths, hidden, "draw_depths"),
        (tiled_filter, tiled_filter._pixels, tspslam.io, "read_image"),
    ],
)
def test_threads_that_go_through_two_images_in_turns_make_each_once(tmp_path, monkeypatch, module, ask, owner, maker):
    mesh = two_walls(tmp_path)[0].mesh
    alone = [ask(mesh, k).copy() for k in range(2)]
    assert not np.array_equal(*alone)
    whole, together, made = getattr(owner, maker), threading.Barrier(2, timeout=LONG), []
    monkeypatch.setattr(owner, maker, lambda *given: made.append(1) or whole(*given))
    monkeypatch.setattr(module, "_kept", type(module._kept)())

    def go_through(k):
        found = []
        for _ in range(20):
            together.wait()
            found.append(ask(mesh, k))
        return found

    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(go_through, range(2)))
    for k in range(2):
        assert all(np.array_equal(each, alone[k]) for each in found[k])
    assert len(made) == 2
