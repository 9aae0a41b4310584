"""Boards to calibrate with, chessboards and ChArUco boards: what is printed on them, their corners in an image."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ..._checks import check_luminance, check_pixels, require, told
from ...errors import InputError
from ...types import FloatArray, Image

_CORNERS = (3, 100)  # inner corners, or squares, a side; OpenCV's detectors take no fewer
_LENGTHS = (1e-4, 10.0)  # m, of a square
LEAST_CORNERS = 6
"""Corners of a view: four give a homography, two more show whether it holds."""
_LEAST_SIDE = 15  # px, that OpenCV's detectors take: squares of a smaller image could not be told anyway
_GLANCED_AT = 640  # px: larger images are looked at in half their size, but no smaller, before the slow detector
_FOUND_AT = 1600  # px: larger images are searched at this size, and their corners refined at their own
_HALF = 0.4  # of the distance of neighbouring corners: the window of refinement has no other corner in it
_NARROWEST = 2.5  # px: a window that has less white around it cannot tell a corner from its markers
_HALVES = (2, 11)  # px; 11 is OpenCV's own half window for chessboards
_MARGIN = 0.95  # of the white between a corner and its markers
_EDGE = (5.0, 95.0)  # percentiles of grey: the contrast of an edge
Box = NDArray[np.float64]


@dataclass(frozen=True)
class Chessboard:
    """A chessboard.

    Attributes
    ----------
    columns, rows : int
        Inner corners, where four squares meet: one less than there are squares.
    square : float
        Side of a square, m.

    Raises
    ------
    InputError
        If a value is out of its range: 3 to 100 corners a side; squares of 1e-4 to 10 m.

    Examples
    --------
    >>> board = Chessboard(9, 6, 0.025)
    >>> board.corners.shape, board.corners[1].tolist()
    ((54, 3), [0.025, 0.0, 0.0])
    """

    columns: int
    rows: int
    square: float

    def __post_init__(self) -> None:
        _check_board(self, "chessboard", "square")

    @property
    def corners(self) -> FloatArray:
        """Places of the corners, row after row, (columns * rows, 3) float64, m; x along a row, y down, z away."""
        return _grid(self.columns, self.rows, self.square, 0.0)

    @property
    def black(self) -> FloatArray:
        """Black rectangles (x0, y0, x1, y1) of what is printed, (n, 4) float64, m, where the corners are."""
        cells = _black_cells(self.columns + 1, self.rows + 1)
        return np.hstack([cells - 1, cells]) * self.square


@dataclass(frozen=True)
class Charuco:
    """A chessboard with a marker in each white square, of which a part is enough: OpenCV's pattern of 4.6 and later.

    Attributes
    ----------
    columns, rows : int
        Squares.
    square, marker : float
        Sides of a square and of a marker in it, m.
    dictionary : str
        Of the markers, as OpenCV calls it: ``"4X4_50"``, ``"5X5_100"``, ``"APRILTAG_36H11"``.

    Raises
    ------
    InputError
        If a value is out of its range (3 to 100 squares a side, markers 0.3 to 0.95 of a square), the dictionary is
        not one of OpenCV's, or has too few markers.

    Examples
    --------
    >>> board = Charuco(5, 7, 0.03, 0.022)
    >>> board.corners.shape, board.dictionary
    ((24, 3), '4X4_50')
    """

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        _check_board(self, "ChArUco board", "square", "marker")
        if not 0.3 <= self.marker / self.square <= 0.95:
            said = f"marker is {self.marker:g} m in squares of {self.square:g} m"
            raise InputError(f"ChArUco board: {said}, expected 0.3 to 0.95 of a square")
        count, needed = len(self._markers().bytesList), self.columns * self.rows // 2
        if count < needed:
            raise InputError(f"ChArUco board: {self.dictionary} has {count} markers, but {needed} are needed")

    @property
    def corners(self) -> FloatArray:
        """Places of the inner corners, ((columns - 1) * (rows - 1), 3) float64, m, from a corner of the board."""
        return _grid(self.columns - 1, self.rows - 1, self.square, self.square)

    @property
    def black(self) -> FloatArray:
        """Black rectangles (x0, y0, x1, y1) of what is printed, (n, 4) float64, m, where the corners are."""
        import cv2

        cells = _black_cells(self.columns, self.rows)
        boxes = [np.hstack([cells, cells + 1]) * self.square]
        white = [(x, y) for y in range(self.rows) for x in range(self.columns) if (x + y) % 2]
        markers, module = self._markers(), self.marker / (self._markers().markerSize + 2)
        for number, (x, y) in enumerate(white):
            bits = cv2.aruco.generateImageMarker(markers, number, markers.markerSize + 2)
            at = np.argwhere(bits == 0)[:, ::-1] * module + np.array((x, y)) * self.square
            at = at + (self.square - self.marker) / 2
            boxes.append(np.hstack([at, at + module]))
        return np.vstack(boxes)

    def _markers(self) -> Any:
        import cv2

        key = f"DICT_{self.dictionary}"
        if not isinstance(self.dictionary, str) or not hasattr(cv2.aruco, key):
            raise InputError(
                f"ChArUco board: dictionary is {str(self.dictionary)[:40]!r}, expected one such as 4X4_50 or 5X5_100"
            )
        return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, key))

    def _detector(self) -> Any:
        import cv2

        size = (self.columns, self.rows)
        return cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(size, self.square, self.marker, self._markers()))


Board = Chessboard | Charuco


@dataclass(frozen=True, repr=False)
class Corners(Brief):
    """Corners of a board that were found in an image.

    Attributes
    ----------
    ids : (N,) int64
        Which corners of the board they are; of a chessboard all or none.
    uv : (N, 2) float64
        Where they are, px.
    xyz : (N, 3) float64
        Where they are on the board, m.
    size : tuple of 2 int
        Width and height of the image, px.
    blur : float
        Width of an edge of the squares, px, in the median; NaN where there are no corners.
    """

    ids: NDArray[np.int64]
    uv: FloatArray
    xyz: FloatArray
    size: tuple[int, int]
    blur: float = float("nan")

    def __len__(self) -> int:
        return len(self.ids)


def detect(board: Board, image: Image) -> Corners:
    """Find the corners of a board in an image, to a fraction of a pixel.

    Of a symmetric chessboard nothing tells which end is which: corner 0 is then any of those that it may be. Rows and
    columns always turn the same way as on the board.

    Parameters
    ----------
    board : Chessboard or Charuco
        What is looked for.
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        As a camera took it; float in [0, 1].

    Returns
    -------
    Corners
        None of them if the board is not found.

    Raises
    ------
    InputError
        If the board or the image is none, or a float image has values beyond [0, 1], or NaN.

    Examples
    --------
    >>> len(detect(Chessboard(9, 6, 0.025), np.zeros((48, 64), np.uint8)))
    0
    """
    require_board(board)
    grey = _grey(image)
    scale = min(1.0, _FOUND_AT / max(grey.shape))
    is_thin = round(min(grey.shape) * scale) < _LEAST_SIDE
    found = None if is_thin else _find(board, _scaled(grey, scale))
    size = (grey.shape[1], grey.shape[0])
    if found is None:
        return Corners(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3)), size)
    ids, uv = found[0], (found[1] + 0.5) / scale - 0.5
    half = _half_window(board, ids, uv)
    if isinstance(board, Charuco):
        wide = half >= _NARROWEST
        ids, uv, half = ids[wide], uv[wide], half[wide]
        if not _has_pose(board, ids):
            return Corners(np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros((0, 3)), size)
    refined = _refined(grey, uv, half)
    return Corners(ids, refined, board.corners[ids], size, _blur(grey, refined, _spacing(board, ids, refined)))


def aligned(board: Board, left: Corners, right: Corners) -> Corners:
    """Number the right image's corners of a chessboard as the left one's are: the one is not turned against the other.

    Parameters
    ----------
    board : Chessboard or Charuco
        What was found; the markers of a ChArUco board say which corner is which.
    left, right : Corners
        As `detect` gives them.

    Returns
    -------
    Corners
        `right`, perhaps in another order.

    Raises
    ------
    InputError
        If the board or the corners are none.

    Examples
    --------
    >>> board = Chessboard(3, 3, 0.1)
    >>> uv = board.corners[:, :2] * 1000
    >>> left = Corners(np.arange(9), uv, board.corners, (640, 480))
    >>> right = Corners(np.arange(9), uv[::-1] - 20, board.corners, (640, 480))
    >>> aligned(board, left, right).uv[0].tolist()
    [-20.0, -20.0]
    """
    require_board(board)
    require(left, Corners, "left")
    require(right, Corners, "right")
    if isinstance(board, Charuco) or not (len(left) and len(right)):
        return right
    grid = right.uv.reshape(board.rows, board.columns, 2)
    turns = range(4) if board.rows == board.columns else (0, 2)
    orders = [np.rot90(grid, k).reshape(-1, 2) for k in turns]
    shape = left.uv - left.uv.mean(axis=0)
    best = max(orders, key=lambda uv: float(np.sum((uv - uv.mean(axis=0)) * shape)))
    return Corners(right.ids, np.ascontiguousarray(best), right.xyz, right.size, right.blur)


def require_board(board: Any) -> None:
    """Refuse what is no board.

    Parameters
    ----------
    board : Chessboard or Charuco
        Or anything else.

    Raises
    ------
    InputError
        If it is anything else.
    """
    if not isinstance(board, Board):
        raise InputError(f"board is {told(board)}, expected a Chessboard or a Charuco")


def _check_board(board: Any, what: str, *lengths: str) -> None:
    for name in ("columns", "rows"):
        value: Any = getattr(board, name)
        if isinstance(value, bool) or not issubclass(type(value), Integral) or not _CORNERS[0] <= value <= _CORNERS[1]:
            raise InputError(f"{what}: {name} is {repr(value)[:40]}, expected {_CORNERS[0]} to {_CORNERS[1]}")
    for name in lengths:
        value = getattr(board, name)
        if isinstance(value, bool) or not issubclass(type(value), Real) or not _LENGTHS[0] <= value <= _LENGTHS[1]:
            way = ": 25 mm are 0.025" if name == "square" else ""
            raise InputError(
                f"{what}: {name} is {repr(value)[:40]} m, expected {_LENGTHS[0]:g} to {_LENGTHS[1]:g}{way}"
            )


def _grid(columns: int, rows: int, square: float, origin: float) -> FloatArray:
    y, x = np.mgrid[:rows, :columns]
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(columns * rows)]) * square + (origin, origin, 0.0)


def _black_cells(columns: int, rows: int) -> FloatArray:
    """Upper left corners of the black squares, in squares."""
    return np.array([(x, y) for y in range(rows) for x in range(columns) if (x + y) % 2 == 0], np.float64)


def _grey(image: Image) -> NDArray[np.uint8]:
    """8-bit luminance; deeper pixels are spread over what the image uses, since a corner has no absolute grey."""
    import cv2

    check_pixels("image", image)
    check_luminance("image", image)
    grey: Any = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    if grey.dtype == np.uint8:
        return np.ascontiguousarray(grey)
    wide = grey.astype(np.float64)
    low, high = float(wide.min()), float(wide.max())
    return np.rint((wide - low) * (255 / max(high - low, 1e-12))).astype(np.uint8)


def _scaled(grey: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    import cv2

    if scale == 1.0:
        return grey
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _find(board: Board, grey: NDArray[np.uint8]) -> tuple[NDArray[np.int64], FloatArray] | None:
    return _find_charuco(board, grey) if isinstance(board, Charuco) else _find_chessboard(board, grey)


def _find_charuco(board: Charuco, grey: NDArray[np.uint8]) -> tuple[NDArray[np.int64], FloatArray] | None:
    uv, ids, _, _ = board._detector().detectBoard(grey)
    if ids is None:
        return None
    order = np.argsort(ids.ravel(), kind="stable")
    numbers = ids.ravel()[order].astype(np.int64)
    return (numbers, uv.reshape(-1, 2)[order].astype(np.float64)) if _has_pose(board, numbers) else None


def _has_pose(board: Charuco, ids: NDArray[np.int64]) -> bool:
    """Whether there are enough corners, not all in one row."""
    if len(ids) < LEAST_CORNERS:
        return False
    places = board.corners[ids, :2] - board.corners[ids, :2].mean(axis=0)
    return bool(np.linalg.svd(places, compute_uv=False)[1] > board.square / 2)


def _find_chessboard(board: Chessboard, grey: NDArray[np.uint8]) -> tuple[NDArray[np.int64], FloatArray] | None:
    """By OpenCV's two detectors: that of squares, and where it fails that of saddle points, if half the size has some.

    Most pairs of a recording show no board, and the second detector takes longest to find that.
    """
    import cv2

    size = (board.columns, board.rows)
    by_squares = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
    by_saddles = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    is_found, uv = cv2.findChessboardCorners(grey, size, flags=by_squares)
    if not is_found and _may_hold(grey, size):
        is_found, uv = cv2.findChessboardCornersSB(grey, size, flags=by_saddles)
    if not is_found or uv is None or uv.size != 2 * board.columns * board.rows:
        return None
    grid = np.asarray(uv, np.float64).reshape(board.rows, board.columns, 2)
    return np.arange(board.columns * board.rows), _unmirrored(grid).reshape(-1, 2)


def _may_hold(grey: NDArray[np.uint8], size: tuple[int, int]) -> bool:
    """Whether a quick look at half the size finds a chessboard, where the image is large enough for one."""
    import cv2

    scale = max(0.5, _GLANCED_AT / max(grey.shape))
    if scale >= 1:
        return True
    return bool(cv2.findChessboardCornersSB(_scaled(grey, scale), size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)[0])


def _unmirrored(grid: FloatArray) -> FloatArray:
    """Rows and columns that turn as on the board: a mirrored order would be of a board seen from behind."""
    along, down = grid[:, -1] - grid[:, 0], grid[-1] - grid[0]
    (a, b), (c, d) = along.mean(axis=0), down.mean(axis=0)
    return np.ascontiguousarray(grid if a * d - b * c > 0 else grid[:, ::-1])


def _spacing(board: Board, ids: NDArray[np.int64], uv: FloatArray) -> FloatArray:
    """Side of a square at each corner, along its shortest direction in the image, px; (N,)."""
    import cv2

    H, _ = cv2.findHomography(board.corners[ids, :2], uv)
    if H is None:
        return np.full(len(ids), 0.0)
    x, y = board.corners[ids, :2].T
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    J = np.stack([H[k, :2] - uv[:, k, None] * H[2, :2] for k in (0, 1)], axis=1) / w[:, None, None]
    return np.asarray(np.linalg.svd(J, compute_uv=False)[:, 1]) * board.square


def _half_window(board: Board, ids: NDArray[np.int64], uv: FloatArray) -> FloatArray:
    """Half the side of the window in which each corner is refined, px; (N,)."""
    share = _HALF
    if isinstance(board, Charuco):  # nothing of a marker in the window
        share = min(share, _MARGIN * (board.square - board.marker) / (2 * board.square))
    return share * _spacing(board, ids, uv)


def _refined(grey: NDArray[np.uint8], uv: FloatArray, wanted: FloatArray) -> FloatArray:
    """Corners where the gradients around them cross; those that would leave their window stay."""
    import cv2

    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
    refined, half = uv.astype(np.float32), np.clip(np.floor(wanted).astype(np.int64), *_HALVES)
    for size in np.unique(half):
        chosen = half == size
        points = np.ascontiguousarray(refined[chosen]).reshape(-1, 1, 2)
        refined[chosen] = cv2.cornerSubPix(grey, points, (int(size),) * 2, (-1, -1), criteria).reshape(-1, 2)
    moved = np.linalg.norm(refined - uv, axis=1)
    return np.where((moved <= half)[:, None], refined.astype(np.float64), uv)


def _blur(grey: NDArray[np.uint8], uv: FloatArray, spacing: FloatArray) -> float:
    """Contrast by steepest slope around each corner, px, in the median: about 1 for an edge as sharp as can be."""
    import cv2

    slope_u, slope_v = (cv2.Sobel(grey, cv2.CV_64F, *d, ksize=3, scale=1 / 8) for d in ((1, 0), (0, 1)))
    steep, height, width = np.hypot(slope_u, slope_v), *grey.shape
    widths = []
    for (u, v), half in zip(np.rint(uv).astype(int), np.maximum(0.5 * spacing, 3).astype(int), strict=True):
        part = (slice(max(v - half, 0), min(v + half + 1, height)), slice(max(u - half, 0), min(u + half + 1, width)))
        if grey[part].size:
            low, high = np.percentile(grey[part], _EDGE)
            widths.append((high - low) / max(float(np.percentile(steep[part], 95)), 1e-9))
    return float(np.median(widths)) if widths else float("nan")
