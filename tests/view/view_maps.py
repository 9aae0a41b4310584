"""Small maps for the tests of the pictures: a wall, a room, and odd ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tspslam import Response, Rig, Surface
from tspslam.topological_map import Levels, Observations, TopologicalMap
from tspslam.topology.complex import build_complex
from tspslam.types import Signals

RIG = Rig(fx=80, fy=80, cx=45, cy=30, baseline=0.3, width=90, height=60)
SQUARE = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def sheet(corner, along, down, side: int):
    """A grid of vertices and faces over a parallelogram; normals look along ``cross(along, down)`` reversed."""
    a, b = (x.ravel() for x in np.meshgrid(np.linspace(0, 1, side), np.linspace(0, 1, side)))
    xyz = np.asarray(corner) + a[:, None] * np.asarray(along) + b[:, None] * np.asarray(down)
    first = np.array([r * side + c for r in range(side - 1) for c in range(side - 1)])
    quads = np.stack([first, first + side, first + side + 1, first + 1], axis=1)
    return xyz, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def map_of(sheets, cameras) -> TopologicalMap:
    """A map of sheets, each a part of its own, with its keyframes at (K, 3) places, all looking along z."""
    starts = np.cumsum([0, *(len(xyz) for xyz, _ in sheets)])
    xyz = np.concatenate([xyz for xyz, _ in sheets])
    faces = np.concatenate([rows + start for (_, rows), start in zip(sheets, starts, strict=False)]).astype(np.int32)
    complex_ = build_complex(faces, len(xyz))
    T = np.tile(np.eye(4), (len(cameras), 1, 1))
    T[:, :3, 3] = cameras
    levels = [xyz, xyz[complex_.edges].mean(axis=1), xyz[faces].mean(axis=1)]
    values = [0.5 + 0.4 * np.sin(places.sum(axis=1)) for places in levels]
    n, K = len(xyz), len(cameras)
    ok = [np.ones(len(x), bool) for x in values]
    counts = Levels(*(np.full(len(x), K, np.int32) for x in values))
    return TopologicalMap(
        xyz=xyz, covariance=np.zeros((n, 3, 3)), surface=Surface(faces), complex_=complex_,
        signals=Signals(
            *values, *(np.zeros((len(x), 2)) for x in values[1:]), *(np.ones(len(x), np.int32) for x in values[1:]), *ok
        ),
        view_count=counts, view_variance=Levels(*(0.01 * x for x in values)),
        best_view=Levels(*(np.zeros(len(x), np.int32) for x in values)), response_view=np.zeros(n, np.int32),
        response=Response(np.exp(1j * np.arange(n)) * (1 + np.arange(n) % 7), 1, np.ones(n, bool)),
        direction=np.tile([1.0, 0.0, 0.0], (n, 1)), direction_spread=np.full(n, 0.1),
        direction_count=np.full(n, K, np.int32), landmark_id=np.arange(n),
        observations=Observations(
            np.arange(n + 1) * K, np.tile(np.arange(K), n), np.zeros((n * K, 2)), np.ones(n * K), np.ones(n * K)
        ),
        keyframes=np.arange(K) * 5, T_world_camera=T, gain=np.linspace(0.9, 1.1, K), rig=RIG,
    )  # fmt: skip


PATH = np.stack([np.zeros(6), np.zeros(6), np.arange(6) * 0.4], axis=1)


def wall() -> TopologicalMap:
    """A wall 4 m before the start of a path toward it; its luminance grows to the right."""
    return map_of([sheet((-3, -2, 4), (6, 0, 0), (0, 4, 0), 9)], PATH)


def room() -> TopologicalMap:
    """A floor, a ceiling and the wall at the end."""
    floor = sheet((-2, 1.5, 6), (4, 0, 0), (0, 0, -6), 8)
    ceiling = sheet((-2, -1.5, 0), (4, 0, 0), (0, 0, 6), 8)
    return map_of([floor, ceiling, sheet((-2, -1.5, 6), (4, 0, 0), (0, 3, 0), 8)], PATH)


def three_vertices() -> TopologicalMap:
    return map_of([(np.array([[0.0, 0, 3], [0, 1, 3], [1, 1, 3]]), np.array([[0, 1, 2]]))], PATH[:2])


def no_response() -> TopologicalMap:
    map_ = wall()
    n = len(map_)
    return replace(
        map_, response=Response(np.zeros(n, complex), 1, np.zeros(n, bool)), direction=np.zeros((n, 3)),
        direction_count=np.zeros(n, np.int32),
    )  # fmt: skip


def all_marked() -> TopologicalMap:
    map_ = no_response()
    signals = {}
    for name in ("vertex", "edge", "face"):
        value = getattr(map_.signals, name)
        signals |= {name: np.zeros_like(value), f"{name}_ok": np.zeros(len(value), bool)}
    none = Levels(*(np.zeros_like(x) for x in map_.view_count))
    return replace(map_, signals=replace(map_.signals, **signals), view_count=none, view_variance=none)


def colours() -> TopologicalMap:
    map_ = wall()
    three = {x: np.stack([getattr(map_.signals, x)] * 3, axis=1) for x in ("vertex", "edge", "face")}
    z = np.stack([map_.response.z] * 3, axis=1)
    variance = Levels(*(np.stack([x] * 3, axis=1) for x in map_.view_variance))
    return replace(
        map_, signals=replace(map_.signals, **three), response=replace(map_.response, z=z), view_variance=variance
    )


def looking_down() -> TopologicalMap:
    """Over a floor, from a drone."""
    map_ = map_of([sheet((-3, 5, 3), (6, 0, 0), (0, 0, -6), 7)], PATH[:, [2, 1, 0]])
    T = map_.T_world_camera.copy()
    T[:, :3, :3] = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    return replace(map_, T_world_camera=T)


def far_outlier() -> TopologicalMap:
    map_ = room()
    xyz = map_.xyz.copy()
    xyz[-1] *= 1e4
    return replace(map_, xyz=xyz)


ODD_MAPS: dict[str, Callable[[], TopologicalMap]] = {
    "wall": wall,
    "room": room,
    "three vertices": three_vertices,
    "no response": no_response,
    "all marked": all_marked,
    "one keyframe": lambda: map_of([sheet((-3, -2, 4), (6, 0, 0), (0, 4, 0), 5)], PATH[:1]),
    "two parts far apart": lambda: map_of([sheet((x, -2, 4), (3, 0, 0), (0, 4, 0), 4) for x in (-3.0, 200.0)], PATH),
    "behind the viewer": lambda: map_of([sheet((3, -2, -9), (-6, 0, 0), (0, 4, 0), 4)], PATH),
    "no face": lambda: map_of([(np.zeros((0, 3)), np.zeros((0, 3), np.int32))], PATH),
    "a face without area": lambda: map_of([(np.ones((3, 3)), np.array([[0, 1, 2]]))], PATH),
    "a path that stands": lambda: map_of([sheet((-3, -2, 4), (6, 0, 0), (0, 4, 0), 4)], np.zeros((5, 3))),
    "colours": colours,
    "looking down": looking_down,
    "far outlier": far_outlier,
}
