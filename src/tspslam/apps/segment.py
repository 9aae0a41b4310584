"""Segment a surface: neighbouring faces that lie in one plane, or look alike, become one region."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._checks import real_array, require, told
from ..errors import InputError
from ..topology.complex import Complex
from ..topology.laplacian import checked_mask
from ..types import Bank, BoolArray, FloatArray, Response, Signals

Labels = NDArray[np.int32]

# Chosen, where nothing else is said, on rooms, corridors and streets of seeds 100 to 104.
MERGE = 5.0  # energy for each edge of border up to which regions merge at scale 1
LUMINANCE = 0.05  # weight of a face, where a point has 1: 0.025, 0.05, 0.1, 0.2 give an F of 0.64, 0.63, 0.61, 0.60
TEXTURE = 0.03  # weight of all responses together; 0.1 costs 0.05 of F there, 0.03 up to 0.03
DARKEST = 3e-3  # variance of luminance, (5 %)², below which a region is of one colour; 1e-3 gives the same to 0.01
EVEN = 0.05  # of a response's variance over the complex, below which a region has one texture; by hand
STEP = 0.15  # of luminance over an edge at which it joins 1/e as much; 0.08 loses 0.01 of F, 0.3 as much
JOINS = 0.1  # what is left of an edge in any step
LEAST_NOISE = 0.02  # of the mean length of edges: positions without a covariance are not better known; by hand
LARGEST = 1e75  # whose squares are numbers, and the squares of these
NOT_UNIT = 1e-3  # off 1: rounding to float32 and to text stays within


class _Evidence(NamedTuple):
    """Sums of each face, and the weight and floor of each feature in them."""

    sums: FloatArray
    weight: FloatArray
    floor: FloatArray


def segment(
    complex_: Complex,
    signals: Signals | None,
    response: Response | Bank | None = None,
    normals: ArrayLike | None = None,
    scale: float = 1.0,
    *,
    xyz: ArrayLike | None = None,
    covariance: ArrayLike | None = None,
) -> Labels:
    """Group faces into connected regions of one plane, one luminance and one texture each.

    Parameters
    ----------
    complex_ : Complex
        Triangles.
    signals : Signals or None
        Luminance on the complex, (n,) or (n, C); what is marked is not looked at. None: shape alone.
    response : Response or Bank, optional
        Texture: magnitudes at the vertices; where it is not defined it is not looked at.
    normals : (F, 3) or (N, 3) float array, optional
        Unit normals of faces or of vertices (of faces, if there are as many); NaN where not known. Regions then have
        one normal.
    scale : float
        Above 0; larger gives fewer regions, and those of a smaller one are never split: two neighbours merge if the
        energy that this costs, for each edge between them, is at most 5 times `scale`.
    xyz : (N, 3) float array, optional
        Positions, any unit; NaN where not known. Regions are then planes.
    covariance : (N, 3, 3) float array, optional
        Of `xyz`, its unit squared: ``cloud.covariance``. Without it, the noise is measured on the surface itself.

    Returns
    -------
    (F,) int32
        Regions 0..k-1, numbered by their first faces. Each is connected over edges.

    Raises
    ------
    InputError
        If an argument is not as described.

    Notes
    -----
    The energy of a region of n points, of mean square distance λ to its best plane (in units of their noise), and of
    variances v of luminance is ``n log(1 + λ) + 0.05 m log(1 + v / 0.003)`` with m its pixels over the mean pixels of a
    face; responses and normals add like terms. An edge counts by its pixels, less where luminance steps over it: to a
    tenth. A face without any signal goes where it costs least.

    `merge_cells` wants discs; a region may have holes. `disc_labels` cuts it.

    Examples
    --------
    >>> import numpy as np
    >>> from tspslam import build_complex, sample_signals
    >>> image = np.zeros((41, 81))
    >>> image[:, 41:] = 1
    >>> ladder = build_complex([[0, 1, 4], [0, 3, 4], [1, 2, 5], [1, 4, 5]])
    >>> uv = [[0, 0], [40, 0], [80, 0], [0, 40], [40, 40], [80, 40]]
    >>> segment(ladder, sample_signals(image, uv, ladder), scale=0.1).tolist()
    [0, 0, 1, 1]
    """
    from . import _segment

    signals = _check_complex(complex_, signals)
    limit = MERGE * _checked_scale(scale)
    sums, weight, floor = _gathered(complex_, signals, response, normals, _positions(complex_, xyz, covariance))
    pairs, edge = _segment.pairs_at_edges(complex_.face_edges, len(complex_.edges))
    tree = _segment.merge_tree(sums, pairs, _length(signals, pairs, edge), weight, floor)
    labels: Labels = _segment.cut_tree(*tree, len(complex_.faces), limit)
    return labels


def disc_labels(complex_: Complex, labels: ArrayLike) -> Labels:
    """Cut regions into discs, as `merge_cells` wants them: rings and closed surfaces fall into several.

    Parameters
    ----------
    complex_ : Complex
        Triangles.
    labels : (F,) integers
        Regions.

    Returns
    -------
    (F,) int32
        Discs 0..k-1, numbered by their first faces; each lies within one region.

    Raises
    ------
    InputError
        If the complex has cells already, or the labels do not fit.

    Examples
    --------
    >>> from tspslam import build_complex, merge_cells
    >>> tetrahedron = build_complex([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]], 4)
    >>> labels = disc_labels(tetrahedron, [0, 0, 0, 0])
    >>> labels.tolist(), len(merge_cells(tetrahedron, labels).faces)
    ([0, 0, 0, 1], 2)
    """
    from ..topology._stars import vertex_neighbours
    from . import _segment

    _check_triangles(complex_)
    values: NDArray[Any] = np.asarray(labels)
    if values.shape != (len(complex_.faces),) or (values.size and values.dtype.kind not in "iu"):
        raise InputError(f"labels are {told(values)}, expected ({len(complex_.faces)},) integers")
    pairs, _ = _segment.pairs_at_edges(complex_.face_edges, len(complex_.edges))
    graph = vertex_neighbours(len(values), pairs)
    named = np.unique(values, return_inverse=True)[1].astype(np.int64)
    discs: Labels = _segment.grow_discs(
        complex_.faces, complex_.face_edges, graph, complex_.n, len(complex_.edges), named
    )
    return discs


def _length(signals: Signals, pairs: NDArray[np.int64], edge: NDArray[np.int64]) -> FloatArray:
    """How much each edge joins its faces: the root of its pixels over their mean, less where luminance steps."""
    pixels, ok = signals.edge_pixels[edge].astype(np.float64), signals.edge_ok[edge]
    size = np.where(ok & (pixels > 0), np.maximum(pixels, 1) / max(pixels[ok].mean(), 1) if ok.any() else 1.0, 1.0)
    if not signals.face.size:
        return np.sqrt(size)
    face = signals.face.reshape(len(signals.face), -1)
    square = ((face[pairs[:, 0]] - face[pairs[:, 1]]) ** 2).mean(axis=1)
    both = signals.face_ok[pairs].all(axis=1)
    return np.asarray(np.sqrt(size) * np.where(both, JOINS + (1 - JOINS) * np.exp(-square / STEP**2), 1.0))


def _check_triangles(complex_: Complex) -> None:
    require(complex_, Complex, "complex_")
    if not isinstance(complex_.faces, np.ndarray):
        raise InputError("complex: its faces are polygons, expected triangles")


def _check_complex(complex_: Complex, signals: Signals | None) -> Signals:
    """The signals, which must fit; marked ones where none are given."""
    _check_triangles(complex_)
    if signals is None:
        return _unknown(complex_)
    require(signals, Signals, "signals")
    found = len(signals.vertex), len(signals.edge), len(signals.face)
    wanted = complex_.n, len(complex_.edges), len(complex_.faces)
    if found != wanted:
        raise InputError(f"signals are on {found} vertices, edges and faces, expected {wanted}")
    face_ok, edge_ok = checked_mask(signals.face_ok, found[2]), checked_mask(signals.edge_ok, found[1])
    face = np.where(face_ok if signals.face.ndim == 1 else face_ok[:, None], signals.face, 0.0)
    bad = np.flatnonzero(~(np.abs(face) <= LARGEST).all(axis=tuple(range(1, face.ndim))))
    if len(bad):
        said = f"signals: face {bad[0]} has {signals.face[bad[0]]}"
        raise InputError(f"{said}, expected a number up to {LARGEST:g}, or face_ok False where it is not known")
    return replace(signals, face=face, face_ok=face_ok, edge_ok=edge_ok)


def _unknown(complex_: Complex) -> Signals:
    """Signals of a complex of which no luminance is known."""
    n, E, F = complex_.n, len(complex_.edges), len(complex_.faces)
    return Signals(
        vertex=np.zeros(n), edge=np.zeros(E), face=np.zeros(F), edge_uv=np.zeros((E, 2)), face_uv=np.zeros((F, 2)),
        edge_pixels=np.zeros(E, np.int32), face_pixels=np.zeros(F, np.int32),
        vertex_ok=np.zeros(n, np.bool_), edge_ok=np.zeros(E, np.bool_), face_ok=np.zeros(F, np.bool_),
    )  # fmt: skip


def _checked_scale(scale: float) -> float:
    value = real_array(scale, "scale", "a single number, one of the")
    if isinstance(scale, bool) or value.ndim or not (np.isfinite(value) and value > 0):
        raise InputError(f"scale is {scale!r:.60}, expected a number above 0")
    return float(value)


class _Points(NamedTuple):
    """Positions, their covariances, and which are known."""

    xyz: FloatArray
    covariance: FloatArray
    known: BoolArray


def _checked_rows(values: ArrayLike, what: str, shapes: tuple[tuple[int, ...], ...]) -> tuple[FloatArray, BoolArray]:
    """Finite rows, those with NaN set to 0, and which had none."""
    expected = " or ".join(str(shape) for shape in shapes)
    rows = real_array(values, what, expected).astype(np.float64)
    if rows.shape not in shapes:
        raise InputError(f"{what} has shape {rows.shape}, expected {expected}")
    known: BoolArray = ~np.asarray(np.isnan(rows).any(axis=tuple(range(1, rows.ndim))))
    bad = np.flatnonzero((np.abs(rows) > LARGEST).any(axis=tuple(range(1, rows.ndim))))
    if len(bad):
        raise InputError(f"{what}: row {bad[0]} has numbers over {LARGEST:g}, expected smaller, or NaN where not known")
    rows[~known] = 0
    return rows, known


def _positions(complex_: Complex, xyz: ArrayLike | None, covariance: ArrayLike | None) -> _Points | None:
    """Positions about their middle in mean lengths of edges, with the covariance that was given or measured."""
    if xyz is None:
        if covariance is not None:
            raise InputError("covariance is given without xyz, expected the positions that it belongs to")
        return None
    points, known = _checked_rows(xyz, "xyz", ((complex_.n, 3),))
    points = np.where(known[:, None], points - points[known].mean(axis=0), 0) if known.any() else points
    edges = complex_.edges[known[complex_.edges].all(axis=1)]
    length = _lengths(points, edges)
    unit = float(length[length > 0].mean()) if (length > 0).any() else 1.0
    points, length = points / unit, length / unit
    if covariance is None:
        noise, surely = np.zeros((complex_.n, 3, 3)), known
        least = max(_roughness(points, edges, length), LEAST_NOISE) * length
    else:
        noise, surely = _checked_rows(covariance, "covariance", ((complex_.n, 3, 3),))
        if (np.diagonal(noise, axis1=1, axis2=2) < 0).any():
            raise InputError("covariance has negative variances, expected symmetric positive matrices")
        noise /= unit**2
        least = 1e-3 * length  # of known noise nothing is added; none at all would weigh without bound
    return _Points(points, noise + (least**2)[:, None, None] * np.eye(3), known & surely & (length > 0))


def _lengths(xyz: FloatArray, edges: NDArray[np.int32]) -> FloatArray:
    """Mean length of the edges at each vertex; 0 where there is none."""
    degree = np.bincount(edges.ravel(), minlength=len(xyz))
    length = np.repeat(np.linalg.norm(xyz[edges[:, 0]] - xyz[edges[:, 1]], axis=1), 2)
    mean: FloatArray = np.bincount(edges.ravel(), length, len(xyz)) / np.maximum(degree, 1)
    return mean


def _roughness(xyz: FloatArray, edges: NDArray[np.int32], length: FloatArray) -> float:
    """Noise across the surface in mean lengths of edges: the median over the vertices."""
    from . import _segment

    spread = _segment.ring_spread(edges, xyz, np.bincount(edges.ravel(), minlength=len(xyz)))
    inner = (spread >= 0) & (length > 0)
    return float(np.median(spread[inner] / length[inner])) if inner.any() else 0.0


def _gathered(
    complex_: Complex,
    signals: Signals,
    response: Response | Bank | None,
    normals: ArrayLike | None,
    points: _Points | None,
) -> _Evidence:
    """All that is known of each face."""
    from . import _segment

    features = [*_luminance(signals), *_textures(complex_, response)]
    sums = np.zeros((len(complex_.faces), _segment.GEOMETRY + 3 * len(features)))
    if points is not None:
        share = points.known / np.maximum(np.bincount(complex_.faces.ravel(), minlength=complex_.n), 1)
        _segment.add_corners(complex_.faces, points.xyz, points.covariance, share, sums)
    if normals is not None:
        sums[:, _segment.NORMALS : _segment.GEOMETRY] = _checked_normals(complex_, normals)
    for k, (value, amount, _, _) in enumerate(features):
        columns = [amount, amount * value, amount * value**2]
        sums[:, _segment.GEOMETRY + 3 * k : _segment.GEOMETRY + 3 * k + 3] = np.stack(columns, axis=1)
    weight, floor = np.array([feature[2:] for feature in features]).reshape(-1, 2).T.copy()
    return _Evidence(sums, weight, floor)


class _Feature(NamedTuple):
    """A value of each face, how much it counts, 0 where it is not known, its weight and its variance in one region."""

    value: FloatArray
    amount: FloatArray
    weight: float
    floor: float


def _luminance(signals: Signals) -> list[_Feature]:
    """Means of faces, which count by their pixels; those of less than one pixel, as if they had one."""
    ok = signals.face_ok
    pixels = np.where(ok, np.maximum(signals.face_pixels, 1), 0).astype(np.float64)
    count = pixels / max(pixels[ok].mean(), 1) if ok.any() else pixels
    channels = signals.face.reshape(len(ok), -1).T if len(ok) else np.zeros((0, 0))
    return [_Feature(np.ascontiguousarray(values), count, LUMINANCE / len(channels), DARKEST) for values in channels]


def _textures(complex_: Complex, response: Response | Bank | None) -> list[_Feature]:
    """Mean magnitudes over the corners of each face where they are defined."""
    if response is None:
        return []
    if not isinstance(response, Response | Bank):
        raise InputError(
            f"response is {told(response)}, expected a Response or a Bank, such as tspslam.tmahf_bank gives"
        )
    if len(response.z) != complex_.n:
        raise InputError(f"response is at {len(response.z)} vertices, expected {complex_.n}")
    magnitude, defined = np.abs(response.z), response.defined
    while defined.ndim < magnitude.ndim:  # all channels are defined where one is
        defined = defined[..., None]
    known = np.broadcast_to(defined, magnitude.shape).reshape(complex_.n, -1)
    columns = zip(magnitude.reshape(complex_.n, -1).T, known.T, strict=True)
    return [_texture(complex_, values, ok, TEXTURE / known.shape[1]) for values, ok in columns]


def _texture(complex_: Complex, magnitude: FloatArray, defined: BoolArray, weight: float) -> _Feature:
    corners = defined[complex_.faces]
    value = np.where(corners, magnitude[complex_.faces], 0).sum(axis=1) / np.maximum(corners.sum(axis=1), 1)
    count = (corners.sum(axis=1) / 3).astype(np.float64)
    spread = float(value[count > 0].var()) if (count > 0).any() else 0.0
    return _Feature(value, count, weight, max(EVEN * spread, np.finfo(float).tiny))


def _checked_normals(complex_: Complex, normals: ArrayLike) -> FloatArray:
    """How many normals each face has, 0 or 1, and the normal, (F, 4)."""
    faces = complex_.faces
    rows, known = _checked_rows(normals, "normals", ((len(faces), 3), (complex_.n, 3)))
    bad = np.flatnonzero(known & (np.abs(np.linalg.norm(rows, axis=1) - 1) > NOT_UNIT))
    if len(bad):
        raise InputError(f"normals: row {bad[0]} has length {np.linalg.norm(rows[bad[0]]):.4g}, expected 1")
    if len(rows) != len(faces):
        rows = rows[faces].sum(axis=1)
        size = np.linalg.norm(rows, axis=1)
        known = size > NOT_UNIT
        rows /= np.where(known, size, 1)[:, None]
    return np.column_stack([known, rows * known[:, None]])
