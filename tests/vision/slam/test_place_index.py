"""Keyframes by their looks: what the index finds is what comparing everything finds, and depends on nothing else."""

import numpy as np
import pytest

from tspslam import InputError
from tspslam.vision.slam.keyframes.settings import MapSettings
from tspslam.vision.slam.odometry import StereoOdometry, Tracking
from tspslam.vision.slam.places.index import PlaceIndex
from tspslam.vision.slam.places.map_index import MapIndex

from ...sequences import DETECTOR, RIG, corridor

# Share of bits that differ between ORB descriptors of one point, 1 to 2 m on in a synthetic street: quantiles 10, 25,
# 50, 75 and 90 % of matches that are each other's nearest were 21, 29, 39, 49 and 55 of 256 bits.
FLIPPED = (0.082, 0.113, 0.152, 0.191, 0.215)
SHARED, COUNT = 60, 400  # descriptors of a view that a keyframe of the place has too, of those of each


def descriptors(rng, count=COUNT):
    return rng.integers(0, 2**64, (count, 4), dtype=np.uint64)


def seen_again(rng, known):
    flips = rng.random((len(known), 256)) < rng.choice(FLIPPED, (len(known), 1))
    return known ^ np.packbits(flips, axis=1).view(np.uint64)


def view_of(rng, keyframe):
    """Another view of a keyframe's place."""
    return np.concatenate([seen_again(rng, keyframe[:SHARED]), descriptors(rng, COUNT - SHARED)])


def filled(keyframes):
    index = PlaceIndex()
    for number, keyframe in enumerate(keyframes):
        index.add(number, keyframe)
    return index


def compare_all(view, keyframes):
    """How many of a view's descriptors are within 40 bits of one of each keyframe's."""
    bits = np.unpackbits(view.view(np.uint8), axis=1).astype(np.float32)
    counts = []
    for keyframe in keyframes:
        known = np.unpackbits(keyframe.view(np.uint8), axis=1).astype(np.float32)
        apart = bits.sum(axis=1)[:, None] + known.sum(axis=1) - 2 * bits @ known.T
        counts.append(int((apart <= 40).any(axis=1).sum()))
    return np.array(counts)


def same_answer(one, other, view):
    return all(np.array_equal(a, b) for a, b in zip(one.query(view, 100), other.query(view, 100), strict=True))


@pytest.fixture(scope="module")
def keyframes():
    rng = np.random.default_rng(0)
    return [descriptors(rng) for _ in range(150)]


@pytest.fixture(scope="module")
def index(keyframes):
    return filled(keyframes)


def test_the_place_that_comparing_everything_finds_is_found(keyframes, index):
    rng = np.random.default_rng(1)
    for place in rng.choice(len(keyframes), 6, replace=False).tolist():
        view = view_of(rng, keyframes[place])
        votes = compare_all(view, keyframes)
        found, words = index.query(view, 5)
        assert found[0] == votes.argmax() == place
        assert 3 <= words[0] <= votes[place]
        assert (words[1:] < words[0] / 2).all()


def test_a_word_counts_the_less_the_more_keyframes_show_it(keyframes):
    rng = np.random.default_rng(2)
    common, rare = descriptors(rng, 50), descriptors(rng, 10)
    index = filled([np.concatenate([one[:50], common]) for one in keyframes[:40]])
    index.add(40, np.concatenate([keyframes[40][:50], rare]))
    found, words = index.query(np.concatenate([common, rare]), 41)
    assert found[0] == 40
    assert words[0] == pytest.approx(10)
    assert len(words) == 1 or words[1] < 0.05 * 50


