"""Keyframes of several maps that may show the same place: each asks once, and is tried at few, however many there are."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam.vision.slam.places.candidates import find_candidates
from tspslam.vision.slam.places.settings import LoopSettings

LOOPS = LoopSettings()
WORDS = 30  # of each keyframe


def maps(count, keyframes=8, seed=0):
    """Maps that have nothing in common."""
    rng = np.random.default_rng(seed)
    return [[rng.integers(0, 2**63, (WORDS, 4), dtype=np.uint64) for _ in range(keyframes)] for _ in range(count)]


def show_same(one, other, words):
    """Have a keyframe show some words of another, each a few bits off."""
    other[:words] = one[:words] ^ np.uint64(0b1001)


def pairs_of(found, i, j):
    return found[(found[:, 0] == i) & (found[:, 2] == j)][:, [1, 3]].tolist()


def test_what_looks_alike_is_tried_first_then_beside_it_then_the_ends():
    one, other = maps(2)
    show_same(one[3], other[5], 20)
    show_same(one[6], other[5], 5)
    tried = pairs_of(find_candidates([one, other], LOOPS), 0, 1)
    assert [place for place, keyframe in tried if keyframe == 5] == [3, 6]
    assert {(place, keyframe) for place, keyframe in tried} == {
        (place, keyframe) for place in (3, 6) for keyframe in (4, 5, 6)
    } | {(0, 0), (7, 0), (0, 7), (7, 7)}


def test_candidates_are_the_same_whichever_map_comes_first():
    one, other = maps(2)
    for k in range(2, 6):
        show_same(one[k], other[k - 1], 10)
    there, back = (find_candidates(given, LOOPS) for given in ([one, other], [other, one]))
    alike = {(k, k - 1) for k in range(2, 6)}
    assert alike <= {(a, b) for a, b in pairs_of(there, 0, 1)}
    assert alike <= {(b, a) for a, b in pairs_of(back, 0, 1)}


def test_a_word_in_common_is_enough_where_nothing_else_leads_to_a_map():
    given = maps(4)
    show_same(given[0][4], given[3][2], 1)
    assert [4, 2] in pairs_of(find_candidates(given, LOOPS), 0, 3)


@pytest.mark.parametrize("count", [4, 12])
def test_candidates_grow_with_the_maps_and_not_with_their_pairs(count):
    """All maps show one place: each keyframe is tried at as many places as the settings say, in turns of the maps."""
    given = maps(count)
    for views in given[1:]:
        for k in range(8):
            show_same(given[0][k], views[k], 20)
    settings = replace(LOOPS, min_words=WORDS + 1.0)  # nobody beside is tried
    found = find_candidates(given, settings)
    ends = {(0, 0), (0, 7), (7, 0), (7, 7)}
    inner = [row for row in found.tolist() if (row[1], row[3]) not in ends]
    tried = np.unique([row[2:] for row in inner], axis=0, return_counts=True)[1]
    assert tried.max() <= settings.lost_candidates
    partners = {tuple(row) for row in found[:, [0, 2]].tolist()}
    assert {(k, k + 1) for k in range(count - 1)} <= partners
    reached = {0}
    for _ in range(count):
        reached |= {b for a, b in partners if a in reached} | {a for a, b in partners if b in reached}
    assert reached == set(range(count))


@pytest.mark.parametrize("count", [4, 12, 24])
def test_only_the_tries_of_ends_grow_with_the_maps_that_are_compared(count):
    """All maps show one place and are sure of it: so are the keyframes beside each."""
    given = maps(count)
    for views in given[1:]:
        for k in range(8):
            show_same(given[0][k], views[k], 20)
    found = find_candidates(given, LOOPS)
    keyframes, tried = np.unique(found[:, 2:], axis=0, return_counts=True)
    is_end = np.isin(keyframes[:, 1], [0, 7])
    assert LOOPS.lost_candidates < tried[~is_end].max() <= 3 * LOOPS.lost_candidates
    compared = len(np.unique(found[:, [0, 2]], axis=0))
    assert len(found) <= 3 * LOOPS.lost_candidates * len(keyframes) + 4 * compared


def test_maps_that_share_nothing_are_compared_at_their_ends_alone_where_they_follow_each_other():
    found = find_candidates(maps(5, keyframes=3), LOOPS)
    assert {tuple(row) for row in found[:, [0, 2]].tolist()} == {(k, k + 1) for k in range(4)}
    assert pairs_of(found, 2, 3) == [[0, 0], [2, 0], [0, 2], [2, 2]]


def test_maps_that_are_sure_of_none_are_compared_with_those_that_share_most():
    given, words = maps(4), {(0, 1): 9, (2, 3): 9, (0, 2): 8, (1, 3): 8, (0, 3): 1, (1, 2): 1}
    for (one, other), count in words.items():
        show_same(given[one][other], given[other][one], count)
    few = replace(LOOPS, lost_candidates=2, min_words=WORDS + 1.0)
    compared = {tuple(row) for row in find_candidates(given, few)[:, [0, 2]].tolist()}
    assert compared == words.keys() - {(0, 3)}
    assert len(pairs_of(find_candidates(given, few), 1, 2)) == 4  # their ends, as they follow each other
    sure = replace(few, min_words=0.5)
    assert {tuple(row) for row in find_candidates(given, sure)[:, [0, 2]].tolist()} == words.keys()


def test_one_keyframe_and_no_words_are_maps_too():
    one, empty = maps(1, keyframes=1)[0], [np.empty((0, 4), np.uint64)]
    assert find_candidates([one, empty], LOOPS).tolist() == [[0, 0, 1, 0]]


def test_a_candidate_that_either_map_names_counts_once():
    one, other = maps(2)
    show_same(one[3], other[5], 20)
    found = find_candidates([one, other], LOOPS)
    assert len(np.unique(found, axis=0)) == len(found)
    assert np.array_equal(found[:, 2:], found[np.lexsort((found[:, 3], found[:, 2]))][:, 2:])
