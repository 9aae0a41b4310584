"""Textured shapes, and scenes made of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._brief import Brief
from ...errors import InputError
from ...types import FloatArray, real_array
from ._checks import FARTHEST, MAX_POSES, finite, instance, keep, label, number, refused, rigid, whole
from .texture import Texture

_SMALLEST = 1e-6  # m
_MAX_FACES = 2_000_000
_MAX_VERTICES = 1_000_000  # of a ready shape


@dataclass(frozen=True, repr=False)
class Shape(Brief):
    """A textured triangle mesh somewhere in the world, perhaps moving.

    Each triangle is lit as the one of the six sides of the shape's own frame that it faces most, away from the frame's
    origin; so where a mesh lies in its frame, and how it is turned in it, changes its brightness, by a half at most.
    Arrays are copied, and the copies cannot be written to.

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
        what = f"shape {label(self.name, 'shape: name')}"
        vertices = finite(self.vertices, f"{what}: vertices", (None, 3))
        keep(
            self,
            vertices=vertices,
            faces=_faces(self.faces, what, len(vertices)),
            texture=instance(Texture, self.texture, f"{what}: texture"),
            pose=rigid(self.pose, f"{what}: pose"),
            velocity=tuple(finite(self.velocity, f"{what}: velocity", (3,)).tolist()),
        )

    def at(self, x: float, y: float, z: float, *, turn: ArrayLike = (0.0, 0.0, 0.0)) -> Shape:
        """Place the shape: turned about its origin, which goes to (x, y, z).

        Parameters
        ----------
        x, y, z : float
            Where, m.
        turn : (3,) float array
            Rotation vector, rad.

        Returns
        -------
        Shape
            A copy with another pose.
        """
        return replace(self, pose=pose_at((x, y, z), turn))

    def world_vertices(self, stamp: float = 0.0) -> FloatArray:
        """Corners in the world at a time.

        Parameters
        ----------
        stamp : float
            Time, s.

        Returns
        -------
        (V, 3) float64
            m.
        """
        moved = self.pose[:3, 3] + number(stamp, "stamp", -1e12, 1e12, "s") * np.asarray(self.velocity)
        return self.vertices @ self.pose[:3, :3].T + moved


