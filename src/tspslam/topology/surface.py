"""Points to faces: Delaunay in the image, lifted to 3-D and cut where the depth steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .._checks import require, told
from .._settings import Checked, setting
from ..errors import GeometryError, InputError
from ..types import BoolArray, Cloud, FloatArray, Surface

_ROUNDING = 1e-6  # of inverse depth


@dataclass(frozen=True)
class DelaunaySurface(Checked, what="surface"):
    """Image Delaunay with depth cuts, as a stage.

    Attributes
    ----------
    max_depth_ratio : float
        A face jumps where the depth at one end of a side exceeds that at the other by more than this share of it.
    significance : float
        Only jumps larger than this many standard deviations of the difference count, where the cloud has a covariance;
        0 trusts every depth. A face that jumps stays if it continues the planes of all its neighbours, to within as
        many standard deviations: a slope, such as a road, is no step.
    min_angle : float
        Faces whose smallest image angle is below this are slivers, degrees; at most 60.

    Raises
    ------
    InputError
        If a setting is out of its range.

    Examples
    --------
    >>> xyz = np.array([[0.0, 0, 4], [1, 0, 4], [0, 1, 4], [1, 1, 9]])  # the last one is behind the others
    >>> uv = np.array([[0.0, 0], [25, 0], [0, 25], [30, 30]])
    >>> cloud = Cloud(xyz, uv, 100 / xyz[:, 2])
    >>> len(DelaunaySurface(max_depth_ratio=0.2)(cloud).faces), len(DelaunaySurface(max_depth_ratio=2)(cloud).faces)
    (1, 2)
    """

    max_depth_ratio: float = setting(
        0.08, 0.0, 1e9, unit="",
        source="Motorcycle's true depth: 0.04, 0.08, 0.16 leave 1753, 1878, 1928 good faces, 3, 4, 6 % over a step",
    )  # fmt: skip
    significance: float = setting(
        1.0, 0.0, 1e9, unit="standard deviations",
        source="Motorcycle's true depth: 0, 1, 2 leave 1855, 1878, 1889 good faces, 3.4, 3.9, 4.9 % over a step",
    )  # fmt: skip
    min_angle: float = setting(
        3.0, 0.0, 60.0, unit="degrees", source="by hand; Motorcycle: 0, 3, 6 leave 2250, 2236, 2205 faces"
    )

    def __call__(self, cloud: Cloud) -> Surface:
        """Triangulate `cloud`; see `delaunay_surface`."""
        _refuse(cloud)
        faces, neighbours = _triangulate(cloud.uv)
        keep = _smallest_angle(cloud.uv[faces]) >= np.radians(self.min_angle)
        jumps = np.flatnonzero(keep & _jumps(cloud, faces, self.max_depth_ratio, self.significance))
        keep[jumps] = _is_slope(cloud, faces, neighbours, jumps, self.significance)
        return Surface(faces[keep])


def delaunay_surface(cloud: Cloud, *, max_depth_ratio: float = 0.08, significance: float = 1.0) -> Surface:
    """Triangulate a cloud in the image, lift the triangles to 3-D and drop those that bridge a depth step.

    A step is a jump of depth along a side that is no slope: some neighbour is off the face's plane. (Inverse depth is
    linear over the image of a plane.)

    The Delaunay triangulation of the projections is a planar sheet; leaving faces out keeps every edge with at most
    two faces, so the surface is edge-manifold, with boundary; `pinched_vertices` says where cuts left two sheets that
    meet in a vertex only. Slivers go too.

    Parameters
    ----------
    cloud : Cloud
        N >= 3 points that one camera sees.
    max_depth_ratio : float
        A jump is a growth of depth along a side by more than this share of the nearer depth
    significance : float
        ... and by more than this many standard deviations of the difference, where the cloud has a covariance. A
        neighbour is off the plane if it is so by more than as many of its own.

    Returns
    -------
    Surface
        faces (F, 3) int32, counter-clockwise in (u, v), that is clockwise on the screen; F may be 0.

    Raises
    ------
    GeometryError
        If there are fewer than 3 points, or all of them lie on a line or at one place in the image.
    InputError
        If a position or covariance is not finite, a depth is not positive, shapes do not fit, or a setting is out of
        range.

    Examples
    --------
    >>> uv = np.array([[0., 0], [10, 0], [0, 10], [10, 10]])
    >>> cloud = Cloud(np.column_stack([uv, np.full(4, 5.0)]), uv, np.full(4, 20.0))
    >>> len(delaunay_surface(cloud).faces)
    2
    """
    return DelaunaySurface(max_depth_ratio, significance)(cloud)


def pinched_vertices(faces: NDArray[np.int32], n: int) -> NDArray[np.int64]:
    """Vertices at which an edge-manifold surface is not manifold: their faces fall into several fans.

    Parameters
    ----------
    faces : (F, 3) int32
        Triangles; each side has at most two.
    n : int
        Number of vertices.

    Returns
    -------
    (P,) int64
        Ascending; empty if the surface is a manifold (with boundary).

    Examples
    --------
    >>> pinched_vertices(np.array([[0, 1, 2], [2, 3, 4]], np.int32), 5).tolist()
    [2]
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corner = np.arange(3 * len(faces)).reshape(-1, 3)
    sides = [(0, 1), (1, 2), (2, 0)]
    ends = np.concatenate([faces[:, side] for side in sides]).astype(np.int64)
    at = np.concatenate([corner[:, side] for side in sides])
    swap = ends[:, 0] > ends[:, 1]
    ends[swap], at[swap] = ends[swap, ::-1], at[swap, ::-1]
    order = np.argsort(ends[:, 0] * n + ends[:, 1], kind="stable")
    ends, at = ends[order], at[order]
    shared = np.flatnonzero((ends[1:] == ends[:-1]).all(axis=1))
    one, other = at[shared].ravel(), at[shared + 1].ravel()
    links = coo_array((np.ones(len(one), bool), (one, other)), shape=(corner.size, corner.size))
    count, fan = connected_components(links, directed=False)
    owner = np.zeros(count, np.int64)
    owner[fan] = faces.ravel()
    return np.flatnonzero(np.bincount(owner, minlength=n) > 1)


