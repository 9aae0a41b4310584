"""Recordings joined: stamps rise, names tell which, one rig; what is wrong with them is said in one line."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam import InputError, Rig, StereoPair
from tspslam.datasets import JoinedSequence
from tspslam.datasets.joined import Excerpt, StoredRecording

RIG = Rig(fx=50, fy=50, cx=8, cy=4, baseline=0.1, width=16, height=8)


class Recording:
    def __init__(self, name, stamps, rig=RIG, broken=(), knows_stamps=True):
        self.name, self.rig, self._stamps, self._broken = name, rig, stamps, broken
        if knows_stamps:
            self.stamps = np.array(stamps, np.float64)

    def __len__(self):
        return len(self._stamps)

    def __getitem__(self, index):
        index = range(len(self))[index]
        if index in self._broken:
            raise InputError(f"{self.name} {index}: is broken")
        image = np.full((8, 16), index, np.uint8)
        return StereoPair(image, image, self.rig, float(self._stamps[index]), index, f"{index:03d}")


def test_pairs_follow_each_other_under_numbers_stamps_and_names_of_their_own():
    both = JoinedSequence([Recording("a", [0, 1, 2]), Recording("b", [5.5, 6.5])])
    assert (both.name, len(both), both.starts, both.rig) == ("a+b", 5, (0, 3), RIG)
    assert [(pair.index, pair.stamp, pair.name) for pair in both] == [
        (0, 0, "000"), (1, 1, "001"), (2, 2, "002"), (3, 5.5, "b/000"), (4, 6.5, "b/001"),
    ]  # fmt: skip
    assert [pair.left[0, 0] for pair in both] == [0, 1, 2, 0, 1]
    assert both[-1].index == 4
    with pytest.raises(IndexError):
        both[5]


@pytest.mark.parametrize("knows_stamps", [True, False])
def test_stamps_that_do_not_rise_are_moved_by_whole_seconds(knows_stamps):
    recordings = [Recording(name, [0.1, 0.7], knows_stamps=knows_stamps) for name in "abc"]
    joined = JoinedSequence(recordings)
    assert joined.offsets.tolist() == [0, 11, 22]
    stamps = [pair.stamp for pair in joined]
    assert (np.diff(stamps) > 0).all()
    own = [joined.own_stamp(k, stamp) for k, stamp in enumerate(stamps)]
    assert own[:2] == [None, None]
    if knows_stamps:
        assert own[2:] == [0.1, 0.7] * 2  # to the last bit, though 0.1 + 11 - 11 is another number
    assert own[2:] == pytest.approx([0.1, 0.7] * 2)


def test_broken_pairs_at_the_ends_do_not_hide_the_stamps():
    first = Recording("a", [3, 4, 5], broken=(0, 2), knows_stamps=False)
    assert JoinedSequence([first, Recording("b", [0, 1])]).offsets.tolist() == [0, 15]
    with pytest.raises(InputError, match="a 0: is broken"):
        JoinedSequence([first, Recording("b", [9])])[0]
    with pytest.raises(InputError, match="a 1: is broken"):
        JoinedSequence([Recording("a", [3, 4], broken=(0, 1), knows_stamps=False)])


def test_names_are_words_that_differ():
    names = JoinedSequence([Recording(name, [0]) for name in ("a b/c", "x", "X", "x", "x-2", "")]).names
    assert names == ("a_b_c", "x", "X-2", "x-3", "x-2-2", "recording")


@pytest.mark.parametrize(
    ("recordings", "said"),
    [
        ([], "there is none, expected one or more"),
        ([Recording("a", [0]), Recording("b", [])], "b: has no pairs, expected one or more"),
        (
            [Recording("a", [0]), Recording("b", [0], replace(RIG, fx=51))],
            "b: its fx is 51, that of a is 50; expected recordings of one rig",
        ),
        ([Recording("a", [0]), Recording("b", [0], replace(RIG, width=20))], "its width is 20, that of a is 16"),
    ],
)
def test_what_does_not_go_together_is_refused(recordings, said):
    with pytest.raises(InputError, match=said):
        JoinedSequence(recordings)


def test_what_is_told_of_each_is_told_of_all():
    one, other = Recording("a", [0]), Recording("b", [0])
    one.unpaired, other.remarks, other.warnings = ["left.png"], ["by name"], [{"code": "x", "message": "y"}]
    one.remarks = ["by name"]  # the same of both
    other.doubts = lambda: [{"code": "z", "message": "w"}]
    both = JoinedSequence([one, other])
    assert (both.unpaired, both.remarks) == (["left.png"], ["by name"])
    assert [told["code"] for told in (*both.warnings, *both.doubts())] == ["x", "z"]


def test_a_stored_recording_stands_for_pairs_that_are_not_at_hand():
    stored = StoredRecording("a", RIG, 3, np.array([0.0, 2.0]), 0.0)
    both = JoinedSequence([stored, Recording("b", [0, 1])])
    assert (both.stored, both.offsets.tolist(), both[3].name) == (3, [0, 13], "b/000")
    with pytest.raises(InputError, match="a: its pair 1 is not at hand"):
        both[1]


def test_an_excerpt_has_some_of_the_pairs():
    whole = Recording("a", [0, 1, 2, 3])
    whole.truth = np.arange(4.0)[:, None, None] * np.eye(4)
    part = Excerpt(whole, range(1, 4, 2))
    assert (part.name, part.rig, len(part), part.stamps.tolist()) == ("a", RIG, 2, [1, 3])
    assert [pair.stamp for pair in (part[0], part[1])] == [1, 3]
    assert part.truth[:, 0, 0].tolist() == [1, 3]
    assert Excerpt(Recording("a", [0], knows_stamps=False), range(1)).stamps is None
