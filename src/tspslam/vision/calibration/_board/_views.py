"""Views of a board: what one is, and which of them a calibration cannot use."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...._checks import require, told
from ....errors import InputError
from ..targets import LEAST_CORNERS, Board, Charuco, Corners, aligned, require_board
from . import _judging as judging

_LARGEST_SIDE = 32_766  # px, as `rectification` takes
SAME_PLACE = 2.0  # px, in the median: a board in the hand moves by more from one view to the next
_SAME_CORNERS = 0.5  # of the corners of either view: a part of a board that is seen in both


class BoardView(NamedTuple):
    """The corners of a board in the two images of one moment."""

    name: str
    left: Corners
    right: Corners


def checked(board: Board, views: Iterable[BoardView]) -> list[BoardView]:
    """Views of one board, of names of their own; what is none is refused."""
    require_board(board)
    try:
        found = list(views)
    except TypeError as error:
        raise InputError(f"board: views are {told(views)}, expected a sequence of BoardView") from error
    names = set()
    for view in found:
        require(view, BoardView, "board: view")
        if not isinstance(view.name, str):
            raise InputError(f"board: name of a view is {told(view.name)}, expected text")
        if view.name in names:
            raise InputError(f"board: two views have the name {view.name!r:.80}, expected names that differ")
        names.add(view.name)
        for side, corners in (("left", view.left), ("right", view.right)):
            _check_corners(f"board: {side} corners of {view.name:.80}", corners)
    return found


def _check_corners(what: str, corners: Any) -> None:
    require(corners, Corners, what)
    shapes = [np.shape(each) for each in (corners.ids, corners.uv, corners.xyz)]
    count = len(corners.ids) if len(shapes[0]) == 1 else -1
    if shapes != [(count,), (count, 2), (count, 3)]:
        raise InputError(f"{what} have the shapes {shapes}, expected (N,), (N, 2) and (N, 3) of ids, uv and xyz")
    if 0 < count < LEAST_CORNERS:
        raise InputError(f"{what} are {count}, expected none, or {LEAST_CORNERS} or more")
    if not (np.isfinite(corners.uv).all() and np.isfinite(corners.xyz).all()):
        raise InputError(f"{what} have NaN or infinite places, expected finite ones, px and m")
    if count and (corners.xyz[:, 2].any() or np.linalg.matrix_rank(corners.xyz[1:, :2] - corners.xyz[0, :2]) < 2):
        raise InputError(f"{what} do not span the plane z = 0 of a board, expected corners in rows and columns")


def size_of(views: Sequence[BoardView]) -> tuple[int, int]:
    """Width and height of all images, px."""
    sizes = {corners.size: view.name for view in views for corners in (view.left, view.right)}
    if not sizes:
        raise InputError("board: there are no views, expected some")
    if len(sizes) > 1:
        (one, first), (other, second) = list(sizes.items())[:2]
        shown = f"{one[0]} x {one[1]} px ({first}) and {other[0]} x {other[1]} px ({second})"
        raise InputError(f"board: images have {shown}, expected one size")
    size = next(iter(sizes))
    if max(size) > _LARGEST_SIDE:
        raise InputError(f"board: images have {size[0]} x {size[1]} px, expected at most {_LARGEST_SIDE} a side")
    return size


def unusable(board: Board, views: Sequence[BoardView]) -> dict[str, str]:
    """Views without corners, blurred ones, and those that repeat another one, with the reason."""
    widths = np.array([[view.left.blur, view.right.blur] for view in views])
    found, used = {}, list[BoardView]()
    for view, marks, each in zip(views, judging.blurred(widths), widths, strict=True):
        if not (len(view.left) or len(view.right)):
            found[view.name] = "no corners found in either image"
        elif marks.any():
            side = int(np.nanargmax(each))
            found[view.name] = f"{('left', 'right')[side]} image is blurred: edges are {each[side]:.1f} px wide"
        elif (like := next((other.name for other in used if _is_repeated(board, other, view)), None)) is not None:
            found[view.name] = f"shows the board where {like} does"
        else:
            used.append(view)
    return found


def _is_repeated(board: Board, one: BoardView, other: BoardView) -> bool:
    """Whether a view has its corners where another one has: it tells nothing more."""
    return all(_is_same_place(board, *sides) for sides in ((one.left, other.left), (one.right, other.right)))


def _is_same_place(board: Board, one: Corners, other: Corners) -> bool:
    if not (len(one) and len(other)):
        return len(one) == len(other)
    _, mine, its = np.intersect1d(one.ids, other.ids, return_indices=True)
    if len(mine) < _SAME_CORNERS * max(len(one), len(other)):
        return False
    apart = one.uv[mine] - aligned(board, one, other).uv[its]
    return float(np.median(np.linalg.norm(apart, axis=1))) <= SAME_PLACE


def hint(board: Board, views: Sequence[BoardView]) -> str:
    """What to look at where no image has any corner; empty where some has."""
    if any(len(view.left) or len(view.right) for view in views):
        return ""
    columns, rows = board.columns, board.rows
    if isinstance(board, Charuco):
        other = f"; or is it {rows}x{columns}?" if rows != columns else "; is it another dictionary?"
        return f"; --charuco counts COLUMNSxROWS of squares{other}"
    return f"; --board counts inner corners: a board of {columns}x{rows} squares is {columns - 1}x{rows - 1}"
