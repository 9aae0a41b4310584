"""Textured shapes, and scenes made of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...errors import InputError
from ...types import FloatArray, real_array
from .texture import Texture, check_seed

_FARTHEST = 1e6  # m
_MOST_FACES = 2_000_000


@dataclass(frozen=True)
class Shape:
    """A textured triangle mesh somewhere in the world, perhaps moving.

    Attributes
    ----------
    name : str
        What labels call it.
    vertices : (V, 3) float64
        Corners in the shape's own frame, m.
    faces : (F, 3) int64
        Triples of them; seen from both sides.
    texture : Texture
        Its look. A triangle is textured along the two axes of the shape's frame that it faces least.
    pose : (4, 4) float64
        Maps the shape's frame to the world.
    velocity : (3,) floats
        Motion in the world, m/s, from stamp 0 on.

    Raises
    ------
    InputError
        If a value is not finite, the pose is no rigid motion, or a face names a vertex that is not there.

    Examples
    --------
    >>> corner = Shape("corner", np.eye(3), np.array([[0, 1, 2]]))
    >>> corner.at(2.0, 0, 5).pose[:3, 3].tolist()
    [2.0, 0.0, 5.0]
    """

    name: str
    vertices: FloatArray
    faces: NDArray[np.int64]
    texture: Texture = field(default_factory=Texture)
    pose: FloatArray = field(default_factory=lambda: np.eye(4))
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        vertices = finite(self.vertices, f"shape {self.name}: vertices", (None, 3))
        faces = real_array(self.faces, f"shape {self.name}: faces", "(F, 3)")
        if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or len(faces) > _MOST_FACES:
            raise InputError(f"shape {self.name}: faces are {faces.dtype} {faces.shape}, expected (F, 3) integers")
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise InputError(
                f"shape {self.name}: faces name vertices {faces.min()} to {faces.max()}, expected 0 to "
                f"{len(vertices) - 1}"
            )
        finite(self.velocity, f"shape {self.name}: velocity", (3,))
        check_rigid(finite(self.pose, f"shape {self.name}: pose", (4, 4)), f"shape {self.name}: pose")

    def at(self, x: float, y: float, z: float, *, turn: ArrayLike = (0.0, 0.0, 0.0)) -> Shape:
        """Place the shape: turned by a rotation vector, rad, about its origin, which goes to (x, y, z), m.

        Returns
        -------
        Shape
            A copy with another pose.
        """
        return replace(self, pose=pose_at((x, y, z), turn))

    def world_vertices(self, stamp: float = 0.0) -> FloatArray:
        """(V, 3) corners in the world at a time, m."""
        moved = np.asarray(self.pose)[:3, 3] + stamp * np.asarray(self.velocity)
        return np.asarray(self.vertices, np.float64) @ np.asarray(self.pose)[:3, :3].T + moved


@dataclass(frozen=True)
class Scene:
    """Shapes, and the path of a camera among them.

    Attributes
    ----------
    shapes : tuple of Shape
        What there is; label 0 is the background, label k the k-th of them, counted from 1.
    path : (T, 4, 4) float64
        ``T_world_camera`` of the left camera for each frame.
    background : float
        Luminance where no shape is.
    leaves : int
        Seed of the world's leaves, see `Texture`.
    name : str
        What to call it.

    Raises
    ------
    InputError
        If there is no shape, or a pose of the path is no rigid motion.

    Examples
    --------
    >>> Scene((plane(4, 3).at(0, 0, 5),)).path.shape
    (1, 4, 4)
    """

    shapes: tuple[Shape, ...]
    path: FloatArray = field(default_factory=lambda: np.eye(4)[None])
    background: float = 0.9
    leaves: int = 0
    name: str = "scene"

    def __post_init__(self) -> None:
        if not self.shapes or not all(isinstance(shape, Shape) for shape in self.shapes):
            raise InputError(f"scene {self.name}: has {len(self.shapes)} shapes, expected one Shape or more")
        path = finite(self.path, f"scene {self.name}: path", (None, 4, 4))
        check_seed(self.leaves, f"scene {self.name}")
        if not any(len(shape.faces) for shape in self.shapes):
            raise InputError(f"scene {self.name}: its shapes have no face, expected one or more")
        if not len(path) or not 0 <= self.background <= 1:
            raise InputError(
                f"scene {self.name}: {len(path)} poses, background {self.background}, expected one pose or more, 0 to 1"
            )
        for index, pose in enumerate(path):
            check_rigid(pose, f"scene {self.name}: pose {index} of the path")


def plane(width: float, height: float, *, texture: Texture | None = None, name: str = "plane") -> Shape:
    """Make a rectangle of `width` (x) by `height` (y), m, in the plane z = 0, around its origin.

    Examples
    --------
    >>> len(plane(2, 1).faces)
    2
    """
    x, y = _positive(name, width=width, height=height) / 2
    corners = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    return Shape(name, corners, np.array([[0, 1, 2], [0, 2, 3]]), texture or Texture())


def box(width: float, height: float, depth: float, *, texture: Texture | None = None, name: str = "box") -> Shape:
    """Make a box of `width` (x) by `height` (y) by `depth` (z), m, around its origin.

    Examples
    --------
    >>> len(box(1, 1, 1).faces)
    12
    """
    half = _positive(name, width=width, height=height, depth=depth) / 2
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    faces = [triple for a, b, c, d in sides for triple in ((a, b, c), (a, c, d))]
    return Shape(name, corners, np.array(faces), texture or Texture())


def sphere(radius: float, *, rows: int = 48, texture: Texture | None = None, name: str = "sphere") -> Shape:
    """Make a sphere around its origin, as a mesh of `rows` by 2 `rows` quadrangles.

    Examples
    --------
    >>> ball = sphere(0.5)
    >>> float(np.linalg.norm(ball.vertices, axis=1).round(12).max())
    0.5
    """
    (radius,) = _positive(name, radius=radius)
    polar, turn = _grid(name, rows, 2 * rows, np.pi, closed=False)
    ring = radius * np.sin(polar)
    corners = np.stack([ring * np.cos(turn), radius * np.cos(polar), ring * np.sin(turn)], axis=1)
    return Shape(name, corners, _quadrangles(rows, 2 * rows, closed=False), texture or Texture())


def torus(
    major: float, minor: float, *, rows: int = 80, columns: int = 250, texture: Texture | None = None,
    name: str = "torus",
) -> Shape:  # fmt: skip
    """Make a torus about the z axis: `rows` vertices around the tube, `columns` around the axis.

    Vertex ``i · columns + j`` is ``((R + r cos a) cos b, (R + r cos a) sin b, r sin a)`` with a = 2πi / rows and
    b = 2πj / columns.

    Parameters
    ----------
    major, minor : float
        R and r, m; r < R.
    rows, columns : int
        3 or more; the mesh has rows · columns vertices and twice as many faces.
    texture : Texture, optional
        Its look.
    name : str
        What labels call it.

    Examples
    --------
    >>> ring = torus(1.0, 0.4, rows=25, columns=40)
    >>> len(ring.vertices), len(ring.faces)
    (1000, 2000)
    """
    R, r = _positive(name, major=major, minor=minor)
    if r >= R:
        raise InputError(f"shape {name}: minor radius is {r:g} m, expected less than the major one, {R:g} m")
    a, b = _grid(name, rows, columns, 2 * np.pi, closed=True)
    ring = R + r * np.cos(a)
    corners = np.stack([ring * np.cos(b), ring * np.sin(b), r * np.sin(a)], axis=1)
    return Shape(name, corners, _quadrangles(rows, columns, closed=True), texture or Texture())


def pose_at(place: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """(4, 4) pose at a place, m, turned by a rotation vector, rad."""
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(finite(turn, "pose: turn", (3,))).as_matrix()
    pose[:3, 3] = finite(place, "pose: place", (3,))
    return pose


def finite(values: Any, what: str, shape: tuple[int | None, ...]) -> FloatArray:
    """`values` as float64 of a shape (None: any length), each finite and at most 1e6; InputError otherwise."""
    said = " x ".join("n" if side is None else str(side) for side in shape)
    array = real_array(values, what, said).astype(np.float64)
    fits = array.ndim == len(shape) and all(b is None or a == b for a, b in zip(array.shape, shape, strict=True))
    if not fits or not (np.abs(array) <= _FARTHEST).all():
        raise InputError(f"{what} has shape {array.shape}, expected {said} finite numbers, at most 1e6")
    return array


def check_rigid(pose: FloatArray, what: str) -> None:
    """Refuse a (4, 4) matrix that is no rigid motion, to 1e-6."""
    R = pose[:3, :3]
    off = max(float(np.abs(R @ R.T - np.eye(3)).max()), float(np.abs(pose[3] - (0, 0, 0, 1)).max()))
    if off > 1e-6 or np.linalg.det(R) < 0:
        raise InputError(f"{what} is off a rigid motion by {off:.2g}, expected rotation and translation, to 1e-6")


def _positive(name: str, **sizes: float) -> FloatArray:
    for what, size in sizes.items():
        if not 0 < size <= _FARTHEST:
            raise InputError(f"shape {name}: {what} is {size}, expected metres, positive, at most 1e6")
    return np.array(list(sizes.values()), np.float64)


def _grid(name: str, rows: int, columns: int, span: float, *, closed: bool) -> tuple[FloatArray, FloatArray]:
    """Two angles of each vertex of a grid: the first spans `span`, the second a full turn."""
    for what, count in (("rows", rows), ("columns", columns)):
        if not (isinstance(count, int | np.integer) and 3 <= count <= 100_000) or rows * columns > _MOST_FACES // 2:
            raise InputError(f"shape {name}: {what} is {count}, expected 3 or more, and at most 1e6 vertices")
    first = np.linspace(0, span, rows, endpoint=False) if closed else np.linspace(0, span, rows + 1)
    second = np.linspace(0, 2 * np.pi, columns, endpoint=False)
    a, b = np.meshgrid(first, second, indexing="ij")
    return a.ravel(), b.ravel()


def _quadrangles(rows: int, columns: int, *, closed: bool) -> NDArray[np.int64]:
    """Two triangles for each cell of a grid whose columns close, and whose rows do if `closed`."""
    i, j = np.divmod(np.arange(rows * columns), columns)
    below, right = (i + 1) % rows if closed else i + 1, (j + 1) % columns
    here, beside, down, across = i * columns + j, i * columns + right, below * columns + j, below * columns + right
    return np.concatenate([np.stack([here, across, beside], axis=1), np.stack([here, down, across], axis=1)])
