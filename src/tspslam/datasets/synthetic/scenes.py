"""Ready worlds: a street, a corridor, a room with a loop, a still wall."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...types import FloatArray
from ._checks import MAX_POSES, number, whole
from .shapes import Scene, Shape, box, plane, pose_at, sphere, torus
from .texture import Texture

_FLAT = np.pi / 2  # turns a plane that faces the camera into a floor
_SHORTEST, _LONGEST = 1e-3, 10_000.0  # m


def street(length: float = 300.0, *, step: float = 1.0, seed: int = 0) -> Scene:
    """Build a street that winds gently between houses, with parked cars, seen from 1.65 m above it.

    Parameters
    ----------
    length : float
        Of the camera's path, m, at most 10 000.
    step : float
        Between frames, m; at most 100 000 of them.
    seed : int
        Of the houses, the cars and their texture.

    Returns
    -------
    Scene
        ``length / step + 1`` poses; the world is the first camera.

    Examples
    --------
    >>> len(street(20).path)
    21
    """
    length, along = _stations("street", length, step)
    rng = _generator("street", 1, seed)
    bend = _bend(12.0, 180.0)
    ahead = length + 80
    ground = plane(2000, length + 2000, texture=_random(rng, 0.45, 0.7), name="road")
    shapes = [ground.at(0, 1.65, length / 2, turn=(_FLAT, 0, 0))]
    for side in (-1, 1):
        for z in _places(rng, -15, ahead, 9, 16):
            width, height, depth = rng.uniform(7, 10), rng.uniform(5, 11), rng.uniform(6, 12)
            house = box(width, height, depth, texture=_random(rng, 0.5, 0.9), name="house")
            shapes.append(_beside(house, bend, z, side * (9 + width / 2), 1.65 - height / 2))
        for z in _places(rng, -5, ahead, 7, 22):
            car = box(1.8, 1.4, 4.2, texture=_random(rng, 0.45, 0.8, texel=0.005), name="car")
            shapes.append(_beside(car, bend, z, side * rng.uniform(4.0, 4.6), 1.65 - 0.7))
        for z in _places(rng, 0, ahead, 18, 30):
            pole = box(0.2, 6, 0.2, texture=_random(rng, 0.3, 0.5, texel=0.005), name="pole")
            shapes.append(_beside(pole, bend, z, side * 6.5, 1.65 - 3))
    return Scene(tuple(shapes), _follow(bend, along), background=0.92, leaves=seed, name="street")


def corridor(length: float = 300.0, *, step: float = 0.5, seed: int = 0) -> Scene:
    """Build a corridor 2.6 m wide and 2.7 m high, with cupboards along its walls, seen from 1.4 m above the floor.

    Parameters, returns: as `street`.

    Examples
    --------
    >>> corridor(10).path.shape
    (21, 4, 4)
    """
    length, along = _stations("corridor", length, step)
    rng = _generator("corridor", 2, seed)
    middle, span = length / 2, length + 60
    sides = (
        plane(2.6, span, texture=_random(rng, 0.4, 0.6), name="floor").at(0, 1.4, middle, turn=(_FLAT, 0, 0)),
        plane(2.6, span, texture=_random(rng, 0.75, 0.35), name="ceiling").at(0, -1.3, middle, turn=(_FLAT, 0, 0)),
        plane(span, 2.7, texture=_random(rng, 0.6, 0.6), name="wall").at(-1.3, 0.05, middle, turn=(0, _FLAT, 0)),
        plane(span, 2.7, texture=_random(rng, 0.55, 0.6), name="wall").at(1.3, 0.05, middle, turn=(0, _FLAT, 0)),
        plane(2.6, 2.7, texture=_random(rng, 0.5, 0.9), name="end").at(0, 0.05, length + 30),
    )
    cupboards = []
    for side in (-1, 1):
        for z in _places(rng, 1, length + 30, 3, 9):
            height, depth = rng.uniform(0.8, 2.2), rng.uniform(0.25, 0.45)
            made = box(
                depth, height, rng.uniform(0.6, 1.6), texture=_random(rng, 0.5, 0.9, texel=0.004), name="cupboard"
            )
            cupboards.append(made.at(side * (1.3 - depth / 2), 1.4 - height / 2, z))
    sway = _bend(0.25, 35.0)
    return Scene((*sides, *cupboards), _follow(sway, along), leaves=seed, name="corridor")


def room(*, laps: float = 1.0, frames: int = 240, seed: int = 0) -> Scene:
    """Build a room of 12 by 9 by 3 m with furniture, a ball and a ring; the camera walks a loop and comes back.

    Parameters
    ----------
    laps : float
        How often the loop is walked, up to 100 times.
    frames : int
        Poses of one lap, 8 or more; at most 100 000 in all.
    seed : int
        Of the furniture and the texture.

    Returns
    -------
    Scene
        The camera looks ahead along an ellipse, 1.5 m above the floor; the world is the first camera.

    Examples
    --------
    >>> room(frames=40).path.shape
    (40, 4, 4)
    """
    frames = whole(frames, "room: frames", 8, MAX_POSES)
    count = round(number(laps, "room: laps", 1 / frames, min(100, MAX_POSES / frames)) * frames)
    rng = _generator("room", 3, seed)
    walls = _walls(rng, 12.0, 9.0)
    things = _furniture(rng)
    turn = 2 * np.pi * np.arange(count) / frames
    # the ellipse begins at the origin, towards +z; its middle is to the right
    path = np.stack([_pose(3.6 * (1 - np.cos(a)), 2.4 * np.sin(a), _heading(a)) for a in turn])
    return Scene((*walls, *things), path, leaves=seed, name="room")


def still(frames: int = 200, *, depth: float = 3.0, seed: int = 0) -> Scene:
    """Build a wall with a few boxes before it, at which a camera looks without moving.

    Parameters
    ----------
    frames : int
        How many poses, all the same; at most 100 000.
    depth : float
        Of the wall, m, 0.5 to 1000.
    seed : int
        Of the boxes and the texture.

    Returns
    -------
    Scene

    Examples
    --------
    >>> bool((still(3).path == np.eye(4)).all())
    True
    """
    frames = whole(frames, "still: frames", 1, MAX_POSES)
    depth = number(depth, "still: depth", 0.5, 1000, "m")
    rng, texel = _generator("still", 4, seed), depth / 500
    wall = plane(4 * depth, 4 * depth, texture=_random(rng, 0.5, 0.9, texel=texel), name="wall").at(0, 0, depth)
    boxes = []
    for _ in range(6):
        width, height, length = rng.uniform(0.1, 0.2, 3) * depth
        x, y, z = rng.uniform((-0.4, -0.4, 0.7), (0.4, 0.4, 0.9)) * depth
        made = box(width, height, length, texture=_random(rng, 0.5, 0.9, texel=texel))
        boxes.append(made.at(x, y, z, turn=rng.uniform(-0.6, 0.6, 3)))
    return Scene((wall, *boxes), np.eye(4)[None].repeat(frames, axis=0), leaves=seed, name="still")


def _walls(rng: np.random.Generator, width: float, depth: float) -> list[Shape]:
    """Floor, ceiling and walls around the ellipse's middle."""
    x, half_x, half_z = 3.6, width / 2, depth / 2
    looks = [_random(rng, level, 0.7) for level in (0.4, 0.75, 0.55, 0.6, 0.5, 0.55)]
    return [
        plane(width, depth, texture=looks[0], name="floor").at(x, 1.5, 0, turn=(_FLAT, 0, 0)),
        plane(width, depth, texture=looks[1], name="ceiling").at(x, -1.5, 0, turn=(_FLAT, 0, 0)),
        plane(depth, 3, texture=looks[2], name="wall").at(x - half_x, 0, 0, turn=(0, _FLAT, 0)),
        plane(depth, 3, texture=looks[3], name="wall").at(x + half_x, 0, 0, turn=(0, _FLAT, 0)),
        plane(width, 3, texture=looks[4], name="wall").at(x, 0, -half_z),
        plane(width, 3, texture=looks[5], name="wall").at(x, 0, half_z),
    ]


