"""A town along any path: houses on both sides, parked cars, poles and rolling ground, all of them off the road."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._brief import Brief
from ...errors import InputError
from ...types import FloatArray
from ._checks import MAX_POSES, number, rigid, whole
from .shapes import Scene, Shape, box, pose_at
from .texture import Texture

_LONGEST = 20_000.0  # m, of a path: its town has some 15 000 boxes
_STATION = 1.0  # m between stations of the road
_TANGENT = 3  # stations before and behind that tell the heading
_TILE, _SQUARES = 20.0, 3  # m, side of the ground's tiles, and how many squares wide each is
_REACH = 120.0  # m, how far the ground goes on beside the road
_EVEN = 4.0  # m along the road over which heights are averaged
_SMOOTHER = 0.4  # m more for each metre off the road, so that far from it no road makes a cliff
_SPARSE = 3  # stations from one height of the road to the next
_BLOCK = 1 << 22  # heights weighed at once
_SUNK = 1.5  # m of a house below the ground, which is not level


@dataclass(frozen=True)
class _Kind:
    """Boxes of a kind: least and largest sizes and distances, m."""

    name: str
    across: tuple[float, float]
    tall: tuple[float, float]
    along: tuple[float, float]
    gap: tuple[float, float]  # from one to the next
    beside: tuple[float, float]  # from the middle of the road to the nearer side
    clear: float  # from the nearest path of the camera
    sunk: float
    brightness: tuple[float, float]
    texel: tuple[float, float]


_KINDS = (  # houses stand back by a pavement; a car's path is 1 m to each side of the camera's
    _Kind("house", (7, 10), (5, 11), (6, 13), (8, 15), (7.5, 10), 6.0, _SUNK, (0.35, 0.65), (0.007, 0.018)),
    _Kind("car", (1.7, 1.9), (1.3, 1.6), (3.8, 4.6), (6, 24), (2.9, 3.9), 2.0, 0.3, (0.25, 0.65), (0.004, 0.008)),
    _Kind("pole", (0.2, 0.3), (5, 7), (0.2, 0.3), (16, 30), (5, 6), 2.5, 0.3, (0.2, 0.45), (0.004, 0.006)),
)


def town(path: ArrayLike | None = None, *, height: float = 1.65, seed: int = 0) -> Scene:
    """Build a town around the path of a camera: what stands there stands off all of the path, and is there each time.

    Houses, parked cars and poles stand along both sides, but not where the path goes on, crosses itself or comes back
    in another lane: so crossings are open. The ground follows the heights of the path; where it passes a place at two
    heights, the mean of them.

    Parameters
    ----------
    path : (T, 4, 4) float array, optional
        ``T_world_camera``, y down, m; `town_path()` by default. Through town it goes 1 m to 20 km along x and z.
    height : float
        Of the camera above the ground, m.
    seed : int
        Of all that stands there, and of its texture.

    Returns
    -------
    Scene
        The ground's tiles, then houses, cars and poles.

    Raises
    ------
    InputError
        If the path holds no rigid motions, or is too short or too long.

    Examples
    --------
    >>> scene = town(town_path(block=40))
    >>> sorted({shape.name for shape in scene.shapes})
    ['car', 'ground', 'house', 'pole']
    """
    poses = town_path() if path is None else rigid(path, "town: path", (None, 4, 4))
    height = number(height, "town: height", 0.1, 100, "m")
    rng = np.random.default_rng((5, whole(seed, "town: seed", 0)))
    road = _Road(*_stations(poses, height))
    plots = _Plots(road.places)
    boxes = [shape for kind in _KINDS for shape in _line(kind, road, plots, rng)]
    return Scene((*_ground(road, rng), *boxes), poses, background=0.92, leaves=seed, name="town")


def town_path(laps: int = 1, *, block: float = 80.0, step: float = 1.0) -> FloatArray:
    """Drive around two blocks of houses that share a street, so that it is driven twice a lap, all others once.

    Parameters
    ----------
    laps : int
        How often, 1 to 100.
    block : float
        Side of a block, 40 to 1000 m.
    step : float
        Between frames, m; at most 100 000 of them.

    Returns
    -------
    (T, 4, 4) float64
        ``T_world_camera``, looking ahead; the world is the first camera.

    Raises
    ------
    InputError
        If a value is out of its range.

    Examples
    --------
    >>> town_path(block=50).shape
    (370, 4, 4)
    """
    block = number(block, "town path: block", 40, 1000, "m")
    laps, fine = whole(laps, "town path: laps", 1, 100), 0.1
    round_ = _rounded(block, fine)
    ends: FloatArray = np.linalg.norm(np.diff(round_, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(ends)])
    least = laps * along[-1] / (MAX_POSES - 1)
    step = number(step, "town path: step", max(0.01, least), block, "m")
    stations = np.arange(0, laps * along[-1], step) % along[-1]
    x, z = (np.interp(stations, along, round_[:, axis]) for axis in (0, 1))
    dx, dz = (np.interp(stations, along, np.gradient(round_[:, axis])) for axis in (0, 1))
    return np.stack([pose_at((a, 0, b), (0, np.arctan2(c, d), 0)) for a, b, c, d in zip(x, z, dx, dz, strict=True)])


def _rounded(block: float, fine: float) -> FloatArray:
    """(N, 2) places x, z of one lap, from the middle of the shared street on; corners are rounded over 20 m."""
    from scipy.ndimage import uniform_filter1d

    corners = np.array([[0, 0], [0, 1], [1, 1], [1, 0], [0, 0], [0, 1], [-1, 1], [-1, 0], [0, 0]]) * block
    count = round(block / fine)
    share = np.arange(count)[:, None] / count
    sides = [a + share * (b - a) for a, b in pairwise(corners)]
    line = np.roll(np.concatenate(sides), -(count // 2), axis=0)
    smooth = uniform_filter1d(line, 2 * round(10 / fine) + 1, axis=0, mode="wrap")
    return np.concatenate([smooth, smooth[:1]]) - (0, line[0, 1])


@dataclass(frozen=True, repr=False)
class _Road(Brief):
    """Stations a metre apart: (S, 2) places x, z, (S,) heights y of the ground, (S,) headings, rad."""

    places: FloatArray
    y: FloatArray
    heading: FloatArray

    def ground(self, at: FloatArray) -> FloatArray:
        """Height y of the ground at places (N, 2), m: the mean of the road's, the nearer the heavier.

        Weights are ``exp(-(d² - d_0²) / 2σ²)`` at a distance d; d_0 is the least one, and σ grows with it.
        """
        places, y = self.places[::_SPARSE], self.y[::_SPARSE]
        parts = np.array_split(at, max(1, len(at) * len(places) // _BLOCK))
        return np.concatenate([_weighed(part, places, y) for part in parts])


def _weighed(at: FloatArray, places: FloatArray, y: FloatArray) -> FloatArray:
    square = ((at[:, None] - places) ** 2).sum(axis=2)
    least = square.min(axis=1, keepdims=True)
    sigma = _EVEN + _SMOOTHER * np.sqrt(least)
    weight = np.exp((least - square) / (2 * sigma**2))
    return np.asarray((weight * y).sum(axis=1) / weight.sum(axis=1))


def _stations(poses: FloatArray, height: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Places, heights and headings of a road."""
    position = poses[:, :3, 3]
    step = np.hypot(*np.diff(position[:, [0, 2]], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    if not 1 <= along[-1] <= _LONGEST:
        raise InputError(f"town: path goes {along[-1]:g} m along x and z, expected 1 to {_LONGEST:g}")
    moved = np.concatenate([[True], step > 0])
    at = np.linspace(0, along[-1], max(3, round(along[-1] / _STATION) + 1))
    x, y, z = (np.interp(at, along[moved], position[moved, axis]) for axis in range(3))
    before = np.clip(np.arange(len(at)) - _TANGENT, 0, None)
    after = np.clip(np.arange(len(at)) + _TANGENT, None, len(at) - 1)
    heading = np.arctan2(x[after] - x[before], z[after] - z[before])
    return np.stack([x, z], axis=1), y + height, heading


@dataclass(frozen=True, repr=False)
class _Plot(Brief):
    """A rectangle on the ground: its middle, its two axes as rows, half its sides."""

    middle: FloatArray
    axes: FloatArray
    half: FloatArray


@dataclass(repr=False)
class _Plots(Brief):
    """Where something may still stand: off the road (S, 2), and off what stands already."""

    road: FloatArray
    middle: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    axes: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    half: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))

    def is_free(self, plot: _Plot, clear: float) -> bool:
        """Whether a plot is at least so far from the road, and no other is on it."""
        off = np.maximum(np.abs((self.road - plot.middle) @ plot.axes.T) - plot.half, 0)
        return bool(np.hypot(off[:, 0], off[:, 1]).min() >= clear) and not self._meets(plot).any()

    def _meets(self, plot: _Plot) -> NDArray[np.bool_]:
        """Which rectangles have no side of theirs or of the plot's as a line between them."""
        apart, turned = self.middle - plot.middle, self.axes @ plot.axes.T  # (K, own axis, the plot's axis)
        theirs = np.einsum("kij,kj->ki", self.axes, apart)
        own_reach = plot.half + np.einsum("ki,kij->kj", self.half, np.abs(turned))
        their_reach = self.half + np.abs(turned) @ plot.half
        between = (np.abs(apart @ plot.axes.T) > own_reach) | (np.abs(theirs) > their_reach)
        return ~between.any(axis=1)

    def take(self, plot: _Plot) -> None:
        """Let something stand on a plot."""
        self.middle = np.concatenate([self.middle, plot.middle[None]])
        self.axes = np.concatenate([self.axes, plot.axes[None]])
        self.half = np.concatenate([self.half, plot.half[None]])


