"""Multiscale anisotropic harmonic filter on the vertices of a mesh (MAHF), eqs (9)-(11): the paper's baseline."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._threads import thread_count
from ..errors import InputError
from ..types import Bank, BoolArray, FloatArray, IntArray, Response, Surface, real_array
from .complex import build_complex
from .harmonic import check_responses, checked_bank, checked_order
from .laplacian import check_values, checked_mask, parts_of
from .spectral import LARGEST_DENSE, checked_number, heat_series
from .spectrum import spectrum

if TYPE_CHECKING:
    from scipy.sparse import csr_array

Method = Literal["chebyshev", "eigs", "exact"]
Kind = Literal["conformal", "graph", "robust"]
Modes = NDArray[np.int64]
Responses = NDArray[np.complex128]

_LADDER = 1.15  # step between the spectral bounds for which coefficients are computed
_FARTHEST = 1e9  # m
_CHUNK = 2048  # vertices a thread takes; fixed, so that results do not depend on the number of threads


def mahf(
    surface: Surface | ArrayLike,
    xyz: ArrayLike,
    signal: ArrayLike,
    order: int = 1,
    t: float = 1.0,
    method: Method = "chebyshev",
    laplacian: Kind = "conformal",
    *,
    ok: ArrayLike | None = None,
    error: float = 1e-5,
    eigenpairs: int = 200,
) -> Response:
    r"""Multiscale anisotropic harmonic filter at every vertex, eqs (9)-(11).

    .. math:: r_i = \sum_j K_t(i, j) \, e^{j m \varphi(i, j)} \, s_j, \qquad K_t = e^{-tL}

    where φ is the angle of the edge from i to j in the tangent plane at i; j = i counts for m = 0 only.

    Parameters
    ----------
    surface : Surface or (F, 3) integers
        Triangles; need not be a manifold.
    xyz : (N, 3) float array
        Vertices in the camera's frame, m. The camera, at 0, decides what is up in each tangent plane.
    signal : (N,) or (N, C) float array
        Unsigned values, such as the luminance; finite.
    order : int
        Angular order, 0 <= m <= 1000.
    t : float
        Diffusion time, >= 0.
    method : {"chebyshev", "eigs", "exact"}
        "chebyshev": rows of the kernel by polynomials on patches around the vertices, as large as the heat reaches;
        linear in N. "eigs": the lowest `eigenpairs`, which leave out what has decayed least for short times.
        "exact": all of them, for at most 4000 vertices.
    laplacian : {"conformal", "graph", "robust"}
        "conformal": ``C_ij = -½ Σ cot`` over the faces at the edge, each cot clamped to ±1000; "graph": ``L0``, binary
        weights; "robust": that of robust_laplacian (extra ``mesh``), for meshes that are hardly any.
    ok : (N,) bool, optional
        Vertices with a signal; the others are left out of every sum and not `defined`.
    error : float
        For "chebyshev": how much of a row of the kernel may be missing, as a sum of magnitudes.
    eigenpairs : int
        For "eigs": how many.

    Returns
    -------
    Response
        (N,) or (N, C); 0 and not `defined` at vertices without a signal or without a face.

    Raises
    ------
    InputError
        If an argument is not as described, a face leaves the vertices, or the cotangents of slivers, clamped, give
        the Laplacian negative eigenvalues, with which heat grows without bound.

    Examples
    --------
    On a plane before the camera the response turns with the ramp of the signal:

    >>> from scipy.spatial import Delaunay
    >>> uv = np.random.default_rng(0).random((100, 2))
    >>> faces = Delaunay(uv).simplices
    >>> xyz = np.column_stack([uv, np.ones(100)])
    >>> response = mahf(faces, xyz, xyz[:, 1], laplacian="graph")
    >>> inside = np.abs(uv - 0.5).max(axis=1) < 0.2
    >>> bool(abs(np.median(response.phase[inside]) - np.pi / 2) < 0.3)
    True
    """
    bank = mahf_bank(
        surface, xyz, signal, (order,), (t,), method, laplacian, ok=ok, error=error, eigenpairs=eigenpairs
    )  # fmt: skip
    return bank[0]


def mahf_bank(
    surface: Surface | ArrayLike,
    xyz: ArrayLike,
    signal: ArrayLike,
    orders: Sequence[int] = (0, 1, 2),
    scales: Sequence[float] = (1.0,),
    method: Method = "chebyshev",
    laplacian: Kind = "conformal",
    *,
    ok: ArrayLike | None = None,
    error: float = 1e-5,
    eigenpairs: int = 200,
) -> Bank:
    """MAHF of several orders and times at once: the kernel is computed once.

    Parameters
    ----------
    surface, xyz, signal, method, laplacian, ok, error, eigenpairs
        As `mahf`.
    orders : sequence of int
        Angular orders m.
    scales : sequence of float
        Diffusion times t.

    Returns
    -------
    Bank
        (N, K) or (N, K, C), K = len(scales) · len(orders): all orders of the first scale, then of the next.

    Raises
    ------
    InputError
        As `mahf`, or if there is no order or no scale.

    Examples
    --------
    >>> corner = [[0, 0, 1], [1, 0, 1], [0, 1, 1.0]]
    >>> bank = mahf_bank([[0, 1, 2]], corner, [0, 1, 0], scales=(0.1, 1), laplacian="graph")
    >>> bank.z.shape, bank.scales.tolist()
    ((3, 6), [0.1, 0.1, 0.1, 1.0, 1.0, 1.0])
    """
    mesh = _checked_mesh(surface, xyz)
    values, kept = _checked_signal(signal, len(mesh.xyz), ok)
    modes, times = _checked_modes(orders, scales)
    check_responses(values.size * len(modes) * len(times), "mahf")
    L = _laplacian(mesh, laplacian)
    z = np.zeros((len(values), len(times), len(modes), values.shape[1]), np.complex128)
    if method == "chebyshev":
        _by_patches(mesh, L, times, checked_number(error, "error", 1e-12, 1), values, modes, z)
    else:
        _by_eigenpairs(mesh, _pairs(L, method, eigenpairs), times, values, modes, z)
    defined = kept & mesh.has_face
    z[~defined] = 0
    shape = (len(values), len(times) * len(modes), *np.shape(signal)[1:])
    return Bank(
        z.reshape(shape), np.tile(modes, len(times)), np.repeat(times, len(modes)), np.tile(defined[:, None], shape[1])
    )


def conformal_laplacian(surface: Surface | ArrayLike, xyz: ArrayLike) -> csr_array:
    """``C_ij = -½ Σ cot`` over the faces at edge (i, j), each cotangent clamped to ±1000; rows sum to 0.

    Parameters
    ----------
    surface : Surface or (F, 3) integers
        Triangles.
    xyz : (N, 3) float array
        Vertices, any unit.

    Returns
    -------
    (N, N) csr_array of float64
        Symmetric; positive semidefinite unless slivers were clamped.

    Raises
    ------
    InputError
        If the faces do not fit the vertices, or a vertex is not finite.

    Examples
    --------
    >>> conformal_laplacian([[0, 1, 2]], [[0, 0, 1], [1, 0, 1], [0, 1, 1.0]]).toarray().round(9).tolist()
    [[1.0, -0.5, -0.5], [-0.5, 0.5, 0.0], [-0.5, 0.0, 0.5]]
    """
    return _laplacian(_checked_mesh(surface, xyz), "conformal")


class _Mesh(NamedTuple):
    """A checked mesh: faces (F, 3) int32, vertices (N, 3), tangent axes (N, 6): t1, then t2."""

    faces: NDArray[np.int32]
    xyz: FloatArray
    axes: FloatArray
    has_face: BoolArray


def _checked_mesh(surface: Surface | ArrayLike, xyz: ArrayLike) -> _Mesh:
    points = np.ascontiguousarray(real_array(xyz, "xyz", "(N, 3)"), np.float64)
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"xyz has shape {points.shape}, expected (N, 3)")
    bad = np.flatnonzero(~(np.abs(points) <= _FARTHEST).all(axis=1))
    if len(bad):
        raise InputError(f"xyz is {points[bad[0]].tolist()} at vertex {bad[0]}, expected at most {_FARTHEST:g}")
    faces = surface.faces if isinstance(surface, Surface) else surface
    build_complex(faces, len(points))  # refuses what is no triangle of these vertices
    triangles = np.ascontiguousarray(np.reshape(faces, (-1, 3)), np.int32)
    has_face = np.zeros(len(points), bool)
    has_face[triangles] = True
    return _Mesh(triangles, points, tangent_axes(points, triangles), has_face)


def tangent_axes(xyz: FloatArray, faces: IntArray) -> FloatArray:
    """Axes t1 and t2 of the tangent plane at each vertex; seen from the camera, t1 points right, t2 down.

    The normal is the area-weighted sum of those of the faces, turned away from the camera; without one, the line of
    sight.

    Parameters
    ----------
    xyz : (N, 3) float64
        Vertices in the camera's frame, m.
    faces : (F, 3) integers
        Vertex triples.

    Returns
    -------
    (N, 6) float64
        t1, then t2, of unit length.
    """
    from . import _mahf

    normal = np.zeros_like(xyz)
    _mahf.add_normals(xyz, faces, normal)
    normal = normalised(normal, normalised(xyz, np.array([0.0, 0.0, 1.0])))
    x, y = np.eye(3)[:2]
    first = normalised(x - normal[:, :1] * normal, x)
    second = np.cross(normal, first)
    steep = np.abs(normal[:, 0]) > 0.99
    second[steep] = normalised(y - normal[steep, 1:2] * normal[steep], y)
    first[steep] = np.cross(second[steep], normal[steep])
    return np.concatenate([first, second], axis=1)


def normalised(vectors: FloatArray, otherwise: FloatArray) -> FloatArray:
    """Scale vectors to length 1; one without a length is replaced by another.

    Parameters
    ----------
    vectors : (n, 3) float64
        Of any length.
    otherwise : (3,) or (n, 3) float64
        What replaces those of length 0.

    Returns
    -------
    (n, 3) float64
    """
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), otherwise)


def _checked_signal(signal: ArrayLike, n: int, ok: ArrayLike | None) -> tuple[FloatArray, BoolArray]:
    """The signal (N, C), 0 where there is none, and where there is one."""
    values = real_array(signal, "signal", f"({n},) or ({n}, C)")
    if values.ndim not in (1, 2) or len(values) != n:
        raise InputError(f"signal is {values.dtype} of shape {values.shape}, expected ({n},) or ({n}, C)")
    kept = np.ones(n, bool) if ok is None else checked_mask(ok, n)
    columns = np.where(kept[:, None], values.reshape(n, -1 if values.size else 0), 0).astype(np.float64)
    check_values(columns, "signal", "vertex")
    return np.ascontiguousarray(columns), kept


def _checked_modes(orders: Sequence[int], scales: Sequence[float]) -> tuple[Modes, FloatArray]:
    orders, scales = checked_bank(orders, scales, "mahf")
    modes = np.array([checked_order(order, "mahf") for order in orders], np.int64)
    return modes, np.array([checked_number(t, "t") for t in scales], np.float64)


def _laplacian(mesh: _Mesh, kind: Kind) -> csr_array:
    if kind == "graph":
        return build_complex(mesh.faces, len(mesh.xyz)).L0
    if kind == "conformal":
        return _conformal(mesh)
    if kind == "robust":
        return _robust(mesh)
    raise InputError(f"laplacian is {kind!r}, expected 'conformal', 'graph' or 'robust'")


def _conformal(mesh: _Mesh) -> csr_array:
    from scipy.sparse import coo_array, csr_array, diags_array

    from . import _mahf

    halves = np.empty(mesh.faces.shape)
    _mahf.cotangent_weights(mesh.xyz, mesh.faces, halves)
    one, other = mesh.faces, np.roll(mesh.faces, -1, axis=1)
    rows, columns = (np.concatenate([a.ravel(), b.ravel()]) for a, b in ((one, other), (other, one)))
    n = len(mesh.xyz)
    weights = csr_array(coo_array((np.tile(halves.ravel(), 2), (rows, columns)), shape=(n, n)))
    return csr_array(diags_array(weights.sum(axis=1)) - weights)


def _robust(mesh: _Mesh) -> csr_array:
    from scipy.sparse import csr_array

    try:
        import robust_laplacian
    except ImportError as error:
        raise InputError("laplacian 'robust' needs robust_laplacian: pip install 'tspslam[mesh]'") from error
    used = np.flatnonzero(mesh.has_face)
    number = np.zeros(len(mesh.xyz), np.int64)
    number[used] = np.arange(len(used))
    n = len(mesh.xyz)
    if not len(used):
        return csr_array((n, n))
    try:
        small = robust_laplacian.mesh_laplacian(mesh.xyz[used], number[mesh.faces])[0].tocoo()
    except (RuntimeError, ValueError) as error:
        raise InputError(f"robust_laplacian cannot use this mesh: {error}") from error
    if not np.isfinite(small.data).all():
        raise InputError(
            "robust_laplacian cannot use this mesh: its weights are not finite, expected faces with an area"
        )
    return csr_array((small.data, (used[small.row], used[small.col])), shape=(n, n))


def _by_patches(
    mesh: _Mesh, L: csr_array, times: FloatArray, error: float, signal: FloatArray, modes: Modes, z: Responses
) -> None:
    """Fill the responses (N, S, M, C), chunk by chunk in an order in which neighbours come together."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    from . import _mahf

    if not L.shape[0]:
        return
    visit = reverse_cuthill_mckee(L, symmetric_mode=True).astype(np.int64)
    chunks = [visit[first : first + _CHUNK] for first in range(0, len(visit), _CHUNK)]
    matrix, table, field = parts_of(L), _series(L, times, error), (mesh.xyz, mesh.axes, signal)

    def work(chunk: NDArray[np.int64]) -> int:
        return int(_mahf.filter_patches(chunk, matrix, table, times.max(), error, field, modes, z))

    with ThreadPoolExecutor(max(1, min(len(chunks), thread_count()))) as pool:
        growing = [vertex for vertex in pool.map(work, chunks) if vertex >= 0]
    if growing:
        _refuse_growth(mesh, min(growing))


