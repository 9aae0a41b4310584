"""Chunks of a store: read by ourselves and by Zarr alike, kept between tiles, never when the file is another."""

import os

import numpy as np
import pytest

from tspslam.errors import InputError, OutputError
from tspslam.scale.stores import _zarr


@pytest.fixture
def array(tmp_path):
    group = _zarr.zarr().open_group(str(tmp_path / "a.zarr"), mode="w", zarr_format=3)
    return _zarr.create(group, "values", (10, 2), np.float64, 4)


VALUES = np.arange(20.0).reshape(10, 2)


@pytest.mark.parametrize("steps", [[(0, 10)], [(0, 4), (4, 8), (8, 10)], [(4, 10), (0, 4)], [(0, 3), (3, 9), (9, 10)]])
def test_zarr_reads_what_was_written_in_any_pieces(array, steps):
    for first, last in steps:
        _zarr.write(array, first, VALUES[first:last], is_synced=True)
    assert np.array_equal(array[:], VALUES)
    _zarr.check_whole(array)
    for first, last in ((0, 10), (3, 4), (2, 9), (5, 5)):
        assert np.array_equal(_zarr.read(array, first, last), VALUES[first:last])
    assert {path.name for path in _zarr.folder_of(array).iterdir()} == {"zarr.json", "c.0.0", "c.1.0", "c.2.0"}


def test_rows_that_were_read_are_the_reader_s_own(array):
    _zarr.write(array, 0, VALUES)
    _zarr.read(array, 0, 10)[:] = -1
    assert np.array_equal(_zarr.read(array, 0, 10), VALUES)


def test_a_chunk_that_was_written_anew_or_damaged_is_not_taken_from_before(array):
    _zarr.write(array, 0, VALUES)
    _zarr.read(array, 0, 10)
    _zarr.write(array, 0, VALUES + 1)
    assert np.array_equal(_zarr.read(array, 0, 10), VALUES + 1)
    path = _zarr.folder_of(array) / "c.1.0"
    data = bytearray(path.read_bytes())
    data[5] ^= 1
    path.write_bytes(data)
    os.utime(path, ns=(1, 1))
    with pytest.raises(InputError, match=r"c\.1\.0: is damaged: its checksum is another"):
        _zarr.read(array, 0, 10)
    path.unlink()
    with pytest.raises(InputError, match=r"c\.1\.0: cannot be read"):
        _zarr.read(array, 0, 10)


def test_a_chunk_that_cannot_be_written_leaves_the_old_one_and_no_other_file(array, monkeypatch):
    _zarr.write(array, 0, VALUES)

    def refuse(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_zarr.Path, "replace", refuse)
    with pytest.raises(OutputError, match="cannot be written"):
        _zarr.write(array, 0, VALUES + 1)
    monkeypatch.undo()
    assert np.array_equal(_zarr.read(array, 0, 10), VALUES)
    assert not list(_zarr.folder_of(array).glob("*.partial"))


def test_chunks_are_kept_up_to_a_bound_and_those_used_last_stay():
    kept = _zarr._Kept(2400)
    rows = [np.zeros(100) for _ in range(5)]
    for k in range(3):
        kept.add(k, rows[k])
    assert kept.find(0) is rows[0]
    kept.add(3, rows[3])
    assert [kept.find(k) is not None for k in range(4)] == [True, False, True, True]
    kept.add(4, np.zeros(301))
    assert kept.find(4) is None
    kept.add(5, np.zeros(300))
    assert [kept.find(k) is not None for k in (0, 2, 3, 5)] == [False, False, False, True]
