"""A large complex is visited place by place; nothing but the time may depend on it."""

from dataclasses import fields

import numpy as np
import pytest

from tspslam import build_complex, sample_signals, tmahf
from tspslam.topology import _locality

from .scenes import noise, scattered


@pytest.mark.parametrize("spoil", [
    lambda uv: uv, lambda uv: np.full_like(uv, np.nan), lambda uv: np.full_like(uv, 7.5), lambda uv: uv * [1, 0],
    lambda uv: uv * 1e300, lambda uv: -uv * 1e300, lambda uv: np.where(uv[:, :1] < 20, np.nan, uv),
    lambda uv: np.where(uv[:, :1] < 20, np.inf, uv),
], ids=["as is", "no place", "one place", "one row", "far", "far back", "some missing", "some infinite"])  # fmt: skip
def test_the_order_of_the_visit_changes_no_bit(monkeypatch, spoil):
    uv, complex_ = scattered(n=500)
    uv = spoil(uv)
    results = []
    for few in (10**9, 10):
        monkeypatch.setattr(_locality, "FEW", few)
        signals = sample_signals(noise(), uv, complex_)
        results.append((signals, tmahf(complex_, uv, signals)))
    (near_signals, near), (far_signals, far) = results
    for field in fields(near_signals):
        assert np.array_equal(getattr(near_signals, field.name), getattr(far_signals, field.name))
    assert np.array_equal(near.z, far.z)
    assert np.array_equal(near.defined, far.defined)


def test_every_element_is_visited_once(monkeypatch):
    monkeypatch.setattr(_locality, "FEW", 10)
    uv, complex_ = scattered(n=500)
    _, *visits = _locality.visits(uv, complex_.edges.view(np.uint32)[:, 0], complex_.faces.view(np.uint32)[:, 0])
    for visit, count in zip(visits, (500, len(complex_.edges), len(complex_.faces)), strict=True):
        assert np.array_equal(np.sort(visit), np.arange(count))


def test_vertices_without_elements_are_visited_too(monkeypatch):
    monkeypatch.setattr(_locality, "FEW", 10)
    empty = build_complex([], 100)
    signals = sample_signals(noise(), np.zeros((100, 2)), empty)
    assert tmahf(empty, np.zeros((100, 2)), signals, order=0).defined.all()


def test_the_order_taken_for_the_signals_is_taken_for_the_filter_and_changes_no_bit(monkeypatch):
    uv, complex_ = scattered(n=500)
    fresh = build_complex(complex_.faces, complex_.n)
    monkeypatch.setattr(_locality, "FEW", 10)
    signals = sample_signals(noise(), uv, complex_)
    far, visit = _locality.visit_vertices(vars(complex_), uv)
    assert far
    assert np.array_equal(visit, _locality.visits(uv)[1])
    sample_signals(noise(), uv[::-1], complex_)  # of another view: the order is another, the response is not
    assert np.array_equal(tmahf(complex_, uv, signals).z, tmahf(fresh, uv, signals).z)
