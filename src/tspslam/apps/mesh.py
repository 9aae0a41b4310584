"""Meshes denoised: normals filtered under the guidance of consistent patches, or coordinates cut off in frequency."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import real_array
from ..errors import InputError
from ..topology._stars import face_neighbours
from ..types import BoolArray, FloatArray
from . import _mesh

Index = NDArray[np.int32]

_ROUNDING = 1e-9  # of the largest covariance
_LARGEST = 1e100  # m; squares of larger numbers overflow
_NONE = 1e-7  # of a mean edge: noise that is none; rounding of coordinates far away
_AS_ROUGH = 0.85  # noise along the surface over that across it: from here to its inverse it is the same on all axes,
_FOLDED = 0.04  # and beyond, where more faces are folded over; development: across only up to 0.03, else from 0.07
_DEGREE = 96  # of the Chebyshev series: a cut that leaves one of some thousand frequencies
_CUTS = np.geomspace(2 * np.pi / _DEGREE, np.pi / 2, 25)  # candidates, angle θ of the eigenvalue 1 - cos θ
_HIGH = 1.0  # angle from which frequencies are high: most of a lattice's
_ALIKE = 0.2  # relative difference of variances that are taken for the same
_BAND_LIMITED = (
    0.03  # of the noise's variance: a cut of less risk is taken; development: smooth grids to 0.015, others from 0.05
)
_LOST = (
    0.10,
    0.20,
)  # of the noise's variance, in the averaged residual: from here on shape went with it, to here all of
# it is filtered gently; development, noise of 0.15 and 0.3 edges: 0.10 to 0.20, 0.15 to 0.25 and a threshold tried
_FAR = 40  # steps of averaging over which lost shape is looked for: 6, 15 and 40 tried
_FEW = 0.01  # of the vertices: fewer that have lost shape are chance
_REACH = 1.2  # of the bell over distances, mean distances between centres of faces that touch
_PULL = 0.01  # back to the noisy place in each round, over the noise in mean edges; at most half
_SLIDE = 0.8  # share of the way to the middle of the faces around, in each round


@dataclass(frozen=True)
class _Mesh:
    """Faces (F, 3), wound alike, and which meet: at each vertex, around each face (CSR)."""

    faces: Index
    start: Index
    at: Index
    begin: Index
    near: Index
    border: BoolArray

    @property
    def used(self) -> BoolArray:
        """Which vertices have a face."""
        return np.diff(self.start) > 0


class _Noise(NamedTuple):
    """Standard deviations, m: across the surface, and along it (per axis; a rough mesh's own jitter included)."""

    across: float
    along: float
    folded: float


class _Strength(NamedTuple):
    """How firmly normals are filtered; pairs are values at no noise, and what each mean edge of noise adds."""

    rounds: tuple[float, float]
    moves: int  # of the vertices in each round
    width: tuple[float, float]  # of the bell over differences of unit normals
    corner: float  # ... for the normals at a corner


_FIRM = _Strength((12, 50), 8, (0.22, 0.27), 0.2)
_GENTLE = _Strength((8, 20), 4, (0.2, 0.2), 0.15)
"""Chosen on the shapes of development: gentle for detail as fine as a few faces, firm for all else."""


class _Geometry(NamedTuple):
    normals: FloatArray
    centres: FloatArray
    areas: FloatArray
    angles: FloatArray


def denoise_mesh(
    xyz: ArrayLike, faces: ArrayLike, *, covariance: ArrayLike | None = None, noise: float | None = None
) -> FloatArray:
    """Move the vertices of a noisy triangle mesh back onto its surface, creases kept sharp; nothing to be set.

    Parameters
    ----------
    xyz : (N, 3) float array
        Noisy vertices, m.
    faces : (F, 3) integers
        Vertex triples; closed or open, wound alike or not. Vertices without a face stay.
    covariance : (N, 3, 3) float array, optional
        What is known of each vertex's noise, m², symmetric positive semidefinite: vertices move where they are unsure,
        such as along the ray of a stereo camera. Its scale does not matter. Default: alike in all directions.
    noise : float, optional
        Standard deviation of the noise across the surface, m, >= 0. Default: estimated.

    Returns
    -------
    (N, 3) float64
        Denoised vertices, m.

    Raises
    ------
    InputError
        If a vertex is not finite, a face names a vertex that is not there, or shapes do not fit.

    Examples
    --------
    >>> i, j = np.divmod(np.arange(400), 20)
    >>> flat = np.column_stack([i, j, np.zeros(400)])
    >>> here = np.flatnonzero((i < 19) & (j < 19))
    >>> faces = np.concatenate([np.stack([here, here + 20, here + 21], 1), np.stack([here, here + 21, here + 1], 1)])
    >>> rough = flat + np.random.default_rng(0).normal(0, 0.3, 400)[:, None] * [0, 0, 1]
    >>> smooth = denoise_mesh(rough, faces)
    >>> bool(smooth[:, 2].std() < 0.4 * rough[:, 2].std())
    True
    """
    points = _checked_points(xyz)
    triangles = _checked_faces(faces, len(points))
    unsure = _checked_covariance(covariance, len(points))
    level = _checked_noise(noise)
    mesh = _connect(triangles, len(points))
    if not len(mesh.faces):
        return points
    middle = points[mesh.used].mean(axis=0)
    edge = _mean_edge(points - middle, mesh)
    if edge == 0 or level == 0:
        return points
    moved = _denoise((points - middle) / edge, mesh, _gains(unsure, mesh), None if level is None else level / edge)
    return np.where(mesh.used[:, None], moved * edge + middle, points)


def _denoise(points: FloatArray, mesh: _Mesh, gain: FloatArray, level: float | None) -> FloatArray:
    """Denoise vertices whose mean edge is 1."""
    found = _estimate_noise(points, mesh)
    across = found.across if level is None else level
    if across <= _NONE:
        return points
    isotropic = found.along > _AS_ROUGH * across and (found.folded > _FOLDED or found.along < across / _AS_ROUGH)
    if not gain.size:
        smooth, risk = _cut_off(points, mesh, across**2 * (3 if isotropic else 1))
        if risk < _BAND_LIMITED:
            return smooth
    slides = isotropic and not gain.size
    firm = _sharpen(points, mesh, gain, across, _FIRM, slides)
    share = np.clip((_lost(points, firm, mesh) / across**2 - _LOST[0]) / (_LOST[1] - _LOST[0]), 0, 1)
    if share.mean() < _FEW:
        return firm
    return firm + share * (_sharpen(points, mesh, gain, across, _GENTLE, slides) - firm)


def _connect(faces: Index, n: int) -> _Mesh:
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    faces = np.ascontiguousarray(faces[proper])
    start, at = face_neighbours(n, faces)
    _mesh.orient(faces, start, at)
    begin, near = _mesh.rings(faces, start, at)
    return _Mesh(faces, start, at, begin, near, _mesh.on_border(faces, start, at))


def _measure(points: FloatArray, mesh: _Mesh, into: _Geometry | None = None) -> _Geometry:
    count = len(mesh.faces)
    into = into or _Geometry(np.empty((count, 3)), np.empty((count, 3)), np.empty(count), np.empty((count, 3)))
    _mesh.measure_faces(points, mesh.faces, *into)
    return into


def _normals_at_vertices(geometry: _Geometry, mesh: _Mesh) -> FloatArray:
    """Unit normals (N, 3), means over the faces at each vertex by their area; 0 without faces."""
    values = geometry.normals * geometry.areas[:, None]
    total = np.concatenate([np.zeros((1, 3)), np.cumsum(values[mesh.at], axis=0)])
    count = np.maximum(np.diff(mesh.start), 1)[:, None]
    means = (total[mesh.start[1:]] - total[mesh.start[:-1]]) / count
    return np.asarray(means / np.maximum(np.linalg.norm(means, axis=1, keepdims=True), 1e-300))


def _mean_edge(points: FloatArray, mesh: _Mesh) -> float:
    """Mean length of the faces' sides, also where their squares would overflow or vanish."""
    largest = np.abs(points[mesh.used]).max()
    if largest == 0:
        return 0.0
    corners = points[mesh.faces] / largest
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean() * largest)


