"""Blocks of large arrays come back when the last view is gone, no sooner, and are used again."""

import gc
import mmap
import threading

import numpy as np
import pytest

from tspslam.topology import _memory

pytestmark = pytest.mark.skipif(not hasattr(mmap, "MADV_FREE"), reason="the system keeps no blocks")
LARGE = 3 << 20  # of float64: 24 MB


@pytest.fixture(autouse=True)
def nothing_is_kept(monkeypatch):
    gc.collect()
    monkeypatch.setattr(_memory, "_kept", [])


def test_the_block_of_an_array_that_is_gone_is_used_again():
    array = _memory.empty((LARGE, 1))
    place = array.ctypes.data
    del array
    assert len(_memory._kept) == 1
    assert _memory.empty(LARGE - 1000, np.int64).ctypes.data == place


def test_a_block_is_not_given_back_while_a_view_is_left():
    view = _memory.empty(LARGE).reshape(-1, 2)[5:, 1]
    view[:] = 3
    other = _memory.empty(LARGE)
    other[:] = 4
    assert not _memory._kept
    assert (view == 3).all()
    del other, view
    assert len(_memory._kept) == 2


def test_a_block_that_is_far_too_large_is_left_for_others():
    del (array := [_memory.empty(4 * LARGE)])[:]
    array.append(_memory.empty(LARGE))
    assert len(_memory._kept) == 1
    array.append(_memory.empty(LARGE + (1 << 18)))
    assert not _memory._kept


def test_no_more_is_kept_than_the_bound_and_the_oldest_go_first(monkeypatch):
    monkeypatch.setattr(_memory, "MOST", 72 << 20)
    first, *others = [_memory.empty(LARGE) for _ in range(4)]
    oldest = first.ctypes.data
    del first
    others.clear()
    assert sum(map(len, _memory._kept)) == _memory.MOST
    array = _memory.empty(3 * LARGE // 2 * 2)
    assert oldest not in [np.frombuffer(memory, np.uint8).ctypes.data for memory in _memory._kept]
    assert sum(map(len, _memory._kept)) + array.nbytes <= _memory.MOST


def test_blocks_in_use_and_kept_together_stay_below_a_bound():
    del (array := [_memory.empty(LARGE)])[:]
    with _memory.bounded(_memory._used + (60 << 20)):
        array += [_memory.empty(LARGE), _memory.empty(LARGE + (1 << 18))]  # 24 and 26 MB
        array.pop()
        assert len(_memory._kept) == 1
        array.append(_memory.empty(2 * LARGE))  # 48 MB beside 24 in use
        assert not _memory._kept
        array.pop()
        assert not _memory._kept
    array.clear()
    assert len(_memory._kept) == 1


def test_what_is_kept_goes_where_there_is_no_room_beside_it(monkeypatch):
    del (array := [_memory.empty(LARGE)])[:]
    given = mmap.mmap

    def refuse_beside_others(*words, **options):
        if _memory._kept:
            raise OSError(12, "Cannot allocate memory")
        return given(*words, **options)

    monkeypatch.setattr(_memory.mmap, "mmap", refuse_beside_others)
    array.append(_memory.empty(2 * LARGE))
    assert not _memory._kept
    monkeypatch.undo()
    array.clear()


def test_where_the_system_gives_no_block_the_heap_does(monkeypatch):
    def refuse(*_, **__):
        raise OSError(12, "Cannot allocate memory")

    monkeypatch.setattr(_memory.mmap, "mmap", refuse)
    array = _memory.empty(LARGE)
    assert array.shape == (LARGE,)
    del array
    assert not _memory._kept


def test_a_system_that_does_not_know_the_advice_keeps_blocks_all_the_same(monkeypatch):
    monkeypatch.setattr(_memory.mmap, "MADV_HUGEPAGE", 10**6, raising=False)
    monkeypatch.setattr(_memory.mmap, "MADV_FREE", 10**6)
    del (array := [_memory.empty(LARGE)])[:]
    array.append(_memory.empty(LARGE))
    assert array[0].shape == (LARGE,)


def test_small_arrays_begin_with_a_cache_line_and_keep_nothing():
    for kind in (bool, np.int32, np.float64, np.complex128):
        array = _memory.empty((7, 3), kind)
        assert array.shape == (7, 3)
        assert array.dtype == kind
        assert array.ctypes.data % 64 == 0
    del array
    assert not _memory._kept


def test_two_threads_never_hold_the_same_block():
    def work(mark):
        for _ in range(30):
            array = _memory.empty(LARGE // 4)
            array[::512] = mark
            wrong.extend(array[::512][array[::512] != mark].tolist())

    wrong: list[float] = []
    threads = [threading.Thread(target=work, args=(mark,)) for mark in (1.0, 2.0, 3.0)]
    for each in threads:
        each.start()
    for each in threads:
        each.join()
    assert not wrong
