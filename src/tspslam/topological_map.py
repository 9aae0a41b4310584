"""The topological map of a sequence: landmarks, their complex, what all keyframes saw of it, and the response."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ._brief import Brief, brief
from .topology.complex import Complex
from .types import BoolArray, FloatArray, Response, Rig, Signals, Surface


class Levels(NamedTuple):
    """One array for vertices, one for edges, one for faces."""

    vertex: NDArray[np.generic]
    edge: NDArray[np.generic]
    face: NDArray[np.generic]

    def __repr__(self) -> str:
        return brief(self)


@dataclass(frozen=True, repr=False)
class Observations(Brief):
    """Which keyframes see each vertex, and where: row i of a CSR is ``start[i]`` to ``start[i + 1]``, by keyframe.

    Attributes
    ----------
    start : (N + 1,) int64
        Where the observations of each vertex begin.
    keyframe : (M,) int64
        Rows of `TopologicalMap.keyframes`.
    uv : (M, 2) float64
        Where in the left image, px.
    disparity : (M,) float64
        As measured, px; NaN where it was not.
    weight : (M,) float64
        Cosine of the viewing angle; 0 where another face hides the vertex, or the view is too slanted (75°).
    """

    start: NDArray[np.int64]
    keyframe: NDArray[np.int64]
    uv: FloatArray
    disparity: FloatArray
    weight: FloatArray

    def __len__(self) -> int:
        return len(self.keyframe)

    @cached_property
    def vertex(self) -> NDArray[np.int64]:
        """Vertex of each observation, (M,) int64."""
        return np.repeat(np.arange(len(self.start) - 1), np.diff(self.start))


@dataclass(frozen=True, repr=False)
class TopologicalMap(Brief):
    """One simplicial complex over the landmarks of a sequence; `build_map` makes it, `load_map` reads it.

    The world is the first frame's camera, in m. All tools of `tspslam.topology` take its complex and signals.

    Attributes
    ----------
    xyz : (N, 3) float64
        Vertices: landmarks that two keyframes or more see, m.
    covariance : (N, 3, 3) float64
        Theirs, with the keyframes held, m².
    surface : Surface
        Triangles over the vertices, wound so that normals look at the cameras that saw them.
    complex_ : Complex
        The simplicial complex of these triangles: a manifold with a border.
    signals : Signals
        Weighted mean luminance over the keyframes that see each element, whether it was observed there or not;
        barycentres and counts of pixels are those of the best view. Exposures are taken out, so that it may exceed 1.
    view_count : Levels
        How many keyframes each mean is of, int32; 0 where an element is marked.
    view_variance : Levels
        Variance of the luminance over these keyframes, weighed as the mean, float64; 0 also where there is one.
    best_view : Levels
        Keyframe, a row of `keyframes`, of the largest weight, int32; -1 where an element is marked.
    response : Response
        T-MAHF of each vertex in its best view that sees the whole star; its phase is an angle in that image.
    response_view : (N,) int32
        Keyframe, a row of `keyframes`, of that view; -1 where the response is not defined.
    direction : (N, 3) float64
        Unit tangent along which the luminance grows, a weighted mean over the views; 0 where it is not defined. Its
        plane is across the area-weighted mean of the normals of the faces around.
    direction_spread : (N,) float64
        Standard deviation of the views' tangents about it, rad; 0 where only one view counts.
    direction_count : (N,) int32
        How many views count.
    landmark_id : (N,) int64
        Number of each landmark, ascending; numbers stay while the map grows.
    observations : tspslam.topological_map.Observations
        In which keyframes each vertex was matched: its place rests on them.
    keyframes : (K,) int64
        Numbers of the frames.
    T_world_camera : (K, 4, 4) float64
        Their poses.
    gain : (K,) float64
        Luminance of the map over that of each keyframe: exposure; of geometric mean 1.
    rig : Rig
        The cameras, with the offset of the disparities that the path found.
    """

    xyz: FloatArray
    covariance: FloatArray
    surface: Surface
    complex_: Complex
    signals: Signals
    view_count: Levels
    view_variance: Levels
    best_view: Levels
    response: Response
    response_view: NDArray[np.int32]
    direction: FloatArray
    direction_spread: FloatArray
    direction_count: NDArray[np.int32]
    landmark_id: NDArray[np.int64]
    observations: Observations
    keyframes: NDArray[np.int64]
    T_world_camera: FloatArray
    gain: FloatArray
    rig: Rig

    def __len__(self) -> int:
        return len(self.xyz)

    @property
    def defined(self) -> BoolArray:
        """Whether each vertex has a response and a direction, (N,) bool."""
        return self.response.defined

    @cached_property
    def part(self) -> NDArray[np.int32]:
        """Which connected part of the complex each vertex is in, (N,) int32; the largest part is 0."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        ends, n = self.complex_.edges, self.complex_.n
        edges = coo_array((np.ones(len(ends), np.int8), (ends[:, 0], ends[:, 1])), shape=(n, n))
        count, label = connected_components(edges, directed=False)
        order = np.argsort(-np.bincount(label, minlength=count), kind="stable")
        rank = np.empty(count, np.int32)
        rank[order] = np.arange(count)
        return rank[label]