def test_what_is_in_the_index_decides_and_not_how_it_came_there(keyframes):
    rng = np.random.default_rng(3)
    index = PlaceIndex()
    for number in rng.permutation(60).tolist():
        index.add(number, np.concatenate([keyframes[number], keyframes[number // 2]]))  # words in common
    for number in range(0, 60, 3):
        index.drop(number)
    for number in range(0, 60, 6):
        index.add(number, keyframes[number + 80])
    again = PlaceIndex()
    for number in range(60):
        if number % 6 == 0:
            again.add(number, keyframes[number + 80])
        elif number % 3:
            again.add(number, np.concatenate([keyframes[number // 2], keyframes[number]]))
    assert index.numbers.tolist() == again.numbers.tolist()
    for place in (0, 7, 31, 86):
        assert same_answer(index, again, view_of(rng, keyframes[place]))


def test_an_index_that_forgets_as_much_as_it_learns_does_not_grow(keyframes):
    index = filled(keyframes[:50])
    sizes = []
    for turn in range(6):
        for number in range(50):
            index.drop(number)
            index.add(number, keyframes[(50 * turn + number) % 150])
        sizes.append(index.nbytes)
    assert sizes[-1] <= 1.2 * sizes[1]


def test_a_query_looks_at_few_words(keyframes, index):
    """Each of a view's keys has a list of about one word in 65 536: 2 400 words here, of 24 million pairs."""
    view = view_of(np.random.default_rng(4), keyframes[17])
    keys = index._keys_of(view).astype(np.int64)
    lists = (np.arange(keys.shape[1]) << 16) | (keys & 0xFFFF)
    looked_at, in_all = int(index._used[lists].sum()), len(view) * COUNT * len(keyframes)
    assert SHARED < looked_at < in_all / 1000


def test_a_keyframe_takes_a_stated_amount_of_memory(index):
    lists = 4 * 65536 * (8 + 4 + 1)  # where each begins, how long it is, its size
    assert (index.nbytes - lists) / 150 / COUNT < 200  # bytes for a descriptor; 20 at least: its bits and its keys
    assert (index.nbytes - lists) / 150 / COUNT > 20


def test_an_index_of_nothing_finds_nothing(keyframes):
    index = PlaceIndex()
    assert index.query(keyframes[0], 5)[0].size == 0
    index.add(3, keyframes[0][:0])
    assert index.query(keyframes[0], 5)[0].size == 0
    assert index.query(keyframes[0][:0], 5)[0].size == 0
    without = PlaceIndex()
    without.add(0, np.zeros((5, 0), np.uint64))
    assert without.query(np.zeros((5, 0), np.uint64), 5)[0].size == 0


def test_what_does_not_fit_is_refused(keyframes):
    index = filled(keyframes[:2])
    with pytest.raises(InputError, match="keyframe 1 is added"):
        index.add(1, keyframes[3])
    with pytest.raises(InputError, match="keyframe -1 is added"):
        index.add(-1, keyframes[3])
    with pytest.raises(InputError, match="keyframe 2 is dropped"):
        index.drop(2)
    with pytest.raises(InputError, match="8 x 64 bits, expected 4 x 64"):
        index.query(np.zeros((5, 8), np.uint64), 1)


def test_the_index_of_a_map_is_that_of_what_the_map_holds_now():
    """After keyframes and landmarks were culled, merged and adjusted, it finds what a new one finds."""
    sequence = corridor(8.0)
    order = [*range(16), *range(15, -1, -1)]
    tracking = Tracking(window=4, map=MapSettings(cull_every=3))
    odometry = StereoOdometry(RIG, detector=DETECTOR, tracking=tracking)
    index, asked = MapIndex(odometry.map), 0
    for n, k in enumerate(order):
        pair = sequence[k]
        odometry.process(type(pair)(pair.left, pair.right, pair.rig, stamp=float(n), index=n))
        frame = odometry.map.keyframes[-1]
        view, fresh = odometry.map.descriptors[frame.landmark], MapIndex(odometry.map)
        assert same_answer(index, fresh, view)
        assert np.array_equal(index.poses, [frame.T_world_camera for frame in odometry.map.keyframes])
        asked += len(fresh.query(view, 5)[0])
    assert asked > 10