@dataclass(frozen=True, repr=False)
class Scene(Brief):
    """Shapes, and the path of a camera among them.

    Attributes
    ----------
    shapes : tuple or list of Shape
        What there is; label 0 is the background, label k the k-th of them, counted from 1.
    path : (T, 4, 4) float64
        ``T_world_camera`` of the left camera for each frame, at most 100 000; it is copied.
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
        what = f"scene {label(self.name, 'scene: name')}"
        path = rigid(self.path, f"{what}: path", (None, 4, 4))
        whole(len(path), f"{what}: number of poses", 1, MAX_POSES)
        keep(
            self,
            shapes=_shapes(self.shapes, what),
            path=path,
            background=number(self.background, f"{what}: background", 0, 1),
            leaves=whole(self.leaves, f"{what}: leaves", 0),
        )


def _shapes(values: Any, what: str) -> tuple[Shape, ...]:
    if not isinstance(values, tuple | list) or not values or not all(isinstance(shape, Shape) for shape in values):
        raise refused(f"{what}: shapes", values, "a tuple of one Shape or more")
    if not any(len(shape.faces) for shape in values):
        raise InputError(f"{what}: its shapes have no face, expected one or more")
    return tuple(values)


def _faces(values: Any, what: str, count: int) -> NDArray[np.int64]:
    """Return a copy of triples of `count` vertices."""
    faces = real_array(values, f"{what}: faces", "(F, 3)")
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu" or len(faces) > _MAX_FACES:
        raise InputError(f"{what}: faces are {faces.dtype} {faces.shape}, expected (F, 3) integers, F to {_MAX_FACES}")
    if faces.size and not 0 <= faces.min() <= faces.max() < count:
        raise InputError(f"{what}: faces name vertices {faces.min()} to {faces.max()}, expected 0 to {count - 1}")
    return faces.astype(np.int64)


def plane(width: float, height: float, *, texture: Texture | None = None, name: str = "plane") -> Shape:
    """Make a rectangle in the plane z = 0 around its origin.

    Parameters
    ----------
    width, height : float
        Along x and y, m.
    texture : Texture, optional
        Its look.
    name : str
        What labels call it.

    Returns
    -------
    Shape

    Examples
    --------
    >>> len(plane(2, 1).faces)
    2
    """
    x, y = _positive(name, width=width, height=height) / 2
    corners = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    return _made(name, corners, np.array([[0, 1, 2], [0, 2, 3]]), texture)


def box(width: float, height: float, depth: float, *, texture: Texture | None = None, name: str = "box") -> Shape:
    """Make a box around its origin.

    Parameters
    ----------
    width, height, depth : float
        Along x, y and z, m.
    texture, name
        As `plane`.

    Returns
    -------
    Shape

    Examples
    --------
    >>> len(box(1, 1, 1).faces)
    12
    """
    half = _positive(name, width=width, height=height, depth=depth) / 2
    corners = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]) * half
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    faces = [triple for a, b, c, d in sides for triple in ((a, b, c), (a, c, d))]
    return _made(name, corners, np.array(faces), texture)


def sphere(radius: float, *, rows: int = 48, texture: Texture | None = None, name: str = "sphere") -> Shape:
    """Make a sphere around its origin.

    Parameters
    ----------
    radius : float
        m.
    rows : int
        3 to 707; the mesh is of rows by 2 rows quadrangles.
    texture, name
        As `plane`.

    Returns
    -------
    Shape

    Examples
    --------
    >>> ball = sphere(0.5)
    >>> float(np.linalg.norm(ball.vertices, axis=1).round(12).max())
    0.5
    """
    (radius,) = _positive(name, radius=radius)
    rows = whole(rows, f"shape {name}: rows", 3, 707)
    polar, turn = _grid(rows, 2 * rows, np.pi, closed=False)
    ring = radius * np.sin(polar)
    corners = np.stack([ring * np.cos(turn), radius * np.cos(polar), ring * np.sin(turn)], axis=1)
    return _made(name, corners, _quadrangles(rows, 2 * rows, closed=False), texture)


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
        3 or more; the mesh has rows · columns vertices, at most 1e6, and twice as many faces.
    texture : Texture, optional
        Its look.
    name : str
        What labels call it.

    Returns
    -------
    Shape

    Examples
    --------
    >>> ring = torus(1.0, 0.4, rows=25, columns=40)
    >>> len(ring.vertices), len(ring.faces)
    (1000, 2000)
    """
    R, r = _positive(name, major=major, minor=minor)
    if r >= R:
        raise InputError(f"shape {name}: minor radius is {r:g} m, expected less than the major one, {R:g} m")
    rows = whole(rows, f"shape {name}: rows", 3, _MAX_VERTICES // 3)
    columns = whole(columns, f"shape {name}: columns", 3, _MAX_VERTICES // rows)
    a, b = _grid(rows, columns, 2 * np.pi, closed=True)
    ring = R + r * np.cos(a)
    corners = np.stack([ring * np.cos(b), ring * np.sin(b), r * np.sin(a)], axis=1)
    return _made(name, corners, _quadrangles(rows, columns, closed=True), texture)


def pose_at(place: ArrayLike, turn: ArrayLike = (0.0, 0.0, 0.0)) -> FloatArray:
    """Pose at a place, turned by a rotation vector.

    Parameters
    ----------
    place : (3,) float array
        m.
    turn : (3,) float array
        rad.

    Returns
    -------
    (4, 4) float64
        World from shape.
    """
    from scipy.spatial.transform import Rotation

    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(finite(turn, "pose: turn", (3,))).as_matrix()
    pose[:3, 3] = finite(place, "pose: place", (3,))
    return pose


def _made(name: str, vertices: FloatArray, faces: NDArray[np.int64], texture: Texture | None) -> Shape:
    return Shape(name, vertices, faces, Texture() if texture is None else texture)


def _positive(name: str, **sizes: float) -> FloatArray:
    what = f"shape {label(name, 'shape: name')}"
    return np.array([number(size, f"{what}: {side}", _SMALLEST, FARTHEST, "m") for side, size in sizes.items()])


def _grid(rows: int, columns: int, span: float, *, closed: bool) -> tuple[FloatArray, FloatArray]:
    """Two angles of each vertex of a grid: the first spans `span`, the second a full turn."""
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