def _furniture(rng: np.random.Generator) -> list[Shape]:
    """Boxes along the walls, and a ball and a ring in the middle of the loop."""
    things = [
        sphere(0.6, texture=_random(rng, 0.5, 1, texel=0.005)).at(3.2, 0.9, 0.6),
        torus(0.6, 0.2, texture=_random(rng, 0.5, 1, texel=0.005)).at(4.4, 0.6, -0.5, turn=(0.4, 0.5, 0)),
    ]
    for k in range(14):
        angle = 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / 14
        width, height, depth = rng.uniform(0.5, 1.2), rng.uniform(0.6, 2.2), rng.uniform(0.4, 0.8)
        made = box(width, height, depth, texture=_random(rng, 0.5, 0.9, texel=0.005), name="furniture")
        things.append(made.at(3.6 + 5.4 * np.cos(angle), 1.5 - height / 2, 4.0 * np.sin(angle), turn=(0, angle, 0)))
    return things


def _random(rng: np.random.Generator, brightness: float, contrast: float, texel: float = 0.01) -> Texture:
    return Texture(int(rng.integers(1 << 31)), texel, brightness, contrast)


def _places(rng: np.random.Generator, first: float, last: float, least: float, most: float) -> list[float]:
    """Places from `first` to `last` with gaps between `least` and `most`."""
    places = [first + rng.uniform(0, most)]
    while places[-1] < last:
        places.append(places[-1] + rng.uniform(least, most))
    return places[:-1]


