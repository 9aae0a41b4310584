"""Points to faces: Delaunay in the image, lifted to 3-D and cut where the depth steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import GeometryError, InputError
from ..types import BoolArray, Cloud, FloatArray, Surface


@dataclass(frozen=True)
class DelaunaySurface:
    """Image Delaunay with depth cuts, as a stage.

    Attributes
    ----------
    max_depth_ratio : float
        An edge is cut where the farther end's depth exceeds the nearer's by more than this share of it.
    significance : float
        Only steps larger than this many standard deviations of the depth difference count as steps, where the cloud
        has a covariance; 0 trusts every depth.
    min_angle : float
        Faces whose smallest image angle is below this are slivers, degrees.
    max_edge : float
        Longest side in the image, as a share of the image's (more exactly, the points') diagonal.

    Examples
    --------
    >>> DelaunaySurface(max_depth_ratio=0.2).max_depth_ratio
    0.2
    """

    max_depth_ratio: float = 0.1
    significance: float = 3.0
    min_angle: float = 3.0
    max_edge: float = 0.25

    def __call__(self, cloud: Cloud) -> Surface:
        """Triangulate `cloud`; see `delaunay_surface`."""
        _refuse_settings(self)
        faces = _triangulate(cloud.uv)
        keep = ~_bridges_step(cloud, faces, self.max_depth_ratio, self.significance)
        keep &= _smallest_angle(cloud.uv[faces]) >= np.radians(self.min_angle)
        diagonal = float(np.linalg.norm(np.ptp(cloud.uv, axis=0)))
        keep &= _side_lengths(cloud.uv[faces]).max(axis=1) <= self.max_edge * diagonal
        return Surface(faces[keep])


def delaunay_surface(cloud: Cloud, *, max_depth_ratio: float = 0.1, significance: float = 3.0) -> Surface:
    """Triangulate a cloud in the image, lift the triangles to 3-D and drop those that bridge a depth step.

    The Delaunay triangulation of the projections is a planar sheet; leaving faces out keeps every edge with at most
    two faces, so the surface is edge-manifold, with boundary. Slivers and faces that span a large part of the image go
    too.

    Parameters
    ----------
    cloud : Cloud
        N >= 3 points that one camera sees.
    max_depth_ratio : float
        A face bridges a step if, along a side, depth grows by more than this share of the nearer depth.
    significance : float
        ... and by more than this many standard deviations of the difference, where the cloud has a covariance.

    Returns
    -------
    Surface
        faces (F, 3) int32, counter-clockwise as Qhull gives them in (u, v); F may be 0.

    Raises
    ------
    GeometryError
        If there are fewer than 3 points, or all of them lie on a line or at one place in the image.
    InputError
        If a position is not finite, a depth is not positive, or a setting is out of range.

    Examples
    --------
    >>> uv = np.array([[0., 0], [10, 0], [0, 10], [10, 10]])
    >>> cloud = Cloud(np.column_stack([uv, np.full(4, 5.0)]), uv, np.full(4, 20.0))
    >>> len(delaunay_surface(cloud).faces)
    0
    """
    return DelaunaySurface(max_depth_ratio, significance)(cloud)


def _refuse_settings(stage: DelaunaySurface) -> None:
    for name in ("max_depth_ratio", "significance", "min_angle", "max_edge"):
        value = getattr(stage, name)
        if not (np.isfinite(value) and value >= 0):
            raise InputError(f"surface: {name} is {value}, expected a finite number >= 0")


def _triangulate(uv: FloatArray) -> NDArray[np.int32]:
    from scipy.spatial import Delaunay, QhullError

    if len(uv) < 3:
        raise GeometryError(f"surface: {len(uv)} points, expected at least 3")
    centred = uv - uv.mean(axis=0)
    spread = np.linalg.svd(centred, compute_uv=False)
    if not spread[1] > 1e-9 * max(spread[0], 1.0):
        what = "at one place" if spread[0] <= 1e-9 else "on one line"
        raise GeometryError(f"surface: all {len(uv)} points lie {what} in the image, expected points in general position")
    try:
        return np.ascontiguousarray(Delaunay(centred).simplices, dtype=np.int32)
    except QhullError as error:
        reason = str(error).strip().splitlines()[0]
        raise GeometryError(f"surface: {len(uv)} points cannot be triangulated ({reason})") from error
