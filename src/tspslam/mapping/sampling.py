"""What each keyframe sees of the map's complex: signals, weights and the response, element by element."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._brief import Brief, brief
from .._checks import require
from ..errors import InputError
from ..topology.complex import Complex
from ..topology.texture import sample_signals
from ..types import BoolArray, FloatArray, Response, Rig, Signals
from ..vision.rig import project
from .landmarks import depth_sigmas
from .settings import Tangent, ViewSettings
from .views import Rows, View, to_camera
from .visibility import OUT_OF_VIEW, VISIBLE, face_normals, look

_LARGEST = 1e100  # of a response; its square is still finite
_FAINTEST = 1e-9  # luminance: below it the response of a constant is rounding
Filter = Callable[[Complex, FloatArray, Signals], Response]


@dataclass(frozen=True, repr=False)
class Shape(Brief):
    """The map's complex in space, and the frame of each element.

    Attributes
    ----------
    complex_ : Complex
        N vertices, E edges, F faces.
    faces : (F, 3) int32
        Its faces, wound so that normals look at the cameras.
    xyz : (N, 3) float64
        Vertices, m.
    covariance : (N, 3, 3) float64
        Theirs, m².
    centres, normals : tuple of 3 (n, 3) float64
        Middles and unit normals of vertices, edges and faces; area-weighted over the faces around.
    degree : (N,) int64
        Faces at each vertex.
    """

    complex_: Complex
    faces: NDArray[np.int32]
    xyz: FloatArray
    covariance: FloatArray
    centres: tuple[FloatArray, FloatArray, FloatArray]
    normals: tuple[FloatArray, FloatArray, FloatArray]
    degree: Rows


def frame_shape(complex_: Complex, faces: NDArray[np.int32], xyz: FloatArray, covariance: FloatArray) -> Shape:
    """Find middles and normals of all elements.

    Parameters
    ----------
    complex_ : Complex
        N vertices.
    faces : (F, 3) int32
        Its faces, wound so that normals look at the cameras.
    xyz : (N, 3) float64
        Vertices, m.
    covariance : (N, 3, 3) float64
        Theirs, m².

    Returns
    -------
    Shape
    """
    area = face_normals(xyz, faces)
    ends, triples = complex_.edges, complex_.faces
    vertex = _sum_rows(triples, area, complex_.n)
    edge = _sum_rows(complex_.face_edges, area, len(ends))
    centres = xyz, xyz[ends].mean(axis=1), xyz[triples].mean(axis=1)
    degree = np.bincount(triples.ravel(), minlength=complex_.n)
    return Shape(complex_, faces, xyz, covariance, centres, (_unit(vertex), _unit(edge), _unit(area)), degree)


def _sum_rows(rows: NDArray[np.int32], vectors: FloatArray, count: int) -> FloatArray:
    """Sum over the faces at each element: ``rows`` (F, 3) are a face's elements."""
    at, size = rows.ravel(), rows.shape[1]
    return np.stack([np.bincount(at, np.repeat(column, size), minlength=count) for column in vectors.T], axis=1)


def _unit(vectors: FloatArray) -> FloatArray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros(vectors.shape), where=length > 0)


class Sample(NamedTuple):
    """Elements of one level as keyframes see them, one row each.

    Attributes
    ----------
    element, keyframe : (S,) int64
        Rows of the elements of the map, and of the keyframes.
    value : (S,) float64
        Luminance.
    weight : (S,) float64
        Cosine of the viewing angle; of edges and faces, times pixels.
    uv : (S, 2) float64
        Barycentre, px.
    pixels : (S,) int32
        How many.
    """

    element: Rows
    keyframe: Rows
    value: FloatArray
    weight: FloatArray
    uv: FloatArray
    pixels: NDArray[np.int32]

    def __repr__(self) -> str:
        return brief(self)


class Answer(NamedTuple):
    """Responses of vertices as keyframes give them, one row each.

    Attributes
    ----------
    vertex, keyframe : (S,) int64
        Rows of the vertices, and of the keyframes.
    z : (S,) complex128
        The response.
    weight : (S,) float64
        Cosine of the viewing angle.
    direction : (S, 3) float64
        Unit tangent that the phase points along.
    """

    vertex: Rows
    keyframe: Rows
    z: NDArray[np.complex128]
    weight: FloatArray
    direction: FloatArray

    def __repr__(self) -> str:
        return brief(self)


class Samples(NamedTuple):
    """What all keyframes see: samples of each level, answers, and of which order these are.

    Attributes
    ----------
    vertex, edge, face : Sample
        One row for each element and keyframe.
    answer : Answer
        One row for each vertex with a whole star and keyframe.
    seen : (S,) int64
        Keyframe times N plus vertex, ascending, of what each keyframe sees, whatever the angle.
    order : int
        Angular order of the filter.
    """

    vertex: Sample
    edge: Sample
    face: Sample
    answer: Answer
    seen: Rows
    order: int

    def __repr__(self) -> str:
        return brief(self)