def _gains(covariance: FloatArray, mesh: _Mesh) -> FloatArray:
    """Covariances over the largest eigenvalue among the vertices of the faces around; nothing from nothing."""
    if not covariance.size:
        return covariance
    largest = np.linalg.eigvalsh(covariance)[:, 2]
    around = np.zeros(len(covariance))
    for corner in range(3):
        np.maximum.at(around, mesh.faces[:, corner], largest[mesh.faces].max(axis=1))
    share = np.where(around > 0, 1 / np.where(around > 0, around, 1), 0)
    return np.ascontiguousarray(covariance * share[:, None, None])


def _walked(points: FloatArray, mesh: _Mesh) -> FloatArray:
    """Mean of the other corners of the faces at each vertex."""
    out = np.empty_like(points)
    _mesh.walk(points, points, mesh.faces, mesh.start, mesh.at, True, out)
    return out


def _estimate_noise(points: FloatArray, mesh: _Mesh) -> _Noise:
    """Quartiles of second differences of second differences: creases, and what is smooth to third order, drop out."""
    smooth = points
    for _ in range(5):
        smooth = (smooth + _walked(smooth, mesh)) / 2
    plain, pilot = _measure(points, mesh), _measure(smooth, mesh)
    folded = float((np.einsum("ij,ij->i", plain.normals, pilot.normals) < 0).mean())
    normals = _normals_at_vertices(pilot, mesh)
    once = points - _walked(points, mesh)
    twice = (once - _walked(once, mesh))[mesh.used] / np.sqrt(_mesh.second_gain(mesh.faces, mesh.start, mesh.at))[
        mesh.used, None
    ]
    normals = normals[mesh.used]
    across = np.einsum("ij,ij->i", twice, normals)
    along = twice - across[:, None] * normals
    lengths = np.abs(across), (along**2).sum(axis=1)
    low, squared = (float(np.quantile(length, 0.25)) for length in lengths)
    return _Noise(
        low / 0.31864, float(np.sqrt(squared / 0.57536)), folded
    )  # quartiles of |N(0, 1)|, and of two squares


