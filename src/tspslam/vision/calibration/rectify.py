"""Rectification: from two raw cameras to a pair whose rows agree."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ..._checks import require
from ..._threads import both
from ...errors import GeometryError, InputError
from ...types import LENSES, BoolArray, Camera, FloatArray, Image, RawRig, Rig
from ..rig import LARGEST_AREA, check_image
from ._lenses import PERSPECTIVE, bend, bend_radius, turning_radius
from ._wide import LARGEST_ZOOM, turn_both, wide_maps, wide_rig

_LARGEST_TURN = 45.0  # degrees between the two cameras
_LARGEST_SIDE = 32_766  # px, of OpenCV's resampling
_LEAST_SEEN = 0.1  # of the rectified image by both cameras: less is no picture of a scene
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


@dataclass(frozen=True, repr=False)
class Rectification(Brief):
    """How the images of a raw pair become those of a rectified one. Make it with `rectification`.

    Attributes
    ----------
    raw : RawRig
        The cameras as they are.
    rig : Rig
        The rectified pair: one focal length, no skew, no doffs.
    R_left, R_right : (3, 3) float64
        Rotate a point of a raw camera's frame into its rectified frame.
    """

    raw: RawRig
    rig: Rig
    R_left: FloatArray
    R_right: FloatArray
    _maps: tuple[Maps, Maps] = field(repr=False)

    def __call__(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Resample a raw pair into the rectified frame, bicubic.

        Parameters
        ----------
        left, right : (H, W) or (H, W, 3) uint8, uint16 or float array
            Images of the raw cameras.

        Returns
        -------
        left, right : (H, W) or (H, W, 3) uint8, uint16 or float array
            Of the given type and the rig's size; 0 where a camera saw nothing (see `valid`).

        Raises
        ------
        InputError
            If an image is not one, or has another size than its camera.
        """
        for side, image, camera in (("left", left, self.raw.left), ("right", right, self.raw.right)):
            check_image(f"{side} image", image)
            if image.shape[:2] != (camera.height, camera.width):
                size = f"{image.shape[1]} x {image.shape[0]}"
                raise InputError(f"{side} image is {size} px, but its camera has {camera.width} x {camera.height} px")
        one, other = both(_resample, ((left, self._maps[0]), (right, self._maps[1])))
        return one, other

    @property
    def valid(self) -> BoolArray:
        """Whether both cameras saw a pixel of the rectified frame, (H, W): its centre lies in a pixel of theirs."""
        sides = zip(self._maps, (self.raw.left, self.raw.right), strict=True)
        inside = [
            (u >= -0.5) & (u <= camera.width - 0.5) & (v >= -0.5) & (v <= camera.height - 0.5)
            for (u, v), camera in sides
        ]
        return inside[0] & inside[1]


def rectification(raw: RawRig) -> Rectification:
    """Rectify a raw pair: turn both cameras so that rows agree; only the border of what both see is cut.

    Of lenses of Brown's family, the new focal length and principal point are those of OpenCV's ``stereoRectify`` with
    ``alpha = 0`` and equal principal points (Bouguet's method); skew of the raw cameras is taken out as well.

    Where ``raw.field_of_view`` is stated, or a lens is of another model, both cameras are turned in the same way, the
    rectified images are as large as the raw ones (more pixels would show nothing new), the principal point is their
    centre, and ``f = width / 2 / tan(field_of_view / 2)``. Where none is stated, it is the largest field of view that
    both cameras fill, up to 110°; a stated one may leave parts that a camera did not see (`Rectification.valid`).

    Parameters
    ----------
    raw : RawRig
        The cameras.

    Returns
    -------
    Rectification

    Raises
    ------
    InputError
        If the cameras differ in size, a distortion folds its image, or the calibration is not of a horizontal pair
        with the left camera on the left.
    GeometryError
        If both cameras see less than a tenth of the rectified image, or cannot fill one.

    Examples
    --------
    >>> from dataclasses import replace
    >>> T_right_left = ((1, 0, 0, -0.1), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    >>> camera = Camera(500, 500, 320, 240, 640, 480)
    >>> made = rectification(RawRig(camera, replace(camera, cx=330), T_right_left))
    >>> round(made.rig.baseline, 9), made.rig.doffs
    (0.1, 0.0)
    """
    require(raw, RawRig, "rig")
    _check_geometry(raw)
    lenses = (raw.left.lens, raw.right.lens)
    if raw.field_of_view is not None or any(lens not in PERSPECTIVE for lens in lenses):
        return _rectify_wide(raw)
    for side, camera in (("left", raw.left), ("right", raw.right)):
        _check_distortion(side, camera)
    R_left, R_right, P_left, P_right = _stereo_rectify(raw)
    rig = _rectified_rig(raw, P_left, P_right)
    maps = _maps(raw.left, R_left, rig), _maps(raw.right, R_right, rig)
    for side, camera, (u, v) in (("left", raw.left, maps[0]), ("right", raw.right, maps[1])):
        _check_fold(side, camera, u, v)
    return Rectification(raw, rig, R_left, R_right, maps)


