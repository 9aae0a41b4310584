"""What a page shows in space, packed small: places in 16 bits, one byte a value and layer, all in base64."""

from __future__ import annotations

import base64
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief, brief
from ..errors import InputError
from ..frame import Frame
from ..topological_map import TopologicalMap
from ..types import BoolArray, FloatArray, Rig
from ._frame import CLIP_MARGIN, in_view
from ._layers import BARE, Layer, layers_of_frame, steps_of, table, ticks_of
from ._report_parts import State
from ._thinning import MOST_FACES, Kept, kept
from ._viewpoints import KEPT_PERCENT, downward, is_overhead

STATES: tuple[State, ...] = ("keyframe", "tracked", "weak", "lost", "loop")  # their numbers in scene.js
CEILING_SHARES = (0.05, 0.6)  # of the faces look down: else it is no room, and all is shown at once
MAP_EYE = (-0.85, 1.3, -1.15)  # right, up, forward: behind the start, to its left, high above
FRAME_EYE = (-0.17, 0.11, -0.98)  # behind the camera, to its left, above it
QUANTA = 65_535  # of places along each axis
Others = Sequence[tuple[str, FloatArray]]


class Station(NamedTuple):
    """A frame on the path.

    Attributes
    ----------
    number : int
        Of the frame.
    T_world_camera : (4, 4) float64
        Its pose, m; not finite where it is not known.
    state : {"keyframe", "tracked", "weak", "lost", "loop"}
        How it was tracked; a keyframe that closed a loop is "loop".
    """

    number: int
    T_world_camera: FloatArray
    state: State

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, repr=False)
class Space(Brief):
    """What is there to show.

    Attributes
    ----------
    what : {"map", "mesh", "points"}
        In a word.
    xyz : (N, 3) float64
        Vertices, m.
    faces, edges : (F, 3) int, (E, 2) int
        Between them.
    layers : list of Layer
        Of the whole; those of levels that are not there are left out.
    keep : (N,) bool
        Vertices not far off.
    ceiling : (F,) bool
        Faces that hide a room from above; none where there is no room.
    down, ahead : (3,) float64
        Unit vectors: down, and where the path starts to.
    eye : (float, float, float)
        Where the first view is from: right, up, ahead.
    rig : Rig
        For the shape of the cameras.
    stations : sequence of Station
        The path.
    others : sequence of (words, (T, 3) float64)
        Other paths.
    """

    what: Literal["map", "mesh", "points"]
    xyz: FloatArray
    faces: NDArray[Any]
    edges: NDArray[Any]
    layers: list[Layer]
    keep: BoolArray
    ceiling: BoolArray
    down: FloatArray
    ahead: FloatArray
    eye: tuple[float, float, float]
    rig: Rig
    stations: Sequence[Station]
    others: Others = ()


@dataclass(frozen=True, repr=False)
class Packed(Brief):
    """A scene as a page holds it.

    Attributes
    ----------
    space : Space
        What it was made of.
    kept : Kept
        What is left of it.
    meta : dict
        What each part of `data` is: ``[kind, first byte, count]`` for an array.
    data : bytes
        The arrays, little-endian, each from a multiple of four.
    """

    space: Space
    kept: Kept
    meta: dict[str, Any]
    data: bytes

    def json(self) -> str:
        """All of it, as text that may stand inside a script element."""
        words = json.dumps(self.meta | {"data": base64.b64encode(self.data).decode("ascii")}, separators=(",", ":"))
        return words.replace("<", "\\u003c")


