"""What a run refuses before it starts."""

import numpy as np
import pytest

from tspslam import InputError, Rig, Session, Settings, StereoPair
from tspslam.config import resolve
from tspslam.journey import _input_hash
from tspslam.pipeline import OnePair, run
from tspslam.records import pair_hash

RIG = Rig(fx=50, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)
PAIR = StereoPair(np.zeros((10, 20), np.uint8), np.zeros((10, 20), np.uint8), RIG)


def test_no_frames_are_no_run(tmp_path):
    with pytest.raises(InputError, match=r"range\(0, 0\) select none of 1 pairs"):
        run(OnePair(PAIR), tmp_path / "out", resolve(), frames=range(0))
    assert not (tmp_path / "out").exists()


def test_one_pair_is_a_sequence_of_one():
    assert [pair.name for pair in OnePair(PAIR)] == ["pair"]
    assert OnePair(PAIR)[-1] is PAIR


def test_files_that_stages_read_are_part_of_the_input():
    class Detector:
        fingerprint = "of a file"

    plain, printed = Session(RIG), Session(RIG, Settings(detector=Detector()))
    assert _input_hash(PAIR, plain) == pair_hash(PAIR) != _input_hash(PAIR, printed)


def test_a_pair_of_another_rig_is_refused():
    with pytest.raises(InputError, match=r"its rig is .*fx=50.* expected the session's .*fx=60"):
        Session(Rig(fx=60, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)).process(PAIR)