def sample_views(
    views: Sequence[View], rows: Rows, rig: Rig, shape: Shape, filter_: Filter, settings: ViewSettings
) -> Samples:
    """Sample the map in every keyframe that sees it, and filter it there.

    An element is seen where all its vertices are inside the image and hidden by no face; only views within
    `max_angle` of its normal count. The response counts where the vertex' whole star is seen.

    Parameters
    ----------
    views : sequence of View
        K keyframes.
    rows : (L,) int64
        Which of them to look through.
    rig : Rig
        The cameras.
    shape : Shape
        The map's complex.
    filter_ : callable, (Complex, uv, Signals) -> Response
        The filter.
    settings : ViewSettings
        When a vertex is hidden, and which views count.

    Returns
    -------
    Samples
    """
    several = [_sample(k, views[k], rig, shape, filter_, settings) for k in rows]
    vertex, edge, face = (_stack([getattr(one, level) for one in several]) for level in ("vertex", "edge", "face"))
    answer = Answer(*map(np.concatenate, zip(*(one.answer for one in several), strict=True)))
    return Samples(vertex, edge, face, answer, np.concatenate([one.seen for one in several]), several[0].order)


def _stack(parts: Sequence[Sample]) -> Sample:
    return Sample(*map(np.concatenate, zip(*parts, strict=True)))


class _Part(NamedTuple):
    """The part of the complex that a keyframe sees; rows of its elements in the map."""

    complex_: Complex
    vertex: Rows
    edge: Rows
    face: Rows

    def __repr__(self) -> str:
        return brief(self)


def _sample(k: int, view: View, rig: Rig, shape: Shape, filter_: Filter, settings: ViewSettings) -> Samples:
    """What one keyframe sees."""
    uv, is_seen = see_vertices(rig, view.T_world_camera, shape, settings)
    part = _restrict(shape.complex_, is_seen)
    places = uv[part.vertex]
    signals = sample_signals(view.image, places, part.complex_, valid=view.valid)
    response = require_response(filter_(part.complex_, places, signals), len(places))
    centre = view.T_world_camera[:3, 3]
    one = np.ones(len(part.vertex), np.int32)
    given = (
        (part.vertex, signals.vertex, signals.vertex_ok, places, one, one),
        (part.edge, signals.edge, signals.edge_ok, signals.edge_uv, signals.edge_pixels, signals.edge_pixels),
        (part.face, signals.face, signals.face_ok, signals.face_uv, signals.face_pixels, signals.face_pixels),
    )
    levels = []
    for (rows, value, ok, at, pixels, size), centres, normals in zip(given, shape.centres, shape.normals, strict=True):
        cosine = viewing_cosines(centres[rows], normals[rows], centre)
        good = ok & (cosine >= settings.least_cosine)
        weight = cosine * np.maximum(size, 1)  # an element without a whole pixel has a bilinear sample
        columns: tuple[Any, ...] = rows, np.full(len(rows), k), value, weight, at, pixels
        levels.append(Sample(*(column[good] for column in columns)))
    answer = _answer(k, view, rig, shape, part, response, settings)
    vertex, edge, face = levels
    return Samples(vertex, edge, face, answer, k * shape.complex_.n + part.vertex, response.order)


def require_response(response: object, n: int) -> Response:
    """Refuse what a filter gave unless it is a finite response at each of n vertices.

    Parameters
    ----------
    response : object
        What it gave.
    n : int
        How many vertices it was given.

    Returns
    -------
    Response
        (n,).

    Raises
    ------
    InputError
        If it is none.
    """
    require(response, Response, "filter: result")
    assert isinstance(response, Response)
    shapes = np.shape(response.z), np.shape(response.defined)
    if shapes != ((n,), (n,)):
        raise InputError(
            f"filter: z and defined have shapes {shapes[0]}, {shapes[1]}, expected ({n},) of a map's luminance"
        )
    if not (np.abs(response.z) < _LARGEST).all():
        raise InputError("filter: a response is not finite or too large, expected numbers below 1e100")
    if response.order < 0:
        raise InputError(f"filter: order is {response.order}, expected 0 or more")
    return response