def space_of_map(
    map_: TopologicalMap, layers: list[Layer], stations: Sequence[Station], others: Others
) -> Space | None:
    """Collect what is shown of a map; None if it has no face to show."""
    keep = in_reach(map_.xyz)
    faces = map_.surface.faces
    is_kept = keep[faces].all(axis=1) if len(faces) else np.zeros(0, np.bool_)
    if not is_kept.any():
        return None
    for station in stations:
        _check_station(station)
    for words, places in others:
        if np.ndim(places) != 2 or np.shape(places)[1] != 3:
            raise InputError(f"view: {words} has places of shape {np.shape(places)}, expected (T, 3)")
    if not stations:
        pairs = zip(map_.keyframes.tolist(), map_.T_world_camera, strict=True)
        stations = [Station(number, T, "keyframe") for number, T in pairs]
    ceiling = is_overhead(map_)
    if not CEILING_SHARES[0] < float(ceiling[is_kept].mean()) < CEILING_SHARES[1]:
        ceiling = np.zeros_like(ceiling)
    down = downward(map_)
    return Space(
        "map", map_.xyz, faces, map_.complex_.edges, layers, keep, ceiling, down,
        _level(map_.T_world_camera[0], down), MAP_EYE, map_.rig, stations, others,
    )  # fmt: skip


def space_of_frame(frame: Frame) -> Space | None:
    """Collect what is shown of a frame, with its camera; None if it has no point to show."""
    keep, faces = in_view(frame), frame.complex_.faces
    if not keep.any():
        return None
    has_faces = bool(keep[faces].all(axis=1).any())
    layers = [layer for layer in layers_of_frame(frame) if has_faces or layer.level != "face"]
    xyz = np.where(keep[:, None], frame.cloud.xyz, 0.0)
    down, ahead = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    camera = [Station(frame.index, np.eye(4), "keyframe")]
    return Space(
        "mesh" if has_faces else "points", xyz, faces, frame.complex_.edges, layers, keep,
        np.zeros(len(faces), np.bool_), down, ahead, FRAME_EYE, frame.rig, camera,
    )  # fmt: skip


def in_reach(xyz: FloatArray, known: BoolArray | None = None) -> BoolArray:
    """Mark places, (N,), that are in the range of nearly all known ones, or a quarter of it farther."""
    known = np.ones(len(xyz), np.bool_) if known is None else known
    if not known.any():
        return known
    low, high = np.percentile(xyz[known], KEPT_PERCENT, axis=0)
    margin = CLIP_MARGIN * (high - low) + 1e-9
    return np.asarray(((xyz >= low - margin) & (xyz <= high + margin)).all(axis=1))


def _check_station(station: Station) -> None:
    if station.state not in STATES:
        raise InputError(f"view: frame {station.number} is {station.state!r}, expected one of {', '.join(STATES)}")
    if np.shape(station.T_world_camera) != (4, 4):
        shape = np.shape(station.T_world_camera)
        raise InputError(f"view: the pose of frame {station.number} has shape {shape}, expected (4, 4)")


def _level(T: FloatArray, down: FloatArray) -> FloatArray:
    """Where a camera looks to, across what is down, (3,); of one that looks down, where the top of its image is."""
    ahead: FloatArray = T[:3, 2] - down * (T[:3, 2] @ down)
    if np.linalg.norm(ahead) < 1e-6:
        ahead = np.cross(T[:3, 0], down)
    return ahead / np.linalg.norm(ahead)


@dataclass(frozen=True)
class _Buffer:
    """Arrays one after another."""

    parts: list[bytes] = field(default_factory=list)

    def add(self, values: NDArray[Any], kind: str) -> list[str | int]:
        """Add an array; gives what finds it again."""
        with np.errstate(over="ignore"):  # farther than a float32 can say: infinitely far, and not drawn
            made = np.ascontiguousarray(values, np.dtype(kind).newbyteorder("<")).tobytes()
        at = sum(map(len, self.parts))
        self.parts.append(made + bytes(-len(made) % 4))
        return [kind, at, int(np.size(values))]

    def bits(self, which: BoolArray) -> list[str | int] | None:
        """Add a mask, its first bit the lowest; None if all are set."""
        return None if which.all() else self.add(np.packbits(which, bitorder="little"), "u1")