def _cut_off(points: FloatArray, mesh: _Mesh, variance: float) -> tuple[FloatArray, float]:
    """Drop all frequencies above that with the least unbiased risk (Stein); return it as a share of the noise's.

    Frequencies are those of the walk to a neighbour. The trace that the risk needs is that of a lattice of triangles.
    Where the high frequencies hold about as much as noise of `variance`, they say how much exactly.
    """
    theta = np.pi * (np.arange(4 * _DEGREE) + 0.5) / (4 * _DEGREE)
    waves = np.cos(np.outer(theta, np.arange(2 * _DEGREE + 1)))
    energy = _energy(_data_moments(points, mesh), waves) / (variance * len(mesh.at))
    lattice = _lattice(len(theta))
    high = (1 - waves[:, : _DEGREE + 1] @ _step_series(_HIGH)) ** 2
    measured = (high @ energy) / (high @ lattice)
    if abs(measured - 1) < _ALIKE:
        energy /= measured
    best, chosen = np.inf, np.zeros(0)
    for cut in _CUTS:
        series = _step_series(float(cut))
        response = waves[:, : _DEGREE + 1] @ series
        risk = (1 - response) ** 2 @ energy - 1 + 2 * response @ lattice
        if risk < best:
            best, chosen = risk, series
    return _apply_series(points, mesh, chosen), float(best)


def _energy(moments: FloatArray, waves: FloatArray) -> FloatArray:
    """Weights of angles whose sums give a polynomial's mean under the data's moments, exactly up to their degree."""
    moments = np.where(np.arange(len(moments)) > 0, 2.0, 1.0) * moments
    return np.asarray(waves @ moments / len(waves))


