"""Keyframes and landmarks to one topological map: the walk through the room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..frame import Frame
from ..topological_map import Levels, Observations, TopologicalMap
from ..topology.complex import build_complex
from ..types import FloatArray, Rig, Signals, Surface, one_channel
from ..vision.slam.keyframes.keyframe import MapSnapshot
from .averaging import average, average_answers, estimate_gains
from .landmarks import Landmarks, join_observations, measure_covariances, place_landmarks
from .sampling import (
    Filter,
    Samples,
    Shape,
    frame_shape,
    lift_phases,
    require_response,
    sample_views,
    viewing_cosines,
)
from .searching import find_again
from .settings import MappingSettings, SurfaceSettings, ViewSettings
from .surface import cut_surface, make_rays
from .views import NOTHING, Sightings, View, take_keyframes
from .visibility import face_normals

_BYTES = 12_000  # a landmark, as measured for 20 000 (12 kB) and 60 000 (7 kB)
_LEAST = 2  # observations that a vertex keeps, hidden or not


def make_map(
    views: Sequence[View], snapshot: MapSnapshot, rig: Rig, filter_: Filter, settings: MappingSettings
) -> TopologicalMap:
    """Make the map of two keyframes or more.

    Parameters
    ----------
    views : sequence of View
        The keyframes of the snapshot, in its order; which that is does not matter.
    snapshot : MapSnapshot
        Landmarks and their observations.
    rig : Rig
        The cameras, with the offset of the disparities that the path found.
    filter_ : callable, (Complex, uv, Signals) -> Response
        The filter.
    settings : MappingSettings
        How.

    Returns
    -------
    TopologicalMap

    Raises
    ------
    InputError
        If there is no keyframe, or the landmarks take too much memory.
    GeometryError
        If the landmarks span no surface.
    """
    if not views:
        raise InputError("map: no keyframe, expected one or more")
    _check_memory(len(snapshot.landmark_id), settings.surface)
    order = np.argsort([view.number for view in views], kind="stable")
    views, snapshot = [views[k] for k in order], take_keyframes(snapshot, order)
    T = snapshot.T_world_camera
    landmarks = collect_landmarks(views, snapshot, rig, settings)
    landmarks, covariance = measure_covariances(rig, T, landmarks, settings.observe)
    rays = make_rays(T, landmarks, covariance)
    faces = cut_surface(rig, T, landmarks.xyz, rays, settings.surface, settings.views)
    is_used = np.zeros(len(landmarks.id), np.bool_)
    is_used[faces] = True
    faces = (np.cumsum(is_used) - 1)[faces].astype(np.int32)
    faces = faces[np.lexsort(np.sort(faces, axis=1).T[::-1])]
    landmarks = landmarks.keep(is_used)
    shape = frame_shape(build_complex(faces, len(landmarks.id)), faces, landmarks.xyz, covariance[is_used])
    used = np.unique(landmarks.seen.keyframe)  # a keyframe whose observations are all outliers stood elsewhere
    samples = sample_views(views, used, rig, shape, filter_, settings.views)
    numbers = np.array([view.number for view in views], np.int64)
    return _average_all(landmarks, shape, samples, T, numbers, rig, settings.views)


def make_scan_map(
    views: Sequence[View], xyz: FloatArray, faces: NDArray[np.int32], sigma: float, rig: Rig, filter_: Filter,
    settings: ViewSettings,
) -> TopologicalMap:  # fmt: skip
    """Make a map of a surface that was measured otherwise: signals and responses from the keyframes that see it.

    Parameters
    ----------
    views : sequence of View
        One keyframe or more.
    xyz : (N, 3) float64
        Points in the world, m.
    faces : (F, 3) int32
        Triangles, wound so that normals look at where they were seen from.
    sigma : float
        Standard deviation of each coordinate, m.
    rig : Rig
        The cameras.
    filter_ : callable, (Complex, uv, Signals) -> Response
        The filter.
    settings : ViewSettings
        Which views count.

    Returns
    -------
    TopologicalMap
        Its vertices are no landmarks (their number is -1), and have no observations.

    Raises
    ------
    InputError
        If there is no keyframe, or the points take too much memory.
    """
    if not views:
        raise InputError("map: no keyframe, expected one or more")
    _check_memory(len(xyz), SurfaceSettings())
    order = np.argsort([view.number for view in views], kind="stable")
    views = [views[k] for k in order]
    T = np.array([view.T_world_camera for view in views])
    covariance = np.tile(sigma**2 * np.eye(3), (len(xyz), 1, 1))
    shape = frame_shape(build_complex(faces, len(xyz)), faces, xyz, covariance)
    samples = sample_views(views, np.arange(len(views)), rig, shape, filter_, settings)
    numbers = np.array([view.number for view in views], np.int64)
    landmarks = Landmarks(np.full(len(xyz), -1), xyz, NOTHING)
    return _average_all(landmarks, shape, samples, T, numbers, rig, settings)


def _check_memory(landmarks: int, settings: SurfaceSettings) -> None:
    """Refuse more landmarks than there is to be memory for."""
    expected = _BYTES * landmarks
    if expected > settings.max_bytes:
        way = f"at most {settings.max_bytes / 1e9:.3g} (mapping.surface.max_bytes): fewer frames, or more memory"
        raise InputError(f"map: {landmarks} landmarks take about {expected / 1e9:.3g} GB, expected {way}")


def collect_landmarks(views: Sequence[View], snapshot: MapSnapshot, rig: Rig, settings: MappingSettings) -> Landmarks:
    """Join what the path observed to what is found again, and place the landmarks that two keyframes see.

    Parameters
    ----------
    views, snapshot, rig, settings
        As `make_map`.

    Returns
    -------
    Landmarks
    """
    known = Sightings(
        np.searchsorted(snapshot.landmark_id, snapshot.observed_id),
        np.repeat(np.arange(len(views)), np.diff(snapshot.start)),
        snapshot.uv,
        snapshot.disparity,
    )
    found = find_again(views, rig, snapshot.xyz, known, settings.observe)
    seen = join_observations(known, found, len(snapshot.xyz), len(views), settings.observe)
    given = snapshot.landmark_id, snapshot.xyz, seen, settings.observe
    return place_landmarks(rig, snapshot.T_world_camera, *given)


def _average_all(
    landmarks: Landmarks, shape: Shape, samples: Samples, T: FloatArray, keyframes: NDArray[np.int64], rig: Rig,
    settings: ViewSettings,
) -> TopologicalMap:  # fmt: skip
    """The map, from what all keyframes see of it."""
    gain = estimate_gains(samples.face, len(T), settings)
    sizes = shape.complex_.n, len(shape.complex_.edges), len(shape.complex_.faces)
    given = zip((samples.vertex, samples.edge, samples.face), sizes, strict=True)
    vertex, edge, face = (average(sample, gain, size) for sample, size in given)
    signals = Signals(
        vertex.value, edge.value, face.value, edge.uv, face.uv, edge.pixels, face.pixels,
        vertex.views > 0, edge.views > 0, face.views > 0,
    )  # fmt: skip
    response, best, direction, spread, count = average_answers(samples.answer, shape.complex_.n, samples.order)
    return TopologicalMap(
        xyz=shape.xyz, covariance=shape.covariance, surface=Surface(shape.faces), complex_=shape.complex_,
        signals=signals, view_count=Levels(vertex.views, edge.views, face.views),
        view_variance=Levels(vertex.variance, edge.variance, face.variance),
        best_view=Levels(vertex.best, edge.best, face.best), response=response, response_view=best,
        direction=direction, direction_spread=spread, direction_count=count, landmark_id=landmarks.id,
        observations=_observations(landmarks.seen, shape, samples.seen, T, settings), keyframes=keyframes,
        T_world_camera=T, gain=gain, rig=rig,
    )  # fmt: skip


def _observations(
    seen: Sightings, shape: Shape, visible: NDArray[np.int64], T: FloatArray, settings: ViewSettings
) -> Observations:
    """Observations of the vertices; hidden ones go where two others are left."""
    n, rows = shape.complex_.n, seen.landmark
    is_seen = np.isin(seen.keyframe * n + rows, visible)
    cosine = viewing_cosines(shape.xyz[rows], shape.normals[0][rows], T[seen.keyframe, :3, 3])
    weight = np.where(is_seen & (cosine >= settings.least_cosine), cosine, 0.0)
    is_kept = is_seen | (np.bincount(rows, is_seen, minlength=n) < _LEAST)[rows]
    kept, weight = seen.take(is_kept), weight[is_kept]
    start = np.searchsorted(kept.landmark, np.arange(n + 1))
    return Observations(start, kept.keyframe, kept.uv, kept.disparity, weight)


def map_of_frame(
    frame: Frame, rig: Rig, T_world_camera: FloatArray, settings: ViewSettings | None = None
) -> TopologicalMap:
    """Make the map of a single keyframe: its own complex, signals and response, in the world.

    Parameters
    ----------
    frame : Frame
        The keyframe.
    rig : Rig
        The cameras.
    T_world_camera : (4, 4) float64
        Its pose.
    settings : ViewSettings, optional
        Which tangent a phase becomes, and up to which angle an observation counts.

    Returns
    -------
    TopologicalMap
        Points that are no landmarks have the number -1.
    """
    views = settings or ViewSettings()
    response = require_response(replace(frame.response, z=one_channel(frame.response.z)), len(frame.cloud))
    cloud, signals, n, R = frame.cloud, frame.signals, len(frame.cloud), T_world_camera[:3, :3]
    xyz = cloud.xyz @ R.T + T_world_camera[:3, 3]
    covariance = np.zeros((n, 3, 3)) if cloud.covariance is None else R @ cloud.covariance @ R.T
    faces, camera = frame.complex_.faces.copy(), T_world_camera[:3, 3]
    is_away = np.einsum("fi,fi->f", face_normals(xyz, faces), camera - xyz[faces[:, 0]]) < 0
    faces[is_away] = faces[is_away][:, ::-1]
    shape = frame_shape(frame.complex_, faces, xyz, covariance)
    direction = lift_phases(rig, T_world_camera, xyz, shape.normals[0], response, views.tangent)
    weight = viewing_cosines(xyz, shape.normals[0], camera)
    weight = np.where(weight >= views.least_cosine, weight, 0.0)
    counts = Levels(*(ok.astype(np.int32) for ok in (signals.vertex_ok, signals.edge_ok, signals.face_ok)))
    return TopologicalMap(
        xyz=xyz, covariance=covariance, surface=Surface(faces), complex_=frame.complex_, signals=signals,
        view_count=counts, view_variance=Levels(*(np.zeros(len(ok)) for ok in counts)),
        best_view=Levels(*(ok - 1 for ok in counts)), response=frame.response,
        response_view=frame.response.defined.astype(np.int32) - 1,
        direction=np.where(frame.response.defined[:, None], direction, 0.0), direction_spread=np.zeros(n),
        direction_count=frame.response.defined.astype(np.int32),
        landmark_id=np.full(n, -1) if frame.landmark is None else frame.landmark,
        observations=Observations(np.arange(n + 1), np.zeros(n, np.int64), cloud.uv, cloud.disparity, weight),
        keyframes=np.array([frame.index]), T_world_camera=T_world_camera[None], gain=np.ones(1), rig=rig,
    )  # fmt: skip
