"""A calibration board as a camera with a lens sees it."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...types import Camera, FloatArray
from ...vision.calibration.targets import Board

_FINE = 4  # samples a pixel and axis
_BORDER = 1.0  # squares of white paper around what is printed
_PAPER, _INK, _ROOM = 0.9, 0.08, 0.45  # luminance


def render_board(
    board: Board, camera: Camera, T_camera_board: FloatArray,
    *, noise: float = 0.0, blur: float = 0.6, seed: int = 0,
) -> NDArray[np.uint8]:  # fmt: skip
    """Render a board on white paper before a grey wall, as one camera sees it.

    Parameters
    ----------
    board : Chessboard or Charuco
        What is on the paper.
    camera : Camera
        The lens: brown, rational, thin_prism or equidistant.
    T_camera_board : (4, 4) float64
        Maps points of the board to the camera's frame, m.
    noise : float
        Standard deviation of luminance in [0, 1].
    blur : float
        Standard deviation of the lens's own blur, px.
    seed : int
        Of the noise.

    Returns
    -------
    (H, W) uint8

    Raises
    ------
    InputError
        If the lens is another.

    Examples
    --------
    >>> from tspslam.vision.calibration.targets import Chessboard
    >>> pose = np.eye(4)
    >>> pose[:3, 3] = -0.1, -0.06, 0.5
    >>> image = render_board(Chessboard(9, 6, 0.025), Camera(80, 80, 32, 24, 64, 48), pose)
    >>> image.shape, image.dtype
    ((48, 64), dtype('uint8'))
    """
    import cv2

    rays = _rays(camera)
    x, y = _meeting(rays, np.asarray(T_camera_board, np.float64))
    near = _around(board, x, y)
    image = np.full(x.shape, _ROOM)
    if near is not None:
        fine = [cv2.resize(each[near], None, fx=_FINE, fy=_FINE, interpolation=cv2.INTER_LINEAR) for each in (x, y)]
        luminance = _luminance(board, *fine)
        height, width = x[near].shape
        image[near] = luminance.reshape(height, _FINE, width, _FINE).mean(axis=(1, 3))
    if blur > 0:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    if noise > 0:
        image = image + np.random.default_rng(seed).normal(0, noise, image.shape)
    return np.clip(np.rint(255 * image), 0, 255).astype(np.uint8)


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> FloatArray:
    """Where the ray of each pixel meets the plane z = 1, (H, W, 2)."""
    import cv2

    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    uv = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    K = np.array([[camera.fx, camera.skew, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    coefficients = np.array(camera.distortion)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-10)
    if camera.lens == "equidistant":
        plane = cv2.fisheye.undistortPoints(uv, K, coefficients, criteria=stop)
    elif camera.lens in ("brown", "rational", "thin_prism"):
        plane = cv2.undistortPointsIter(uv, K, coefficients, None, None, stop)
    else:
        raise InputError(f"camera: lens is {camera.lens}, expected brown, rational, thin_prism or equidistant")
    return np.asarray(plane, np.float64).reshape(camera.height, camera.width, 2)


def _meeting(rays: FloatArray, T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where rays meet the board's plane, in its frame, m; far off where they do not."""
    normal, origin = T[:3, 2], T[:3, 3]
    along = rays[..., 0] * normal[0] + rays[..., 1] * normal[1] + normal[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = (origin @ normal) / along
        points = np.dstack([rays * depth[..., None], depth]) - origin
    seen = np.isfinite(depth) & (depth > 0)
    return tuple(np.where(seen, points @ T[:3, k], 1e6) for k in (0, 1))  # type: ignore[return-value]


def _around(board: Board, x: FloatArray, y: FloatArray) -> tuple[slice, slice] | None:
    """The part of the image with the paper in it."""
    low, high = _paper(board)
    on = np.argwhere((x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1]))
    if not len(on):
        return None
    (top, left), (bottom, right) = np.maximum(on.min(axis=0) - 2, 0), on.max(axis=0) + 3
    return slice(top, bottom), slice(left, right)


def _paper(board: Board) -> tuple[FloatArray, FloatArray]:
    black = board.black
    border = _BORDER * board.square
    return black[:, :2].min(axis=0) - border, black[:, 2:].max(axis=0) + border


def _luminance(board: Board, x: FloatArray, y: FloatArray) -> FloatArray:
    """What is printed at points of the board, looked up in the cells between all edges of its black rectangles."""
    black = np.round(board.black, 12)
    across, down = (np.unique(black[:, [k, k + 2]]) for k in (0, 1))
    cells = np.zeros((len(down) + 1, len(across) + 1), np.bool_)
    corners = [np.searchsorted(edges, black[:, k]) for k, edges in ((0, across), (1, down), (2, across), (3, down))]
    for x0, y0, x1, y1 in zip(*corners, strict=True):
        cells[y0 + 1 : y1 + 1, x0 + 1 : x1 + 1] = True
    low, high = _paper(board)
    is_paper = (x > low[0]) & (x < high[0]) & (y > low[1]) & (y < high[1])
    is_ink = cells[np.searchsorted(down, y, "right"), np.searchsorted(across, x, "right")]
    return np.where(is_paper, np.where(is_ink, _INK, _PAPER), _ROOM)