def pack(space: Space, most: int = MOST_FACES) -> Packed:
    """Pack a scene: the place of a vertex keeps to half a quantum, `QUANTA` of which are the width of what is shown.

    A value keeps its step on its scale, as `steps_of` has it; the same scene gives the same bytes.
    """
    left, buffer = kept(space.xyz, space.faces, space.edges, space.keep, most), _Buffer()
    places = space.xyz[left.vertices]
    low = places.min(axis=0)
    quantum = np.maximum(places.max(axis=0) - low, 1e-9) / QUANTA
    index = "u2" if len(left.vertices) <= 1 << 16 else "u4"
    rows = {"vertex": left.vertices, "face": left.faces, "edge": left.edges}
    whole = {"vertex": len(space.xyz), "face": len(space.faces), "edge": len(space.edges)}
    meta: dict[str, Any] = {
        "what": space.what,
        "low": low.tolist(),
        "quantum": quantum.tolist(),
        "places": buffer.add(np.rint((places - low) / quantum), "u2"),
        "faces": buffer.add(left.corners, index),
        "edges": buffer.add(left.ends, index),
        "rows": {level: buffer.bits(_among(which, whole[level])) for level, which in rows.items()},
        "bare": BARE.tolist(),
        "tables": {x: buffer.add(table(x), "u1") for x in sorted({y.scale for y in space.layers} - {"rgb"})},
        "layers": [_layer(layer, rows[layer.level], buffer) for layer in space.layers],
        "ceiling": buffer.bits(~space.ceiling[left.faces]),
        "up": (-space.down).tolist(),
        "ahead": space.ahead.tolist(),
        "eye": list(space.eye),
        "camera": _corners(space.rig),
        "stations": _stations(space.stations, buffer),
        "others": [{"words": words, "places": buffer.add(xyz, "f4")} for words, xyz in space.others],
    }
    return Packed(space, left, meta, b"".join(buffer.parts))


def _among(rows: NDArray[np.int64], count: int) -> BoolArray:
    which = np.zeros(count, np.bool_)
    which[rows] = True
    return which


def _layer(layer: Layer, rows: NDArray[np.int64], buffer: _Buffer) -> dict[str, Any]:
    """A layer of the rows that are left."""
    if layer.scale == "rgb":
        steps = np.rint(255 * np.where(layer.ok[:, None], layer.values, 0.0)).astype(np.uint8)
    else:
        steps = steps_of(layer)
    return {
        "name": layer.name,
        "label": layer.label,
        "level": layer.level,
        "unit": layer.unit,
        "note": layer.note,
        "scale": layer.scale,
        "span": list(layer.span),
        "log": layer.is_log,
        "ticks": ticks_of(layer),
        "steps": buffer.add(steps[rows], "u1"),
        "ok": buffer.bits(layer.ok[rows]),
    }


def _corners(rig: Rig) -> list[float]:
    """Left, top, right and bottom of a camera's image, at depth 1."""
    left, top = (-0.5 - rig.cx) / rig.fx, (-0.5 - rig.cy) / rig.fy
    return [left, top, left + rig.width / rig.fx, top + rig.height / rig.fy]


def _stations(stations: Iterable[Station], buffer: _Buffer) -> dict[str, Any]:
    """Numbers, states, places, and the axes right and down of the stations' cameras."""
    given = list(stations)
    T = np.array([station.T_world_camera for station in given], np.float64).reshape(-1, 4, 4)
    known: BoolArray = np.asarray(np.isfinite(T[:, :3]).all(axis=(1, 2)))
    axes = np.where(known[:, None, None], T[:, :3, :2], 0.0).transpose(0, 2, 1)
    return {
        "numbers": buffer.add(np.array([station.number for station in given], np.int64), "i4"),
        "states": buffer.add(np.array([STATES.index(station.state) for station in given], np.int64), "u1"),
        "places": buffer.add(np.where(known[:, None], T[:, :3, 3], np.nan), "f4"),
        "axes": buffer.add(np.rint(32767 * np.clip(axes, -1, 1)), "i2"),
    }
