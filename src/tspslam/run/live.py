"""The map while a session goes on: what is around the last keyframes is made anew, the rest follows its landmarks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._checks import require
from ..errors import GeometryError, InputError
from ..mapping.averaging import DARKEST
from ..mapping.settings import MappingSettings
from ..mapping.surface import make_manifold
from ..session import Session
from ..topological_map import Levels, Observations, TopologicalMap
from ..topology.complex import Complex, build_complex
from ..types import FloatArray, Response, Signals, Surface
from ..vision.slam.keyframes.keyframe import MapSnapshot
from ..vision.slam.odometry import StereoOdometry
from .map import Keyframes, join_keyframes, kept_keyframes

Pair = tuple[NDArray[np.int64], ...]  # of the old map, of the part made anew
_WINDOW, _OLDER = 8, 4  # keyframes that are mapped anew: the last ones, and older ones that share most landmarks


class LiveMap:
    """The map of a session, brought up to date where it changes.

    Each update makes the surface, the signals and the response around the last keyframes anew, also where older
    keyframes saw the same landmarks: at a cost that is bounded. Joining that to the rest, whose vertices go where the
    session's landmarks have moved, costs about 8 µs a vertex of the whole. `tspslam.build_map` makes all of it at once,
    at a cost that grows with the path: the final map.

    Parameters
    ----------
    session : Session
        Which keeps its keyframes, with the odometry of its own images: others have no landmarks that stay.
    mapping : MappingSettings, optional
        How; as in the session's settings by default.

    Attributes
    ----------
    map : TopologicalMap or None
        As of the last update; None before the first two keyframes.

    Raises
    ------
    InputError
        If the session's poses come from elsewhere.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> sequence = synthetic.SyntheticSequence(synthetic.corridor(3.0))
    >>> with Session(sequence.rig) as session:
    ...     live = LiveMap(session)
    ...     for pair in sequence:
    ...         if session.process(pair).is_keyframe:
    ...             _ = live.update()
    >>> live.map.landmark_id.dtype, bool(live.map.defined.any())
    (dtype('int64'), True)
    """

    def __init__(self, session: Session, mapping: MappingSettings | None = None) -> None:
        require(session, Session, "session")
        if not isinstance(session.odometry, StereoOdometry):
            raise InputError(
                "live map: the session's poses come from elsewhere, expected StereoOdometry: build_map takes both"
            )
        if mapping is not None:
            require(mapping, MappingSettings, "mapping")
        self.map: TopologicalMap | None = None
        self._session, self._mapping = session, mapping

    def update(self) -> TopologicalMap | None:
        """Take in the keyframes since the last update; call it after each, or now and then.

        Returns
        -------
        TopologicalMap or None
            The map so far; None before the first two keyframes.

        Raises
        ------
        InputError
            If the session has kept no keyframe.
        """
        given = kept_keyframes(self._session)
        chosen = _around_the_last(given.snapshot)
        near = replace(given, index={n: i for n, i in given.index.items() if n in chosen})
        try:
            local = join_keyframes(near, self._session.settings, self._mapping) if len(chosen) > 1 else None
        except GeometryError:  # these keyframes span no surface: the map stays as it is
            local = None
        if local is not None:
            self.map = local if self.map is None else _join(self.map, local, given)
        return self.map


def _around_the_last(snapshot: MapSnapshot) -> set[int]:
    """The last keyframes, and older ones that share most landmarks with them."""
    numbers, count = snapshot.keyframe, len(snapshot.keyframe)
    keyframe = np.repeat(np.arange(count), np.diff(snapshot.start))
    is_last = keyframe >= count - _WINDOW
    is_shared = np.isin(snapshot.observed_id, snapshot.observed_id[is_last]) & ~is_last
    shared = np.bincount(keyframe[is_shared], minlength=count)
    older = np.argsort(-shared, kind="stable")[:_OLDER]
    return {*numbers[max(count - _WINDOW, 0) :].tolist(), *numbers[older[shared[older] > 0]].tolist()}


def _join(old: TopologicalMap, local: TopologicalMap, given: Keyframes) -> TopologicalMap:
    """The map with a part made anew; what is left of the old one stands where its landmarks are now."""
    snapshot, ids = given.snapshot, _follow_merges(old.landmark_id, given.snapshot.merged)
    is_known, is_anew = np.isin(ids, snapshot.landmark_id), np.isin(ids, _observed(snapshot, local, given))
    triples = old.surface.faces
    kept = ids[triples[is_known[triples].all(axis=1) & ~is_anew[triples].all(axis=1)]]
    faces = np.concatenate([local.landmark_id[local.surface.faces], kept])
    faces = faces[_distinct(faces)]
    every, rows = np.unique(faces, return_inverse=True)
    xyz = snapshot.xyz[np.searchsorted(snapshot.landmark_id, every)]
    here = np.isin(local.landmark_id, every)
    xyz[np.searchsorted(every, local.landmark_id[here])] = local.xyz[here]
    return _Union(old, local, ids, every, given).fill(make_manifold(rows.reshape(-1, 3).astype(np.int32), xyz), xyz)


def _follow_merges(ids: NDArray[np.int64], merged: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of landmarks as they are called now."""
    now: dict[int, int] = {}
    for gone, kept in merged[::-1].tolist():
        now[gone] = now.get(kept, kept)
    return np.array([now.get(each, each) for each in ids.tolist()], np.int64)