def _data_moments(points: FloatArray, mesh: _Mesh) -> FloatArray:
    """``xᵀ D T_k(P) x`` for k up to twice the degree: T_i T_j = (T_(i+j) + T_(i-j)) / 2."""
    moments = np.empty(2 * _DEGREE + 1)
    before, now = points, _walked(points, mesh)
    moments[0], moments[1] = _mesh.inner(before, before, mesh.start), _mesh.inner(before, now, mesh.start)
    moments[2] = 2 * _mesh.inner(now, now, mesh.start) - moments[0]
    spare = np.empty_like(points)
    for k in range(1, _DEGREE):
        _mesh.walk(now, before, mesh.faces, mesh.start, mesh.at, False, spare)
        before, now, spare = now, spare, (np.empty_like(points) if k == 1 else before)
        moments[2 * k + 1] = 2 * _mesh.inner(now, before, mesh.start) - moments[1]
        moments[2 * k + 2] = 2 * _mesh.inner(now, now, mesh.start) - moments[0]
    return moments


def _lattice(bins: int) -> FloatArray:
    """Share of the walk's spectrum in each bin of 0 to π, on the lattice of triangles: from its plane waves."""
    wave = 2 * np.pi * (np.arange(128) + 0.5) / 128
    a, b = wave[:, None], wave[None, :]
    counts, _ = np.histogram(np.arccos((np.cos(a) + np.cos(b) + np.cos(a + b)) / 3), bins, (0, np.pi))
    return np.asarray(counts / counts.sum())


def _step_series(cut: float) -> FloatArray:
    """Chebyshev series of the step that keeps angles below `cut`, damped so that it does not ring (Jackson)."""
    k, m = np.arange(_DEGREE + 1), _DEGREE + 2
    damping = ((m - k) * np.cos(np.pi * k / m) + np.sin(np.pi * k / m) / np.tan(np.pi / m)) / m
    step = np.where(k > 0, 2 * np.sin(k * cut) / (np.pi * np.maximum(k, 1)), cut / np.pi)
    return np.asarray(step * damping / (step @ damping))  # what is constant stays


def _apply_series(points: FloatArray, mesh: _Mesh, series: FloatArray) -> FloatArray:
    before, now, spare = points, _walked(points, mesh), np.empty_like(points)
    out = series[0] * points + series[1] * now
    for k in range(2, len(series)):
        _mesh.walk(now, before, mesh.faces, mesh.start, mesh.at, False, spare)
        before, now, spare = now, spare, (np.empty_like(points) if k == 2 else before)
        _mesh.add_scaled(now, series[k], out)
    out[~mesh.used] = points[~mesh.used]
    return np.asarray(out)


def _lost(points: FloatArray, moved: FloatArray, mesh: _Mesh) -> FloatArray:
    """Mean square (N, 1), around each vertex, of the average of what was taken off: of noise little is left there."""
    normals = _normals_at_vertices(_measure(moved, mesh), mesh)
    across = np.repeat(((points - moved) * normals).sum(axis=1, keepdims=True), 3, axis=1)
    square = _averaged(across, mesh, 2) ** 2
    return _averaged(square, mesh, _FAR)[:, :1]


def _averaged(values: FloatArray, mesh: _Mesh, rounds: int) -> FloatArray:
    """Values (N, 3) averaged with those around, again and again."""
    for _ in range(rounds):
        values = (values + 2 * _walked(values, mesh)) / 3
    return values


