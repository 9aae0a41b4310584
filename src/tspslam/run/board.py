"""``tspslam calib board`` and ``calib sheet``: cameras from views of a board, and the board to print."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .._threads import both
from ..datasets._reader import StoredImages
from ..errors import InputError
from ..types import FloatArray
from ..vision.calibration._board._judging import CELLS
from ..vision.calibration.board import Board, BoardCalibration, BoardView, Charuco, calibrate, detect
from ..vision.calibration.formats.own import save_cameras
from .sequence import Step

MOST_VIEWS = 60  # that are used: more take longer, and cannot differ much
_LOOKED_AT = 600  # pairs of a longer recording in which the board is looked for
_NEAREST = 0.02  # of the image's diagonal: views whose corners are nearer in the mean are one view
Tell = Callable[[Step], None]


def find_views(
    board: Board, images: StoredImages, on_step: Tell | None = None
) -> tuple[list[BoardView], dict[str, str]]:
    """Look for a board in all pairs of a source, or in 600 of them that are evenly spread, and choose at most 60 views.

    Where more pairs show the board, as in a video, views are taken one after another, each time that which differs
    most from those taken: by the places of its corners, less where it is blurred.

    Parameters
    ----------
    board : Chessboard or Charuco
        What is looked for.
    images : StoredImages
        The pairs.
    on_step : callable, optional
        Called with a `Step` before each pair.

    Returns
    -------
    views : list of BoardView
        Those to calibrate with.
    unread : dict of str
        Why pairs could not be read, by name.
    """
    places = np.unique(np.linspace(0, len(images) - 1, min(len(images), _LOOKED_AT)).round().astype(int))
    views: list[BoardView] = []
    unread: dict[str, str] = {}
    taken: set[str] = set()
    for done, k in enumerate(places.tolist()):
        if on_step:
            on_step(Step("corners", done, len(places)))
        name = _unique(images.names[k], k, taken)
        taken.add(name)
        try:
            left, right = images.images(k)
            found = both(lambda image: detect(board, image), (left, right))
        except InputError as error:
            unread[name] = str(error)
            continue
        views.append(BoardView(name, *found))
    return (_chosen(board, views) if len(views) > MOST_VIEWS else views), unread


def _unique(name: str, k: int, taken: Collection[str]) -> str:
    while name in taken:
        name = f"{name} ({k})"
    return name


def _chosen(board: Board, views: list[BoardView]) -> list[BoardView]:
    """Views that differ, of those in which both cameras see the board."""
    seen = [view for view in views if len(view.left) and len(view.right)]
    if len(seen) <= MOST_VIEWS:
        return seen or views[:MOST_VIEWS]
    looks = np.array([_look(board, view) for view in seen])
    sharp = 1 / np.array([max(view.left.blur, view.right.blur) for view in seen])
    taken = [int(np.argmax(sharp))]
    away = np.linalg.norm(looks - looks[taken[0]], axis=1)
    while len(taken) < MOST_VIEWS and away.max() > _NEAREST:
        taken.append(int(np.argmax(away * sharp / sharp.max())))
        away = np.minimum(away, np.linalg.norm(looks - looks[taken[-1]], axis=1))
    return [seen[k] for k in sorted(set(taken))]


def _look(board: Board, view: BoardView) -> FloatArray:
    """Where the board's outermost corners would be in the left image, as a share of its diagonal; (8,)."""
    import cv2

    corners = board.corners[:, :2]
    low, high = corners.min(axis=0), corners.max(axis=0)
    outer = np.array([low, (high[0], low[1]), high, (low[0], high[1])])
    H, _ = cv2.findHomography(view.left.xyz[:, :2], view.left.uv)
    uv = np.hstack([outer, np.ones((4, 1))]) @ H.T
    return np.asarray((uv[:, :2] / uv[:, 2:]).ravel() / (2 * np.hypot(*view.left.size)))


def calibrate_from(
    board: Board, images: StoredImages, lens: str = "brown", on_step: Tell | None = None
) -> BoardCalibration:
    """Calibrate two cameras from a source of pairs.

    Parameters
    ----------
    board : Chessboard or Charuco
        What the cameras have seen.
    images : StoredImages
        The pairs, as `tspslam.datasets.views.open_views` opens them.
    lens : str
        As `calibrate` takes it.
    on_step : callable, optional
        Called with each `Step`.

    Returns
    -------
    BoardCalibration

    Raises
    ------
    InputError
        As `calibrate`.
    """
    views, unread = find_views(board, images, on_step)
    if not views:
        name, reason = next(iter(unread.items()), (images.name, "has no pairs"))
        raise InputError(reason if unread else f"{name}: {reason}")
    if on_step:
        on_step(Step("calibration"))
    found = calibrate(board, views, lens=lens)
    found.left_out.update(unread)
    return found