def _rectify_wide(raw: RawRig) -> Rectification:
    """Rectify to a field of view."""
    R_left, R_right = turn_both(raw.matrix)
    rig = wide_rig(raw, R_left, R_right)
    made = Rectification(
        raw, rig, R_left, R_right, (wide_maps(raw.left, R_left, rig), wide_maps(raw.right, R_right, rig))
    )
    share = float(made.valid.mean())
    if share < _LEAST_SEEN:
        raise GeometryError(
            f"raw rig: both cameras see {100 * share:.2g} % of the rectified image, expected at least "
            f"{100 * _LEAST_SEEN:g} %: a smaller field of view, or coefficients of these lenses"
        )
    return made


def camera_matrix(camera: Camera | Rig) -> FloatArray:
    """Intrinsic matrix of eq. (2).

    Parameters
    ----------
    camera : Camera or Rig
        Of a `Rig`, the left one.

    Returns
    -------
    (3, 3) float64
        px.
    """
    return np.array([[camera.fx, camera.skew, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]], np.float64)


def distort(camera: Camera, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels at which a raw camera sees rays (x, y, 1), by the lenses of Brown's family: also where they fold.

    ``x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)``, likewise y with p1 and p2 exchanged, then the
    intrinsic matrix; `lenses.project` knows every lens, and what it doesn't see.

    Parameters
    ----------
    camera : Camera
        With a brown, rational or thin prism lens.
    x, y : float64 array of one shape (...,)
        Directions: x / z, y / z.

    Returns
    -------
    u, v : (...,) float64
        px.
    """
    x, y = bend(camera, x, y)
    return camera.fx * x + camera.skew * y + camera.cx, camera.fy * y + camera.cy


def _check_geometry(raw: RawRig) -> None:
    sizes = [(camera.width, camera.height) for camera in (raw.left, raw.right)]
    if sizes[0] != sizes[1]:
        raise InputError(f"raw rig: cameras have {sizes[0]} and {sizes[1]} px, expected the same size")
    if max(sizes[0]) > _LARGEST_SIDE or sizes[0][0] * sizes[0][1] > LARGEST_AREA:
        wanted = f"at most {_LARGEST_SIDE} px a side and {LARGEST_AREA} in all"
        raise InputError(f"raw rig: cameras have {sizes[0][0]} x {sizes[0][1]} px, expected {wanted}")
    R, t = raw.matrix[:3, :3], raw.matrix[:3, 3]
    turn = float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))))
    if turn > _LARGEST_TURN:
        raise InputError(
            f"raw rig: the right camera is turned by {turn:.1f}° against the left one, expected at most "
            f"{_LARGEST_TURN:g}° (T_right_left maps points of the left camera to the right one's frame)"
        )
    centre = -R.T @ t  # of the right camera, in the left one's frame
    if centre[0] <= abs(centre[1]):
        where = f"({', '.join(f'{c:.4g}' for c in centre)}) m from the left one"
        raise InputError(f"raw rig: the right camera is at {where}, expected it to the right, x > |y|")


def _check_distortion(side: str, camera: Camera) -> None:
    """Refuse a radial distortion that turns back before the farthest corner: no ray would reach that corner."""
    u = np.array([0, camera.width - 1, 0, camera.width - 1]) - camera.cx
    v = np.array([0, 0, camera.height - 1, camera.height - 1]) - camera.cy
    corner = float(np.hypot(u / camera.fx, v / camera.fy).max())
    r = turning_radius(camera)
    if not np.isfinite(r):
        return
    farthest = float(bend_radius(camera, np.array(r))[0])
    if farthest < corner:
        raise InputError(
            f"raw rig: the distortion of the {side} camera {list(camera.distortion)} folds its image: it reaches "
            f"{farthest:.3g} from the axis, the corners are at {corner:.3g}, "
            f"expected {', '.join(LENSES[camera.lens])} of this lens"
        )


def _stereo_rectify(raw: RawRig) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    import cv2

    lenses: list[Any] = [each for c in (raw.left, raw.right) for each in (camera_matrix(c), np.array(c.distortion))]
    size, R, t = (raw.left.width, raw.left.height), raw.matrix[:3, :3].copy(), raw.matrix[:3, 3:].copy()
    rectify: Any = cv2.stereoRectify
    values = rectify(*lenses, imageSize=size, R=R, T=t, flags=cv2.CALIB_ZERO_DISPARITY, alpha=0)
    R_left, R_right, P_left, P_right = values[:4]
    return R_left, R_right, P_left, P_right


def _rectified_rig(raw: RawRig, P_left: FloatArray, P_right: FloatArray) -> Rig:
    f, cx, cy = (float(P_left[at]) for at in ((0, 0), (0, 2), (1, 2)))
    if not 1 / LARGEST_ZOOM < f / raw.left.fx < LARGEST_ZOOM:
        raise GeometryError(
            f"raw rig: rectification would change the focal length from {raw.left.fx:.4g} to {f:.4g} px, expected "
            "cameras that see one scene, and distortions of their lenses"
        )
    try:
        return Rig(f, f, cx, cy, float(-P_right[0, 3] / f), raw.left.width, raw.left.height)
    except InputError as error:
        raise GeometryError(f"raw rig: rectification fails ({error}), expected cameras that see one scene") from error


def _maps(camera: Camera, R: FloatArray, rig: Rig) -> Maps:
    """Where each pixel of the rectified frame lies in the raw image, (u, v); far outside where no ray goes."""
    ray_u, ray_v = (np.arange(rig.width) - rig.cx) / rig.fx, (np.arange(rig.height) - rig.cy) / rig.fy
    rows = [R[0, k] * ray_u + (R[1, k] * ray_v + R[2, k])[:, None] for k in range(3)]  # of Rᵀ (u, v, 1)
    front = rows[2] > 1e-6
    depth = np.where(front, rows[2], 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        u, v = distort(camera, rows[0] / depth, rows[1] / depth)
        seen = front & (np.abs(u) < 1e6) & (np.abs(v) < 1e6)
    return np.where(seen, u, -1e6).astype(np.float32), np.where(seen, v, -1e6).astype(np.float32)


def _check_fold(side: str, camera: Camera, u: NDArray[np.float32], v: NDArray[np.float32]) -> None:
    """Refuse maps that turn over somewhere inside the image."""
    area = np.diff(u, axis=1)[:-1] * np.diff(v, axis=0)[:, :-1] - np.diff(v, axis=1)[:-1] * np.diff(u, axis=0)[:, :-1]
    seen = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    folded = np.argwhere((area <= 0) & seen[:-1, :-1])
    if len(folded):
        row, column = folded[0]
        raise InputError(
            f"raw rig: the distortion of the {side} camera folds its image at ({column}, {row}) px of the rectified "
            f"frame, expected {', '.join(LENSES[camera.lens])} of this lens"
        )


def _resample(given: tuple[Image, Maps]) -> Image:
    import cv2

    image, (u, v) = given
    made: Image = cv2.remap(image, u, v, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT)
    return np.clip(made, 0, 1, out=made) if made.dtype.kind == "f" else made