def _observed(snapshot: MapSnapshot, local: TopologicalMap, given: Keyframes) -> NDArray[np.int64]:
    """Landmarks that two keyframes of a part see: what becomes of them there counts."""
    index = np.array([given.index.get(number, -1) for number in snapshot.keyframe.tolist()])
    rows = np.repeat(np.isin(index, local.keyframes), np.diff(snapshot.start))
    ids, times = np.unique(snapshot.observed_id[rows], return_counts=True)
    return np.union1d(ids[times > 1], local.landmark_id)


def _distinct(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first of faces of the same three vertices; none that has one twice."""
    ascending = np.sort(faces, axis=1)
    _, first = np.unique(ascending, axis=0, return_index=True)
    return np.sort(first[(np.diff(ascending[first], axis=1) > 0).all(axis=1)])


class _Union:
    """Arrays of two maps put on the elements of one: those of the part made anew come first."""

    def __init__(
        self, old: TopologicalMap, local: TopologicalMap, ids: NDArray[np.int64], every: NDArray[np.int64],
        given: Keyframes,
    ) -> None:  # fmt: skip
        self.old, self.local, self.every, self.given = old, local, every, given
        self.rows = tuple(_places(every, these) for these in (ids, local.landmark_id))
        self.scale = _common_exposure(old, local, *self.rows)

    def fill(self, faces: NDArray[np.int32], xyz: FloatArray) -> TopologicalMap:
        """The map on these faces."""
        used = np.unique(faces)
        new = np.full(len(self.every), -1)
        new[used] = np.arange(len(used))
        self.rows = tuple(np.where(rows >= 0, new[rows], -1) for rows in self.rows)
        faces = new[faces].astype(np.int32)
        faces = faces[np.lexsort(np.sort(faces, axis=1).T[::-1])]
        complex_ = build_complex(faces, len(used))
        at = {"vertex": self.rows, "edge": self._edges(complex_), "face": self._faces(complex_)}
        sizes = {"vertex": complex_.n, "edge": len(complex_.edges), "face": len(complex_.faces)}

        keyframes = np.union1d(self.old.keyframes, self.local.keyframes)
        self.old, self.local = (_with_views_of(one, keyframes) for one in (self.old, self.local))

        def carry(level: str, name: str, power: int = 0) -> NDArray[Any]:
            old, local = map(attrgetter(name), (self.old, self.local))
            return _carried(old, local * self.scale**power if power else local, at[level], sizes[level])

        def level(name: str, power: int = 0) -> Levels:
            return Levels(*(carry(each, f"{name}.{each}", power) for each in Levels._fields))

        def field(name: str) -> NDArray[Any]:
            return carry(name.split("_")[0], f"signals.{name}", int(name in Levels._fields))

        def vertex(name: str) -> NDArray[Any]:
            return carry("vertex", name)

        return TopologicalMap(
            xyz=xyz[used], covariance=vertex("covariance"), surface=Surface(faces), complex_=complex_,
            signals=Signals(**{each.name: field(each.name) for each in fields(Signals)}),
            view_count=level("view_count"), view_variance=level("view_variance", 2),
            best_view=level("best_view"), response_view=vertex("response_view"),
            response=Response(vertex("response.z"), self.local.response.order, vertex("response.defined")),
            direction=vertex("direction"), direction_spread=vertex("direction_spread"),
            direction_count=vertex("direction_count"), landmark_id=self.every[used],
            observations=self._observations(keyframes, complex_.n), keyframes=keyframes,
            T_world_camera=self._poses(keyframes), gain=self._gains(keyframes), rig=self.local.rig,
        )  # fmt: skip

    def _edges(self, complex_: Complex) -> Pair:
        """Edge of the union that each edge of the two maps is, -1 for none."""
        n = complex_.n
        known = complex_.edges @ np.array([n, 1], np.int64)
        return self._match(known, [_keys(rows[one.complex_.edges], n) for rows, one in self._each()])

    def _faces(self, complex_: Complex) -> Pair:
        """Face of the union that each face of the two maps is, -1 for none."""
        n = complex_.n
        known = _keys(complex_.faces, n)
        order = np.argsort(known, kind="stable")
        found = self._match(known[order], [_keys(rows[one.complex_.faces], n) for rows, one in self._each()])
        return tuple(np.where(at >= 0, order[at], -1) for at in found)

    def _each(self) -> Iterable[tuple[NDArray[np.int64], TopologicalMap]]:
        return zip(self.rows, (self.old, self.local), strict=True)

    @staticmethod
    def _match(known: NDArray[np.integer], several: Iterable[NDArray[np.int64]]) -> Pair:
        return tuple(_places(known, keys) for keys in several)

    def _observations(self, keyframes: NDArray[np.int64], n: int) -> Observations:
        """Those of the part made anew, and of the old map's other vertices."""
        is_new = np.zeros(n, np.bool_)
        is_new[self.rows[1][self.rows[1] >= 0]] = True
        parts = []
        for rows, one in self._each():
            seen, vertex = one.observations, rows[one.observations.vertex]
            good = (vertex >= 0) & ((one is self.local) | ~is_new[vertex])
            frame = np.searchsorted(keyframes, one.keyframes)[seen.keyframe[good]]
            parts.append((vertex[good], frame, seen.uv[good], seen.disparity[good], seen.weight[good]))
        vertex, frame, uv, disparity, weight = map(np.concatenate, zip(*parts, strict=True))
        order = np.lexsort((frame, vertex))
        order = order[np.diff(vertex[order] * len(keyframes) + frame[order], prepend=-1) != 0]
        start = np.searchsorted(vertex[order], np.arange(n + 1))
        return Observations(start, frame[order], uv[order], disparity[order], weight[order])

    def _poses(self, keyframes: NDArray[np.int64]) -> FloatArray:
        """Where the keyframes are now; those that the session let go stay."""
        snapshot = self.given.snapshot
        now = {
            self.given.index.get(k, -1): T
            for k, T in zip(snapshot.keyframe.tolist(), snapshot.T_world_camera, strict=True)
        }
        before = dict(zip(self.old.keyframes.tolist(), self.old.T_world_camera, strict=True))
        return np.array([now.get(k, before.get(k)) for k in keyframes.tolist()])

    def _gains(self, keyframes: NDArray[np.int64]) -> FloatArray:
        """Those of the part made anew, brought to the old map's luminance, and the old ones."""
        known = dict(zip(self.old.keyframes.tolist(), self.old.gain.tolist(), strict=True))
        known |= dict(zip(self.local.keyframes.tolist(), (self.local.gain * self.scale).tolist(), strict=True))
        return np.array([known[k] for k in keyframes.tolist()])


def _keys(rows: NDArray[Any], n: int) -> NDArray[np.int64]:
    """One number for the vertices of each edge or face, whatever their order; -1 where one of them is not there."""
    ascending = np.sort(rows.astype(np.int64), axis=1)
    keys = ascending[:, 0]
    for column in ascending.T[1:]:
        keys = keys * n + column
    return np.where(ascending[:, 0] >= 0, keys, -1)


def _places(known: NDArray[np.integer], wanted: NDArray[np.integer]) -> NDArray[np.int64]:
    """Where each of `wanted` is in `known`, which ascends; -1 where it is not."""
    at = np.minimum(np.searchsorted(known, wanted), len(known) - 1)
    return np.where(known[at] == wanted, at, -1)


def _with_views_of(one: TopologicalMap, keyframes: NDArray[np.int64]) -> TopologicalMap:
    """A map whose best views are rows of other keyframes, all of its own among them."""
    rows = np.append(np.searchsorted(keyframes, one.keyframes), -1).astype(np.int32)  # row -1 stays
    return replace(
        one, best_view=Levels(*(rows[best] for best in one.best_view)), response_view=rows[one.response_view]
    )


def _carried(old: NDArray[Any], local: NDArray[Any], at: Pair, size: int) -> NDArray[Any]:
    """Values of two maps on the elements of their union, those of the second first."""
    values = np.zeros((size, *old.shape[1:]), old.dtype)
    for rows, given in zip(at, (old, local), strict=True):
        values[rows[rows >= 0]] = given[rows >= 0]
    return values


def _common_exposure(
    old: TopologicalMap, local: TopologicalMap, rows: NDArray[np.int64], others: NDArray[np.int64]
) -> float:
    """Luminance of the old map over that of the new part, where both have vertices."""
    both = np.intersect1d(rows[old.signals.vertex_ok & (rows >= 0)], others[local.signals.vertex_ok & (others >= 0)])
    values = []
    for one, at in ((old, rows), (local, others)):
        order = np.argsort(at, kind="stable")
        values.append(one.signals.vertex[order[np.searchsorted(at[order], both)]])
    bright = values[1] > DARKEST
    return float(np.median(values[0][bright] / values[1][bright])) if bright.any() else 1.0
