"""What a run refuses before it starts, and what a session does beside it."""

import dataclasses
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from tspslam import GeometryError, InputError, Rig, Session, Settings, StereoPair
from tspslam.run.config import describe, resolve
from tspslam.run.evaluate import evaluated
from tspslam.run.mesh import filter_mesh
from tspslam.run.pipeline import OnePair, run
from tspslam.run.record import pair_hash
from tspslam.run.sequence import input_hash
from tspslam.topology.harmonic import Tmahf
from tspslam.topology.surface import DelaunaySurface

from ..sequences import DETECTOR, corridor

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

        def __call__(self, grey):
            raise AssertionError("never called")

    plain, printed = Session(RIG), Session(RIG, Settings(detector=Detector()))
    assert input_hash(PAIR, plain) == pair_hash(PAIR) != input_hash(PAIR, printed)


def test_a_pair_of_another_rig_is_refused():
    with pytest.raises(InputError, match=r"its rig is .*fx=50.* expected the session's .*fx=60"):
        Session(Rig(fx=60, fy=50, cx=10, cy=5, baseline=0.1, width=20, height=10)).process(PAIR)


def test_a_keyframe_is_completed_once_whoever_asks():
    sequence = corridor(2.0)
    asked, began = [], threading.Event()

    def surface(cloud):
        began.set()
        asked.append(threading.current_thread())
        return DelaunaySurface()(cloud)

    session = Session(sequence.rig, Settings(detector=DETECTOR, surface=surface))
    frame = session.process(sequence[0])
    assert began.wait(10)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: frame.response, range(8)))
    assert all(one is found[0] for one in found)
    assert [thread is threading.current_thread() for thread in asked] == [False]
    assert {"points", "surface", "complex", "signals", "response"} <= set(frame.seconds)


@pytest.mark.parametrize("error", [GeometryError, ZeroDivisionError])
def test_what_a_keyframe_cannot_show_is_said_when_it_is_asked_for(error):
    sequence = corridor(4.0)

    def surface(_):
        raise error("surface: nothing to join")

    session = Session(sequence.rig, Settings(detector=DETECTOR, surface=surface))
    frame = session.process(sequence[0])
    assert frame.is_keyframe
    for _ in range(2):
        with pytest.raises(error, match="nothing to join"):
            _ = frame.response
    rest = [session.process(sequence[k]) for k in range(1, len(sequence))]
    assert any(one.is_keyframe for one in rest)
    assert not any(one.is_lost for one in rest)


def test_the_last_of_several_errors_is_told(tmp_path):
    sequence = corridor(2.0)
    dark = [dataclasses.replace(sequence[k], left=0 * sequence[k].left) for k in range(3)]
    with pytest.raises(InputError, match=r"none of 3 pairs can be used; the last: .*000002"):
        run(Pairs(sequence.rig, dark), tmp_path / "out", resolve())


class Pairs(list):
    name = "pairs"

    def __init__(self, rig, pairs):
        super().__init__(pairs)
        self.rig = rig


class TwoPairs:
    name, rig = "two", RIG

    def __len__(self):
        return 2

    def __getitem__(self, index):
        return [PAIR, PAIR][index]


@pytest.mark.parametrize(("given", "said"), [
    ({"source": "/some/drive"}, r"source is the path '/some/drive', expected a sequence .*open_sequence\(path\)"),
    ({"source": PAIR}, r"source is StereoPair without __len__, expected a sequence of pairs: OnePair\(pair\)"),
    ({"source": TwoPairs}, "source is <class .*TwoPairs'>, expected a sequence of pairs"),
    ({"resolved": None}, r"settings is NoneType, expected a Settings: tspslam\.Settings\(detector=\.\.\.\)"),
    ({"resolved": {"detector.count": 3}}, "settings is dict, expected a Settings"),
    ({"resolved": Settings(filter=print)}, "settings: filter is builtin_function_or_method, expected one with settings"),
    ({"out": None}, "out is NoneType, expected the path"),
    ({"frames": (0, 3)}, r"frames is tuple \(0, 3\), expected a range, such as range\(0, 3\)"),
    ({"frames": slice(0, 1)}, r"frames is slice slice\(0, 1, None\), expected a range"),
    ({"frames": range(3)}, r"two: frames range\(0, 3\) go beyond its pairs, expected a range within 0 to 2"),
    ({"frames": range(1, -2, -1)}, r"two: frames range\(1, -2, -1\) go beyond its pairs"),
    ({"progress": True}, "progress is bool, expected a callable"),
    ({"on_frame": "print"}, "on_frame is 'print', expected a callable"),
])  # fmt: skip
def test_a_run_refuses_what_is_of_another_kind_in_a_line(tmp_path, given, said):
    whole = {"source": TwoPairs(), "out": tmp_path / "out", "resolved": resolve()} | given
    with pytest.raises(InputError, match=said):
        run(**whole)
    assert not (tmp_path / "out").exists()


def test_settings_go_where_resolved_ones_do(tmp_path, small_pair):
    pair = StereoPair(*small_pair)
    given, resolved = (tmp_path / "given", tmp_path / "resolved")
    run(OnePair(pair), given, Settings())
    run(OnePair(pair), resolved, resolve())
    assert (given / "config.yaml").read_bytes() == (resolved / "config.yaml").read_bytes()
    assert (given / "run.json").read_bytes() == (resolved / "run.json").read_bytes()
    assert describe(Settings(), ["filter.order"])["filter.order"]["origin"] == "given"


@pytest.mark.parametrize(("call", "said"), [
    (lambda: filter_mesh("none.ply", "left.png", "calib.yaml", "out", "tmahf"), "stage is the text 'tmahf', expected a Tmahf"),
    (lambda: filter_mesh(None, "left.png", "calib.yaml", "out", Tmahf()), "mesh is NoneType, expected the path"),
    (lambda: filter_mesh("none.ply", "none.png", "calib.yaml", "out", Tmahf()), "none.png: "),
    (lambda: evaluated("none.tum", "none.txt"), "none.tum: "),
    (lambda: evaluated(Settings(), "none.txt"), "run is Settings, expected the path"),
    (lambda: resolve(assignments="filter.order=2"), "assignments is the text 'filter.order=2', expected a list"),
    (lambda: resolve(file="none.yaml"), "none.yaml: "),
    (lambda: describe({}), "settings is dict, expected a Settings"),
])  # fmt: skip
def test_functions_beside_it_take_text_for_paths_and_refuse_other_kinds_too(call, said):
    with pytest.raises(InputError, match=said):
        call()
