"""Construction in buckets and by two threads: neither may change a bit; beside a plain NumPy truth."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from tspslam import build_complex, sample_signals, set_threads, tmahf
from tspslam.topology import _construction, _locality, complex

from .scenes import noise


def truth(faces, n, extra):
    """Edges, faces, their edges, and the rows around each vertex, by sets and sorts."""
    seen, kept = set(), []
    for face in np.sort(np.reshape(faces, (-1, 3)), axis=1).tolist():
        if tuple(face) not in seen:
            kept.append(face)
        seen.add(tuple(face))
    sides = [[(i, j), (j, k), (i, k)] for i, j, k in kept]
    edges = sorted({side for each in sides for side in each} | {tuple(sorted(pair)) for pair in extra})
    number = {edge: e for e, edge in enumerate(edges)}
    face_edges = [[number[side] for side in each] for each in sides]
    with_face = {e for each in face_edges for e in each}
    rows = []
    for v in range(n):
        at = [e for e, edge in enumerate(edges) if v in edge]
        mine = [f for f, face in enumerate(kept) if v in face]
        opposite = [number[tuple(x for x in kept[f] if x != v)] for f in mine]
        around = [sum(edges[e]) - v for e in at]
        rows.append((around, [e for e in at if e in with_face] + opposite, mine))
    return edges, kept, face_edges, rows


def is_true(complex_, expected):
    edges, faces, face_edges, rows = expected
    levels = (complex_.vertex_rows, complex_.edge_rows, complex_.face_rows)
    split = [[np.split(level.indices, level.indptr[1:-1])[v].tolist() for level in levels] for v in range(complex_.n)]
    given_ = complex_.edges.tolist(), complex_.faces.tolist(), complex_.face_edges.tolist(), split
    return given_ == ([*map(list, edges)], faces, face_edges, [*map(list, rows)])


@st.composite
def inputs(draw):
    n = draw(st.integers(3, 14))
    triple = st.lists(st.integers(0, n - 1), min_size=3, max_size=3, unique=True)
    pair = st.lists(st.integers(0, n - 1), min_size=2, max_size=2, unique=True)
    return draw(st.lists(triple, max_size=24)), n, draw(st.lists(pair, max_size=6))


@given(inputs(), st.integers(0, 4), st.sampled_from([0, 3, 10**9]))
@settings(max_examples=80, deadline=None)
def test_buckets_of_any_size_and_parts_of_any_number_give_the_sorted_sides_and_rows(given_, shift, few):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_construction, "_SHIFT", shift)
        patch.setattr(_construction, "FEW", few)
        assert is_true(build_complex(*given_), truth(*given_))


def test_more_sides_at_a_vertex_than_are_sorted_by_insertion_are_sorted_too():
    spokes = np.random.default_rng(0).permutation(np.arange(1, 200))
    fan = np.stack([np.zeros(198, int), spokes[:-1], spokes[1:]], axis=1)
    assert is_true(build_complex(fan, 200), truth(fan, 200, []))


def test_a_complex_that_is_not_built_from_faces_finds_which_edges_have_one():
    built = build_complex([[0, 1, 2]], 5, edges=[[3, 4]])
    assert built.has_face.tolist() == [True, True, True, False]
    bare = complex.Complex(built.n, built.edges, built.faces, built.face_edges)
    assert all(np.array_equal(a, b) for a, b in zip(bare.stars, built.stars, strict=True))


def stage(uv, faces, image):
    """All that the stage gives, as arrays by name."""
    complex_ = build_complex(faces, len(uv))
    signals = sample_signals(image, uv, complex_)
    response = tmahf(complex_, uv, signals)
    arrays = {"edges": complex_.edges, "face_edges": complex_.face_edges, "z": response.z, "defined": response.defined}
    arrays |= {f"{k}": each for k, each in enumerate((*complex_.stars, *(m.indices for m in complex_.neighbours())))}
    return arrays | {field.name: getattr(signals, field.name) for field in fields(signals)}


@pytest.fixture
def everything_is_large(monkeypatch):
    """Two threads, small buckets and visits place by place for a mesh of any size."""
    monkeypatch.setattr(_locality, "FEW", 10)
    monkeypatch.setattr(_construction, "FEW", 10)
    monkeypatch.setattr(_construction, "_SHIFT", 4)


def mesh(n=700):
    uv = np.random.default_rng(3).random((n, 2)) * (59, 39)
    return uv, Delaunay(uv).simplices.astype(np.int32)


def test_any_number_of_threads_gives_the_same_bytes(everything_is_large):
    (uv, faces), found = mesh(), []
    for count in (1, 2, 3):
        set_threads(count)
        try:
            found.append(stage(uv, faces, noise()))
        finally:
            set_threads(None)
    for other in found[1:]:
        assert {name: each.tobytes() for name, each in other.items()} == {
            name: each.tobytes() for name, each in found[0].items()
        }


def test_place_by_place_gives_the_same_bytes_as_in_turn(request):
    uv, faces = mesh()
    plain = stage(uv, faces, noise())
    request.getfixturevalue("everything_is_large")
    local = stage(uv, faces, noise())
    assert all(np.array_equal(plain[name], local[name]) for name in plain)


def test_permuting_the_vertices_permutes_what_the_stage_gives(everything_is_large):
    uv, faces = mesh()
    new = np.random.default_rng(4).permutation(len(uv))
    moved_uv = np.empty_like(uv)
    moved_uv[new] = uv
    one, other = stage(uv, faces, noise()), stage(moved_uv, new[faces].astype(np.int32), noise())
    assert np.array_equal(one["vertex"], other["vertex"][new])
    assert np.array_equal(one["face_pixels"], other["face_pixels"])
    assert np.allclose(one["face"], other["face"], rtol=0, atol=1e-12)
    assert np.array_equal(one["defined"], other["defined"][new])
    assert np.allclose(one["z"], other["z"][new], rtol=0, atol=1e-12)
    number = {tuple(edge): e for e, edge in enumerate(other["edges"].tolist())}
    to = [number[tuple(edge)] for edge in np.sort(new[one["edges"]], axis=1).tolist()]
    assert np.allclose(one["edge"], other["edge"][to], rtol=0, atol=1e-12)


def test_the_first_element_that_is_not_finite_is_named_whatever_the_number_of_threads(everything_is_large):
    from dataclasses import replace

    from tspslam import InputError

    uv, faces = mesh()
    complex_ = build_complex(faces, len(uv))
    signals = sample_signals(noise(), uv, complex_)
    edge, face = signals.edge.copy(), signals.face.copy()
    edge[7], face[3] = np.nan, np.nan
    with pytest.raises(InputError, match="edge 7 has a signal, but its value"):
        tmahf(complex_, uv, replace(signals, edge=edge, face=face))
