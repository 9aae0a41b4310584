"""Keyframes are foreseen, so that keypoints are there in time; that changes when they are detected, and nothing else."""

import pickle
import threading

import numpy as np
import pytest

from tspslam import Session, Settings, set_threads
from tspslam.vision.images import MadeOnce, PreparedImage, prepare
from tspslam.vision.slam.foresight import Foresight
from tspslam.vision.slam.tracking import level_planes

from ...sequences import DETECTOR, RIG, corridor


@pytest.fixture(scope="module")
def pairs():
    return list(corridor(4.0))


@pytest.fixture
def two_threads():
    set_threads(2)
    yield
    set_threads(None)


def follow(pairs, detector=DETECTOR):
    """Path, covariances and responses of pairs that are each made ready before the last one is processed."""
    with Session(RIG, Settings(detector=detector)) as session:
        ready, frames = session.prepare(pairs[0]), []
        for after in [*pairs[1:], None]:
            coming = None if after is None else session.prepare(after)
            frames.append(session.process(ready))
            ready = coming
        path = session.finish()
    found = [path.T_world_camera, *(frame.tracked.covariance for frame in frames), frames[-1].response.z]
    return frames, b"".join(part.tobytes() for part in found)


def test_the_path_is_the_same_bytes_whether_keyframes_are_foreseen_or_not(pairs, two_threads, monkeypatch):
    noted = Foresight.note

    def always(answer):
        def note(self, *counts, **said):
            noted(self, *counts, **said)
            if answer != self.is_due:
                self.is_due = answer
                if answer and self.on_due:
                    self.on_due()

        return note

    given = [follow(pairs)[1]]
    for answer in (True, False):
        monkeypatch.setattr(Foresight, "note", always(answer))
        given.append(follow(pairs)[1])
    assert given[0] == given[1] == given[2]


def test_most_keyframes_are_foreseen_and_few_other_frames(pairs, two_threads, monkeypatch):
    noted, due = Foresight.note, []

    def note(self, *counts, **said):
        noted(self, *counts, **said)
        due.append(self.is_due)

    monkeypatch.setattr(Foresight, "note", note)
    frames, _ = follow(pairs)
    is_keyframe = [frame.is_keyframe for frame in frames][1:]
    foreseen = [was_due for was_due, came in zip(due, is_keyframe, strict=False) if came]
    in_vain = [was_due for was_due, came in zip(due, is_keyframe, strict=False) if not came]
    assert len(foreseen) >= 2
    assert sum(foreseen) >= 0.5 * len(foreseen)
    assert sum(in_vain) <= 0.25 * len(in_vain)


def test_each_image_is_searched_for_keypoints_once(pairs, two_threads):
    seen, lock = [], threading.Lock()

    def detect(grey):
        with lock:
            seen.append(grey.tobytes())
        return DETECTOR(grey)

    frames, found = follow(pairs, detector=detect)
    assert len(seen) == len(set(seen)) >= 2 * sum(frame.is_keyframe for frame in frames)
    assert found == follow(pairs)[1]


def test_one_thread_detects_no_keypoints_in_vain(pairs):
    seen = []

    def detect(grey):
        seen.append(grey.tobytes())
        return DETECTOR(grey)

    many = follow(pairs)[1]
    set_threads(1)
    try:
        frames, found = follow(pairs, detector=detect)
    finally:
        set_threads(None)
    second = 1  # the motion of the second frame is not known: it is located by the keypoints of its left image
    assert 2 * sum(frame.is_keyframe for frame in frames) <= len(seen)
    assert len(seen) <= 2 * sum(frame.is_keyframe for frame in frames) + second
    assert found == many


def test_a_detector_that_fails_ahead_fails_where_its_keypoints_are_wanted(pairs, two_threads):
    asked = []

    def detect(grey):
        asked.append(threading.current_thread().name)
        if len(asked) > 2:  # the first pair's
            raise ZeroDivisionError
        return DETECTOR(grey)

    with pytest.raises(ZeroDivisionError):
        follow(pairs, detector=detect)


def test_keypoints_are_needed_where_no_motion_is_known_and_not_where_more_is_seen():
    foresight = Foresight(0.5)
    for count in (0, 1000, 900, 950, 0):
        foresight.note(count, 1000, is_keyframe=count == 1000)
        assert foresight.is_due == (count == 0)


def test_a_rate_at_which_landmarks_became_fewer_is_kept_over_a_keyframe():
    foresight, called = Foresight(0.5), []
    foresight.on_due = lambda: called.append(True)
    foresight.note(1000, 1000, is_keyframe=True)
    assert not called
    foresight.note(450, 1200, is_keyframe=True)  # 0.45 of the last: so many of the next one's 1200 would be 540
    assert called == [True]


def test_who_asks_while_another_makes_it_waits_for_the_same():
    made, began, kept = [], threading.Event(), MadeOnce()
    given, results = object(), []

    def make():
        began.set()
        made.append(threading.get_ident())
        threading.Event().wait(0.05)
        return object()

    first = threading.Thread(target=lambda: results.append(kept.of(given, make)))
    first.start()
    began.wait()
    results.append(kept.of(given, make))
    first.join()
    assert len(made) == 1
    assert results[0] is results[1]


def test_what_could_not_be_made_is_made_anew():
    kept, given = MadeOnce(), object()
    with pytest.raises(ZeroDivisionError):
        kept.of(given, lambda: 1 / 0)
    assert kept.of(given, lambda: 7) == 7


def test_planes_are_levelled_once_for_one_offset_and_an_image_is_copied_without_what_was_made_of_it(pairs):
    images = prepare(pairs[0])
    offset, other = 0.3, 0.4
    right = level_planes(images, offset)[1]
    assert level_planes(images, offset)[1] is right
    assert np.abs(level_planes(images, other)[1] - right).max() > 0
    image = PreparedImage(pairs[0].left)
    image.features(DETECTOR)
    again = pickle.loads(pickle.dumps(image))
    assert again.features(DETECTOR).uv.tobytes() == image.features(DETECTOR).uv.tobytes()