def _refuse(cloud: Cloud) -> None:
    require(cloud, Cloud, "cloud")
    for name in ("xyz", "uv"):
        if not isinstance(getattr(cloud, name), np.ndarray):
            raise InputError(f"surface: {name} is {told(getattr(cloud, name))}, expected an array: np.asarray")
    n = len(cloud.xyz)
    shapes = (cloud.xyz.shape, cloud.uv.shape) + (() if cloud.covariance is None else (cloud.covariance.shape,))
    if shapes != ((n, 3), (n, 2), (n, 3, 3))[: len(shapes)]:
        raise InputError(f"surface: xyz, uv and covariance have shapes {shapes}, expected (N, 3), (N, 2), (N, 3, 3)")
    good = np.isfinite(cloud.uv).all(axis=1) & np.isfinite(cloud.xyz).all(axis=1) & (cloud.xyz[:, 2] > 0)
    if not good.all():
        bad = int(np.flatnonzero(~good)[0])
        where = f"uv {cloud.uv[bad].tolist()}, xyz {cloud.xyz[bad].tolist()}"
        raise InputError(f"surface: point {bad} is {where}, expected finite values with z > 0")
    if cloud.covariance is not None and not np.isfinite(cloud.covariance).all():
        bad = int(np.flatnonzero(~np.isfinite(cloud.covariance).all(axis=(1, 2)))[0])
        raise InputError(f"surface: the covariance of point {bad} is not finite, expected finite m²")


def _triangulate(uv: FloatArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Triangles (F, 3), and the neighbour opposite to each corner, -1 at the border."""
    from scipy.spatial import Delaunay, QhullError

    if len(uv) < 3:
        raise GeometryError(f"surface: {len(uv)} points, expected at least 3")
    centred = uv - uv.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    if not spread[1] > 1e-9 * max(spread[0], 1.0):
        what = "at one place" if spread[0] <= 1e-9 else "on one line"
        raise GeometryError(f"surface: all {len(uv)} points lie {what} in the image, expected a spread both ways")
    try:
        mesh = Delaunay(centred)
        return np.ascontiguousarray(mesh.simplices, dtype=np.int32), mesh.neighbors
    except QhullError as error:
        reason = str(error).strip().splitlines()[0]
        raise GeometryError(f"surface: {len(uv)} points cannot be triangulated ({reason})") from error


def _jumps(cloud: Cloud, faces: NDArray[np.int32], max_ratio: float, significance: float) -> BoolArray:
    """Whether a side of each face jumps in depth: by much against the depth, and against its uncertainty."""
    depth, variance = cloud.xyz[:, 2], _variance(cloud)
    ends, others = faces, np.roll(faces, -1, axis=1)
    jump = np.abs(depth[ends] - depth[others])
    is_large = jump > max_ratio * np.minimum(depth[ends], depth[others])
    is_significant = jump**2 > significance**2 * (variance[ends] + variance[others])
    found: BoolArray = np.any(is_large & is_significant, axis=1)
    return found


def _is_slope(
    cloud: Cloud, faces: NDArray[np.int32], neighbours: NDArray[np.int32], rows: NDArray[np.int64], significance: float
) -> BoolArray:
    """Whether each of some faces has two neighbours or three, and lies in one plane with all of them."""
    inverse = 1 / cloud.xyz[:, 2]
    tolerance = (significance * np.sqrt(_variance(cloud)) * inverse + _ROUNDING) * inverse
    fits, count = np.ones(len(rows), bool), np.zeros(len(rows), int)
    for corner in range(3):
        other = neighbours[rows, corner]
        apex = np.take_along_axis(faces[other], np.argmax(neighbours[other] == rows[:, None], axis=1)[:, None], 1)[:, 0]
        opposite = faces[rows, corner]
        off = np.abs(_continued(cloud.uv, inverse, faces[rows], apex) - inverse[apex]) > tolerance[apex]
        off &= np.abs(_continued(cloud.uv, inverse, faces[other], opposite) - inverse[opposite]) > tolerance[opposite]
        fits &= ~off | (other < 0)
        count += other >= 0
    return fits & (count >= 2)


def _continued(uv: FloatArray, values: FloatArray, faces: NDArray[np.int32], at: NDArray[np.int32]) -> FloatArray:
    """Value of each face's plane at a vertex; infinite for a face without area."""
    origin, p, q = uv[faces[:, 0]], uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]
    step = uv[at] - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        area = p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]
        a = (step[:, 0] * q[:, 1] - step[:, 1] * q[:, 0]) / area
        b = (p[:, 0] * step[:, 1] - p[:, 1] * step[:, 0]) / area
        first, second, third = values[faces].T
        found = first + a * (second - first) + b * (third - first)
    return np.where(np.isfinite(found), found, np.inf)


def _variance(cloud: Cloud) -> FloatArray:
    """Variance of depth, m²; 0 for a cloud without a covariance."""
    return np.zeros(len(cloud)) if cloud.covariance is None else cloud.covariance[:, 2, 2]


def _smallest_angle(corners: FloatArray) -> FloatArray:
    """Smallest interior angle of each (F, 3, 2) triangle, rad."""
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    cross = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    return np.arctan2(np.abs(cross), np.sum(ahead * behind, axis=2)).min(axis=1)
