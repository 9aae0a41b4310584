"""Rows of a run: frozen records that become plain rows and come back the same."""

import dataclasses
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest

from tspslam import InputError
from tspslam.run._checkpoint import unpack, write_checkpoint
from tspslam.run.record import ComplexRecord, FrameRecord, SkippedPair, flatten_row
from tspslam.vision.slam._state import SCHEMA

COMPLEX = ComplexRecord(3, 4, 5, 2, 1, (0, 2), "image Delaunay", 9, 8, 4, 1, 0.25, 0.5)
TRACKED = FrameRecord(0, "a" * 64, "first", 0.5, True, False, 0, bits=12, unknown=(2047.0,), complex_=COMPLEX)
ROWS = [
    TRACKED,
    SkippedPair(1, "b" * 64, "its images do not fit"),
    FrameRecord(2, "c" * 64, "", 1, False, True, 0, no_complex=""),  # a stamp without a point, and no words
    FrameRecord(3, "d" * 64, "last", 1.5, False, False, 80),
]


def packed(rows):
    stamps = [row.stamp for row in rows if isinstance(row, FrameRecord)]
    empty = {
        name: np.zeros([n if isinstance(n, int) else 0 for n in axes], kind) for name, (kind, axes) in SCHEMA.items()
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "state.npz"
        write_checkpoint(path, b"me", rows, empty | {"stamps": np.array(stamps, np.float64)})
        return path.read_bytes()


def test_rows_come_back_as_they_were():
    assert unpack(packed(ROWS), b"me")[0] == ROWS


def test_a_row_is_frozen():
    for row in (TRACKED, COMPLEX, ROWS[1]):
        with pytest.raises(dataclasses.FrozenInstanceError):
            row.index = 1


def test_a_plain_row_says_nothing_of_what_is_usual():
    assert list(flatten_row(ROWS[3])) == [
        "index", "input_hash", "name", "stamp", "is_keyframe", "is_lost", "landmarks_seen",
    ]  # fmt: skip
    assert json.loads(json.dumps(flatten_row(TRACKED)))["pinched_vertices"] == [0, 2]


CHANGES = {
    "a value more": {"more": 1},
    "a record within": {"complex_": {}},
    "an offset alone": {"vertical_offset_px": 1.0},
    "no text": {"name": 7},
    "a list for a number": {"landmarks_seen": [80]},
    "a number for a list": {"unknown": 7.0},
    "text in a list": {"unknown": ["7"]},
    "half a bit": {"bits": 0.5},
    "null": {"bits": None},
    "too many": {"landmarks_seen": 1 << 41},
}


@pytest.mark.parametrize("what", CHANGES)
def test_a_row_that_no_record_gives_is_refused(what, monkeypatch):
    monkeypatch.setattr("tspslam.run._checkpoint.flatten_row", lambda row: flatten_row(row) | CHANGES[what])
    with pytest.raises(InputError, match=r"^row 0 is none of a frame$"):
        unpack(packed(ROWS[3:]), b"me")
