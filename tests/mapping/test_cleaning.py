"""Triangles become a manifold with a border: no edge of three faces, one fan a vertex."""

from collections import Counter

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tspslam.mapping.surface import make_manifold

XYZ = np.random.default_rng(0).uniform(-1, 1, (9, 3))
TRIPLES = st.sets(st.integers(0, 8), min_size=3, max_size=3).map(lambda corners: tuple(sorted(corners)))
BOOK = [(0, 1, k) if k % 2 else (1, 0, k) for k in range(2, 9)]  # seven faces at one edge, wound both ways
BOW = [(0, 1, 2), (0, 3, 4), (0, 4, 5)]  # two fans at one vertex
FAN = [(0, k, k % 8 + 1) for k in range(1, 9)]
DOUBLE = [*FAN, (0, 1, 3), (0, 2, 4)]
CHAIN = [(0, 1, 2), (2, 3, 4), (4, 5, 6), (0, 6, 7)]  # corner to corner around a ring
BALL = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def clean(faces):
    return make_manifold(np.array(faces, np.int32).reshape(-1, 3), XYZ)


def sides(faces):
    return Counter(tuple(sorted(pair)) for a, b, c in np.asarray(faces).tolist() for pair in ((a, b), (b, c), (c, a)))


def fans(faces, vertex):
    """How many fans stand at a vertex: parts of its link."""
    links = [set(face) - {vertex} for face in np.asarray(faces).tolist() if vertex in face]
    count = 0
    while links:
        reached, count, size = links.pop(), count + 1, 0
        while size != len(reached):
            size = len(reached)
            reached = reached.union(*(link for link in links if link & reached))
            links = [link for link in links if not link <= reached]
    return count


def is_wound_alike(faces):
    """Whether no side is gone along twice in one direction."""
    ways = Counter(pair for a, b, c in np.asarray(faces).tolist() for pair in ((a, b), (b, c), (c, a)))
    return max(ways.values(), default=0) <= 1


def is_manifold(faces):
    return (
        is_wound_alike(faces)
        and max(sides(faces).values(), default=0) <= 2
        and all(fans(faces, v) <= 1 for v in range(len(XYZ)))
    )


@given(st.lists(TRIPLES, unique=True, max_size=60))
def test_any_faces_become_a_manifold(faces):
    cleaned = clean(faces)
    assert is_manifold(cleaned)
    assert {tuple(face) for face in cleaned.tolist()} <= set(faces)
    assert len(cleaned) or not faces


@given(st.lists(TRIPLES, unique=True, max_size=60))
def test_to_clean_again_changes_nothing(faces):
    cleaned = clean(faces)
    assert np.array_equal(clean(cleaned), cleaned)


@given(st.permutations(DOUBLE + CHAIN[1:]))
def test_the_order_of_faces_does_not_matter(faces):
    assert np.array_equal(clean(faces), clean(DOUBLE + CHAIN[1:]))


@pytest.mark.parametrize(
    ("faces", "left"),
    [(BOOK, 2), (BOW, 2), (FAN, 8), (CHAIN, 4), (BALL, 4), ([], 0)],
    ids=["book", "bow", "fan", "chain", "ball", "nothing"],
)
def test_a_manifold_stays_and_of_what_is_none_the_most_does(faces, left):
    if faces == CHAIN:
        assert not is_manifold(faces)
        assert is_manifold(clean(faces))
        assert 1 <= len(clean(faces)) < left
    else:
        assert len(clean(faces)) == left


def test_of_a_book_the_shortest_page_of_each_winding_stays():
    around = np.linalg.norm(XYZ[BOOK] - XYZ[np.roll(BOOK, -1, axis=1)], axis=2).sum(axis=1)
    order = [BOOK[k] for k in np.argsort(around)]
    shortest = {next(face for face in order if face[:2] == way) for way in ((0, 1), (1, 0))}
    assert {tuple(face) for face in clean(BOOK).tolist()} == shortest


def test_what_is_left_turns_one_way():
    """A Möbius strip of five faces is cut."""
    strip = [(0, 1, 2), (1, 3, 2), (2, 3, 4), (3, 0, 4), (4, 0, 1)]
    assert not is_wound_alike(strip)
    assert is_wound_alike(clean(strip))
    assert len(clean(strip)) >= 3


def test_winding_stays():
    turned = [face[::-1] for face in FAN]
    assert {tuple(face) for face in clean(turned).tolist()} == set(turned)