def _line(kind: _Kind, road: _Road, plots: _Plots, rng: np.random.Generator) -> Iterator[Shape]:
    """Line both sides of a road with boxes of a kind, where there is room."""
    for side in (-1, 1):
        at = rng.uniform(0, kind.gap[1])
        while at < len(road.places):
            station = int(at)
            at += rng.uniform(*kind.gap) / _STATION
            size = np.array([rng.uniform(*sizes) for sizes in (kind.across, kind.tall, kind.along)])
            aside, look = side * (rng.uniform(*kind.beside) + size[0] / 2), _look(rng, kind.brightness, kind.texel)
            plot = _beside(road, station, aside, size)
            if plots.is_free(plot, kind.clear):
                plots.take(plot)
                yield _stand(kind, plot, size, float(road.heading[station]), road, look)


def _beside(road: _Road, station: int, aside: float, size: FloatArray) -> _Plot:
    sine, cosine = np.sin(road.heading[station]), np.cos(road.heading[station])
    axes = np.array([[cosine, -sine], [sine, cosine]])
    return _Plot(road.places[station] + aside * axes[0], axes, size[[0, 2]] / 2)


def _stand(kind: _Kind, plot: _Plot, size: FloatArray, heading: float, road: _Road, look: Texture) -> Shape:
    """Put a box on the ground of its plot."""
    across, tall, along = size
    made = box(across, tall + kind.sunk, along, texture=look, name=kind.name)
    y = float(road.ground(plot.middle[None])[0]) + kind.sunk - (tall + kind.sunk) / 2
    return made.at(float(plot.middle[0]), y, float(plot.middle[1]), turn=(0, heading, 0))


