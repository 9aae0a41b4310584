"""One pair's walk through `Session.process`: straight on, with few visits to each file."""

import sys
from collections import Counter
from pathlib import Path

import pytest

import tspslam
from tspslam import Session, Settings, StereoPair
from tspslam.vision.images import PreparedImage

from .sequences import DETECTOR, RIG, corridor

SRC = str(Path(tspslam.__file__).parent)
GROUND = ("_checks.py", "_threads.py")  # what looks at values for all files, or runs them in threads
MAX_VISITS = 3


def visits(session, pair):
    """How often each file is entered from another one by a function that is given the pair or one of its images."""
    entered = Counter()

    def note(frame, event, _argument):
        if event != "call":
            return
        code, caller = frame.f_code, frame.f_back
        file, before = code.co_filename, caller.f_code.co_filename if caller else ""
        if not file.startswith(SRC) or file == before or file.endswith(GROUND) or code.co_name == "<lambda>":
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(isinstance(frame.f_locals.get(name), StereoPair | PreparedImage) for name in names if name != "self"):
            entered[Path(file).relative_to(SRC).as_posix()] += 1

    sys.setprofile(note)
    try:
        frame = session.process(pair)
    finally:
        sys.setprofile(None)
    return frame, entered


@pytest.fixture(scope="module")
def walks():
    with Session(RIG, Settings(detector=DETECTOR)) as session:
        return [visits(session, pair) for pair in corridor(6.0)]


def test_a_pair_enters_a_file_at_most_three_times(walks):
    assert any(frame.is_keyframe for frame, _ in walks[1:])
    assert not all(frame.is_keyframe for frame, _ in walks)
    worst = {file: count for _, entered in walks for file, count in entered.items() if count > MAX_VISITS}
    assert not worst


def test_a_pair_makes_few_stops(walks):
    """Sixty before the rooms were made, in 17 files."""
    assert max(sum(entered.values()) for _, entered in walks) <= 20
    assert max(len(entered) for _, entered in walks) <= 12