def _series(L: csr_array, times: FloatArray, error: float) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Half bounds of spectra, and for each the coefficients of all times (B, S, terms) and how many there are."""
    top = max(float(abs(L).sum(axis=1).max()) / 2 if L.nnz else 0.0, 0.25)
    steps = int(np.ceil(np.log(top / 0.25) / np.log(_LADDER)))
    ladder = top * _LADDER ** np.arange(-steps, 1.0)
    rungs = [[heat_series(half, t, 0.01 * error) for t in times] for half in ladder]
    lengths = np.array([max(map(len, rung)) for rung in rungs])
    series = np.zeros((len(ladder), len(times), lengths.max()))
    for b, rung in enumerate(rungs):
        for s, coefficients in enumerate(rung):
            series[b, s, : len(coefficients)] = coefficients
    return ladder, lengths, series


def _pairs(L: csr_array, method: str, count: int) -> tuple[FloatArray, FloatArray]:
    n = L.shape[0]
    if method == "exact":
        if n > LARGEST_DENSE:
            raise InputError(f"{n} vertices are too many for method 'exact', expected at most {LARGEST_DENSE}")
        values, vectors = np.linalg.eigh(L.toarray())
        return values, vectors
    if method != "eigs":
        raise InputError(f"method is {method!r}, expected 'chebyshev', 'eigs' or 'exact'")
    if n == 0:
        return np.zeros(0), np.zeros((0, 0))
    found = spectrum(L, min(count, n) if not isinstance(count, bool) else count)
    return found.values, found.vectors


def _by_eigenpairs(
    mesh: _Mesh, pairs: tuple[FloatArray, FloatArray], times: FloatArray, signal: FloatArray, modes: Modes, z: Responses
) -> None:
    """Fill the responses (N, S, M, C) from blocks of columns of ``U exp(-tΛ) Uᵀ``."""
    from . import _mahf

    values, vectors = pairs
    decay = np.exp(-times[:, None] * values)
    if not decay.max(initial=0) <= _mahf.LONGEST:
        _refuse_growth(mesh, int(np.abs(vectors[:, values.argmin()]).argmax()))
    for first in range(0, len(vectors), 256):
        heat = np.stack([(vectors * gain) @ vectors[first : first + 256].T for gain in decay])
        _mahf.filter_rows(first, heat, (mesh.xyz, mesh.axes, signal), modes, z)


def _refuse_growth(mesh: _Mesh, vertex: int) -> None:
    from . import _mahf

    halves = np.empty(mesh.faces.shape)
    _mahf.cotangent_weights(mesh.xyz, mesh.faces, halves)
    worst = int((halves * np.roll(halves, -1, axis=1)).sum(axis=1).argmin())
    sliver = f"face {worst} {mesh.faces[worst].tolist()} is a sliver whose cotangents were clamped"
    raise InputError(
        f"mahf: L has negative eigenvalues: heat grows at vertex {vertex}; {sliver}, expected a mesh without slivers, "
        "laplacian='graph' or laplacian='robust'"
    )