def _stations(name: str, length: float, step: float) -> tuple[float, FloatArray]:
    """Length of the path, and where along it a frame is taken."""
    length = number(length, f"{name}: length", _SHORTEST, _LONGEST, "m")
    step = number(step, f"{name}: step", max(_SHORTEST, length / (MAX_POSES - 1)), length, "m")
    count = int(length / step + 1e-9)
    return length, np.linspace(0, step * count, count + 1, dtype=np.float64)


def _generator(name: str, kind: int, seed: int) -> np.random.Generator:
    """Chance of a ready world, which is another one for each kind."""
    return np.random.default_rng((kind, whole(seed, f"{name}: seed", 0)))


def _bend(sway: float, period: float) -> Callable[[float], tuple[float, float]]:
    """Middle of the way at z, and its heading: x = sway (1 - cos(2πz / period)), straight at the start."""

    def at(z: float) -> tuple[float, float]:
        w = 2 * np.pi / period
        return sway * (1 - np.cos(w * z)), float(np.arctan(sway * w * np.sin(w * z)))

    return at


def _beside(shape: Shape, bend: Callable[[float], tuple[float, float]], z: float, aside: float, y: float) -> Shape:
    """Put a shape beside the way, turned along it."""
    x, heading = bend(z)
    return shape.at(x + aside * np.cos(heading), y, z - aside * np.sin(heading), turn=(0, heading, 0))


def _follow(bend: Callable[[float], tuple[float, float]], along: FloatArray) -> FloatArray:
    """Poses at equal steps of the way's length, looking along it."""
    fine = np.linspace(0, along[-1], 20 * len(along) + 1)
    x = np.array([bend(z)[0] for z in fine])
    travelled = np.concatenate([[0], np.cumsum(np.hypot(np.diff(x), np.diff(fine)))])
    stations = np.interp(along, travelled, fine)
    return np.stack([_pose(bend(z)[0], z, bend(z)[1]) for z in stations])


def _heading(angle: float) -> float:
    return float(np.arctan2(3.6 * np.sin(angle), 2.4 * np.cos(angle)))


def _pose(x: float, z: float, heading: float) -> FloatArray:
    return pose_at((x, 0, z), (0, heading, 0))