def _ground(road: _Road, rng: np.random.Generator) -> list[Shape]:
    """Tiles of ground, each of a look of its own, wherever the road is near."""
    from scipy.spatial import cKDTree

    low, high = (np.floor((f(road.places, axis=0) + d) / _TILE) for f, d in ((np.min, -_REACH), (np.max, _REACH)))
    tiles = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
    middle = (tiles.reshape(-1, 2) + 0.5) * _TILE
    middle = middle[cKDTree(road.places).query(middle, distance_upper_bound=_REACH)[0] < np.inf]
    count = _SQUARES + 1
    i, j = (each.ravel() for each in np.mgrid[:count, :count])
    inner = np.stack([i, j], axis=1) * (_TILE / _SQUARES) - _TILE / 2
    y = road.ground((middle[:, None] + inner).reshape(-1, 2)).reshape(len(middle), -1)
    here = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack(corners, axis=1)
            for corners in ((here, here + count, here + 1), (here + 1, here + count, here + count + 1))
        ]
    )
    return [
        Shape(
            "ground",
            np.column_stack([inner[:, 0], heights, inner[:, 1]]),
            faces,
            _look(rng, (0.35, 0.5), (0.008, 0.014)),
            pose_at((x, 0, z)),
        )
        for (x, z), heights in zip(middle, y, strict=True)
    ]


def _look(rng: np.random.Generator, brightness: tuple[float, float], texel: tuple[float, float]) -> Texture:
    return Texture(int(rng.integers(1 << 31)), rng.uniform(*texel), rng.uniform(*brightness), rng.uniform(0.6, 1.0))