def see_vertices(
    rig: Rig, T_world_camera: FloatArray, shape: Shape, settings: ViewSettings
) -> tuple[FloatArray, BoolArray]:
    """Find which vertices a keyframe sees, and where.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (4, 4) float64
        The keyframe's pose.
    shape : Shape
        The map's complex.
    settings : ViewSettings
        When a vertex is hidden.

    Returns
    -------
    uv : (N, 2) float64
        px; NaN behind the camera.
    is_seen : (N,) bool
        Whether it is inside the image and hidden by no face.
    """
    uv = project(rig, to_camera(shape.xyz, T_world_camera))
    u, v = uv.T
    rows = np.flatnonzero((u >= 0) & (u <= rig.width - 1) & (v >= 0) & (v <= rig.height - 1))
    along = shape.xyz[rows] - T_world_camera[:3, 3]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    sigma = depth_sigmas(shape.covariance, rows, along)
    by = look(rig, T_world_camera, shape.xyz, shape.faces).hidden_by(rows, settings.hidden * sigma)
    is_seen = np.zeros(len(uv), np.bool_)
    is_seen[rows[(by == VISIBLE) | (by == OUT_OF_VIEW)]] = True
    return uv, is_seen


def _restrict(complex_: Complex, is_seen: BoolArray) -> _Part:
    """The part of a complex whose vertices are all seen."""
    vertex = np.flatnonzero(is_seen)
    edge = np.flatnonzero(is_seen[complex_.edges[:, 0]] & is_seen[complex_.edges[:, 1]])
    a, b, c = complex_.faces.T
    face = np.flatnonzero(is_seen[a] & is_seen[b] & is_seen[c])
    new_vertex, new_edge = (np.empty(size, np.int32) for size in (complex_.n, len(complex_.edges)))
    new_vertex[vertex], new_edge[edge] = np.arange(len(vertex)), np.arange(len(edge))
    faces, sides = new_vertex[complex_.faces[face]], new_edge[complex_.face_edges[face]]
    return _Part(Complex(len(vertex), new_vertex[complex_.edges[edge]], faces, sides), vertex, edge, face)


def viewing_cosines(centres: FloatArray, normals: FloatArray, camera: FloatArray) -> FloatArray:
    """Cosine of the angle between each normal and the way to the camera.

    Parameters
    ----------
    centres, normals : (n, 3) float64
        Middles of elements, m, and their unit normals.
    camera : (3,) or (n, 3) float64
        Where it is, m.

    Returns
    -------
    (n,) float64
    """
    towards = camera - centres
    cosines: FloatArray = np.einsum("ni,ni->n", normals, towards) / np.linalg.norm(towards, axis=1)
    return cosines


def _answer(
    k: int, view: View, rig: Rig, shape: Shape, part: _Part, response: Response, settings: ViewSettings
) -> Answer:
    """Responses of the vertices whose whole star is seen, from within the angle."""
    around = np.bincount(part.complex_.faces.ravel(), minlength=part.complex_.n)
    rows, camera = part.vertex, view.T_world_camera
    cosine = viewing_cosines(shape.xyz[rows], shape.normals[0][rows], camera[:3, 3])
    good = response.defined & (around == shape.degree[rows]) & (cosine >= settings.least_cosine)
    rows, z = rows[good], response.z[good]
    frame = shape.xyz[rows], shape.normals[0][rows], Response(z, response.order, response.defined[good])
    return Answer(rows, np.full(len(rows), k), z, cosine[good], lift_phases(rig, camera, *frame, settings.tangent))


def lift_phases(
    rig: Rig, T_world_camera: FloatArray, xyz: FloatArray, normals: FloatArray, response: Response, tangent: Tangent
) -> FloatArray:
    """Turn phases into unit tangents.

    Parameters
    ----------
    rig : Rig
        The cameras.
    T_world_camera : (4, 4) float64
        Pose of the camera that gave the response.
    xyz : (N, 3) float64
        Vertices, m, before the camera.
    normals : (N, 3) float64
        Unit normals.
    response : Response
        Of the vertices; the phase over the order m is the direction in the image (m = 0 has none: u stands for it).
    tangent : {"projection", "gradient"}
        As `ViewSettings`.

    Returns
    -------
    (N, 3) float64
        In the world; 0 where the response is 0.
    """
    theta = response.phase / max(response.order, 1)
    along, across = np.column_stack([np.cos(theta), np.sin(theta)]), np.column_stack([-np.sin(theta), np.cos(theta)])
    x, y, depth = to_camera(xyz, T_world_camera).T
    nothing = np.zeros_like(x)
    J = np.array([
        [rig.fx + nothing, rig.skew + nothing, -(rig.fx * x + rig.skew * y) / depth],
        [nothing, rig.fy + nothing, -rig.fy * y / depth],
    ]).transpose(2, 0, 1) @ T_world_camera[:3, :3].T  # d(u, v)/dX, times depth  # fmt: skip
    towards = np.einsum("nki,nk->ni", J, along)
    if tangent == "gradient":
        lifted = _unit(towards - np.einsum("ni,ni->n", towards, normals)[:, None] * normals)
    else:
        level = _unit(np.cross(np.einsum("nki,nk->ni", J, across), normals))  # projects neither left nor right of it
        lifted = np.copysign(1.0, np.einsum("ni,ni->n", towards, level))[:, None] * level
    return np.where((response.magnitude > _FAINTEST)[:, None], lifted, 0.0)