def _sharpen(
    points: FloatArray, mesh: _Mesh, gain: FloatArray, level: float, strength: _Strength, slides: bool
) -> FloatArray:
    """Filter normals under guidance, let the vertices follow, again and again; `level` is the noise in mean edges."""
    moved = points.copy()
    now = _measure(moved, mesh)
    guide, filtered = np.empty_like(now.normals), np.empty_like(now.normals)
    corners = np.empty((len(mesh.faces), 3, 3))
    reach = _REACH * _ring_distance(now.centres, mesh)
    slide = np.where(mesh.border, 0.0, _SLIDE)
    pull = min(_PULL / level, 0.5)
    rounds, width = (base + more * min(level, 1.0) for base, more in (strength.rounds, strength.width))
    for _ in range(round(rounds)):
        now = _measure(moved, mesh, now)
        _mesh.guide_normals(now.normals, now.areas, mesh.begin, mesh.near, guide)
        _mesh.average_normals(now.normals, guide, now.centres, now.areas, mesh.begin, mesh.near, reach, width, filtered)
        if slides:
            _mesh.slide_vertices(moved, now.centres, filtered, mesh.start, mesh.at, slide)
        else:
            moved += pull * (points - moved)
        _mesh.corner_normals(filtered, now.angles, mesh.faces, mesh.start, mesh.at, strength.corner, corners)
        _mesh.follow_normals(moved, mesh.faces, mesh.start, corners, gain, strength.moves)
    return moved


def _ring_distance(centres: FloatArray, mesh: _Mesh) -> float:
    """Mean distance from a face's centre to those of the faces around it."""
    own = np.repeat(centres, np.diff(mesh.begin), axis=0)
    steps = np.linalg.norm(centres[mesh.near] - own, axis=1)
    return float(steps.mean()) if len(steps) else 1.0


def _checked_points(xyz: ArrayLike) -> FloatArray:
    points = real_array(xyz, "xyz", "(N, 3)")
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"xyz is {points.dtype} of shape {points.shape}, expected (N, 3) real numbers")
    points = np.ascontiguousarray(points, dtype=np.float64).copy()
    bad = np.flatnonzero(~(np.abs(points) <= _LARGEST).all(axis=1))
    if len(bad):
        raise InputError(
            f"xyz is {points[bad[0]].tolist()} at vertex {bad[0]}, expected finite, at most {_LARGEST:g} m"
        )
    return points


def _checked_faces(faces: ArrayLike, n: int) -> Index:
    array = real_array(faces, "faces", "(F, 3)")
    if array.shape == (0,):
        return np.empty((0, 3), np.int32)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "iu":
        raise InputError(f"faces is {array.dtype} of shape {array.shape}, expected (F, 3) integers")
    bad = np.flatnonzero(((array < 0) | (array >= n)).any(axis=1))
    if len(bad):
        hint = ": they look counted from 1, so give faces - 1" if array.min() == 1 and array.max() == n else ""
        raise InputError(f"faces is {array[bad[0]].tolist()} at face {bad[0]}, expected vertices in 0..{n - 1}{hint}")
    return np.ascontiguousarray(array, dtype=np.int32).copy()


def _checked_covariance(covariance: ArrayLike | None, n: int) -> FloatArray:
    """Covariances over the largest of all their entries, or nothing."""
    if covariance is None:
        return np.empty((0, 3, 3))
    array = real_array(covariance, "covariance", "(N, 3, 3)")
    if array.shape != (n, 3, 3):
        raise InputError(f"covariance is {array.dtype} of shape {array.shape}, expected ({n}, 3, 3) real numbers")
    matrices = array.astype(np.float64)
    largest = np.abs(matrices).max(initial=0.0)
    if not np.isfinite(largest):
        raise InputError("covariance is not finite, expected finite values, m²")
    matrices = matrices / (largest or 1.0)
    turned = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2))
    bad = np.flatnonzero((turned > _ROUNDING) | (np.linalg.eigvalsh(matrices)[:, 0] < -_ROUNDING))
    if len(bad):
        raise InputError(f"covariance is not symmetric and positive semidefinite at vertex {bad[0]}, expected so")
    return matrices


def _checked_noise(noise: float | None) -> float | None:
    if noise is None:
        return None
    value = real_array(noise, "noise", "a single number, m, one of the")
    if value.shape != () or isinstance(noise, bool) or not 0 <= float(value) <= _LARGEST:
        raise InputError(f"noise is {repr(noise)[:60]}, expected a number from 0 to {_LARGEST:g}, m")
    return float(value)