def write_calibration(found: BoardCalibration, output: Path, picture: Path | None) -> None:
    """Write the calibration file, and its picture.

    Parameters
    ----------
    found : BoardCalibration
        The cameras.
    output : path
        The file.
    picture : path, optional
        PNG file.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    save_cameras(found.rig, output)
    if picture is not None:
        from ..view.board import write_board_picture

        write_board_picture(found, picture)


def write_sheet(board: Board, output: Path) -> tuple[float, float]:
    """Write a board to print, at its true size.

    Parameters
    ----------
    board : Chessboard or Charuco
        What is printed.
    output : path
        PDF, SVG or PNG file.

    Returns
    -------
    tuple of 2 float
        Width and height of the page, mm.

    Raises
    ------
    InputError
        If the board does not fit the largest page.
    OutputError
        If the file cannot be written.
    """
    from ..view.sheet import write_sheet_file

    return write_sheet_file(board.black, name_of_board(board), output)


def name_of_board(board: Board) -> str:
    """Name a board by what one types for it.

    Parameters
    ----------
    board : Chessboard or Charuco
        The board.

    Returns
    -------
    str

    Examples
    --------
    >>> from tspslam.vision.calibration.board import Chessboard
    >>> name_of_board(Chessboard(9, 6, 0.025))
    '--board 9x6 --square 0.025'
    """
    size = f"{board.columns}x{board.rows} --square {board.square:g}"
    if isinstance(board, Charuco):
        return f"--charuco {size} --marker {board.marker:g} --dictionary {board.dictionary}"
    return f"--board {size}"


def describe_board(found: BoardCalibration) -> dict[str, Any]:
    """Describe a calibration for programs.

    Parameters
    ----------
    found : BoardCalibration
        The cameras.

    Returns
    -------
    dict
        Plain numbers, None for those that are not known.
    """
    views = [{key: None if value != value else value for key, value in asdict(view).items()} for view in found.views]
    return {
        "board": name_of_board(found.board), "lens": found.rig.left.lens, "held": list(found.held),
        "left": asdict(found.rig.left), "right": asdict(found.rig.right),
        "T_right_left": [list(row) for row in found.rig.T_right_left],
        "baseline_m": found.baseline, "baseline_sd_m": found.baseline_sd,
        "fx_sd_px": list(found.focal_sd), "error_px": list(found.error),
        "rows_px": found.rows, "rows_median_px": found.rows_median, "coverage": list(found.coverage),
        "turn_deg": found.turn, "views": views, "left_out": found.left_out,
        "warnings": [{"code": code, "message": message} for code, message in found.warnings.items()],
    }  # fmt: skip


def tabulate_board(found: BoardCalibration) -> list[str]:
    """Lines that tell a calibration: each view, what was found, how well, what would make it better.

    Parameters
    ----------
    found : BoardCalibration
        The cameras.

    Returns
    -------
    list of str
    """
    width = max(4, *(len(name) for name in [view.name for view in found.views] + list(found.left_out)))
    lines = [f"{'view':<{width}}  left, px  right, px  rows, px  tilt, °"]
    for view in found.views:
        sides = "".join(
            f"{_number(value, 2):>{n}}" for value, n in ((view.left, 10), (view.right, 11), (view.rows, 10))
        )
        lines.append(f"{view.name:<{width}}{sides}{view.tilt:>9.0f}")
    if any(value != value for view in found.views for value in (view.left, view.right)):
        lines.append(f"{'':<{width}}  - : no corners found in that image")
    lines += [f"{name:<{width}}  left out: {reason}" for name, reason in found.left_out.items()]
    return [*lines, "", *_findings(found)]


def _findings(found: BoardCalibration) -> list[str]:
    left, right, sd = found.rig.left, found.rig.right, found.focal_sd
    cells = f"{CELLS[0]} x {CELLS[1]}"
    lens = left.lens + (f", {', '.join(found.held)} held at 0" if found.held else "")
    return [
        f"lens          {lens}",
        f"focal length  {left.fx:.2f} ± {sd[0]:.2f} px left, {right.fx:.2f} ± {sd[1]:.2f} px right",
        f"baseline      {1000 * found.baseline:.2f} ± {1000 * found.baseline_sd:.2f} mm",
        f"corners off   {found.error[0]:.3f} px left, {found.error[1]:.3f} px right (root mean square)",
        f"rows differ   {found.rows:.3f} px (root mean square), {found.rows_median:.3f} px (median)",
        f"coverage      corners in {found.coverage[0]:.0%} of the left image's {cells} cells, "
        f"in {found.coverage[1]:.0%} of the right one's",
        f"planes        differ by up to {found.turn:.0f}°",
    ]


def _number(value: float, digits: int) -> str:
    return "-" if value != value else f"{value:.{digits}f}"
