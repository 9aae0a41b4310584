"""Calibration of a pair of cameras from views of a board.

Each camera is first fitted alone, then all views of both together: every place of the board is one unknown that both
cameras share. Views that do not belong to the others are left out, and the spread of what was found is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ...errors import InputError
from ...types import LENSES, BoolArray, Camera, FloatArray, RawRig
from ._board import _judging as judging
from ._board._adjustment import Seen, Shape, Solution, adjust
from ._board._lens import EVIDENCE, FREED, HELD, check_lens, evidence, is_sound, lens_doubts
from ._board._start import matrix_of_pose, place_board, pose_of_matrix, start_camera, start_pose
from ._board._views import BoardView, checked, hint, size_of, unusable
from .targets import Board, Charuco, Corners, aligned, detect
from .targets import Chessboard as Chessboard

__all__ = [
    "Board", "BoardCalibration", "BoardResiduals", "BoardView", "Charuco", "Chessboard", "Corners", "ViewErrors",
    "aligned", "calibrate", "detect",
]  # fmt: skip

BOARD_LENSES = ("brown", "rational", "equidistant")
"""Models of lenses that `calibrate` fits."""
_ROUNDS = 8  # of leaving out views


@dataclass(frozen=True)
class ViewErrors:
    """How far the corners of one view are off, root mean square.

    Attributes
    ----------
    name : str
        Of the view.
    left, right : float
        Of its images, px; NaN where it has no corners there.
    rows : float
        Between the rows of both after rectification, px; NaN where only one camera sees the board.
    tilt : float
        Of the board against the left image, degrees.
    """

    name: str
    left: float
    right: float
    rows: float
    tilt: float


@dataclass(frozen=True, repr=False)
class BoardResiduals(Brief):
    """Each corner that was used.

    Attributes
    ----------
    view : (N,) int64
        Its view, a place in `BoardCalibration.views`.
    side : (N,) int64
        0 left, 1 right.
    uv : (N, 2) float64
        Where it was found, px.
    error : (N, 2) float64
        Where it should be, less `uv`, px.
    """

    view: NDArray[np.int64]
    side: NDArray[np.int64]
    uv: FloatArray
    error: FloatArray


@dataclass(frozen=True, repr=False)
class BoardCalibration(Brief):
    """Two cameras as a board shows them, and how well.

    Attributes
    ----------
    rig : RawRig
        The cameras.
    board : Chessboard or Charuco
        What was seen.
    held : tuple of str
        Coefficients of the lens that are held at 0, since the views do not determine them.
    views : tuple of ViewErrors
        Those that were used.
    left_out : dict of str
        Why each of the other views was not, by name.
    error : tuple of 2 float
        Root mean square of the corners' distances from where they should be, left and right, px.
    rows, rows_median : float
        Root mean square, and median size, of the differences of rows after rectification, px.
    coverage : tuple of 2 float
        Share of the cells of a grid of 8 x 6 over the left and the right image that have a corner.
    turn : float
        Largest angle between the planes of two views, degrees.
    focal_sd : tuple of 2 float
        Standard deviation of ``fx`` of the left and the right camera, px.
    baseline_sd : float
        Standard deviation of the distance of the cameras, m; an error of the board's square comes on top.
    residuals : BoardResiduals
        All corners.
    warnings : dict of str
        By code, what is worth to be done better.
    """

    rig: RawRig
    board: Board
    held: tuple[str, ...]
    views: tuple[ViewErrors, ...]
    left_out: dict[str, str]
    error: tuple[float, float]
    rows: float
    rows_median: float
    coverage: tuple[float, float]
    turn: float
    focal_sd: tuple[float, float]
    baseline_sd: float
    residuals: BoardResiduals
    warnings: dict[str, str]

    @property
    def baseline(self) -> float:
        """Distance of the cameras, m."""
        return float(np.linalg.norm(self.rig.matrix[:3, 3]))


def calibrate(board: Board, views: Sequence[BoardView], *, lens: str = "brown") -> BoardCalibration:
    """Calibrate two cameras from views of a board.

    The sum of squared distances between corners found and expected is minimised over both lenses, the pose of the
    right camera and all places of the board; corners that are far off count less (Huber). A view is left out whose
    error is above 2.5 times the median of all, and 5 robust standard deviations above it, and one that shows the board
    within 2 px (median of its corners, in both images) of where an earlier view does. ``k3`` (Brown's lens), ``k3`` to
    ``k6`` (rational), ``k3`` and ``k4`` (equidistant) are free only where the corners speak for them: where the
    Bayesian information criterion falls by more than 10, and no more of the image is without a ray.

    Parameters
    ----------
    board : Chessboard or Charuco
        What was seen.
    views : sequence of BoardView
        Corners as `detect` finds them; one side may have none.
    lens : str
        Model of both lenses: ``"brown"``, ``"rational"`` or ``"equidistant"`` (fisheye).

    Returns
    -------
    BoardCalibration

    Raises
    ------
    InputError
        If a view is none, two have one name, corners are not finite, sizes differ, fewer than 5 views can be used, the
        views leave the focal length open (a standard deviation above 1 %), the lens folds its image, the right camera
        is on the left, or the cameras are less than 5 mm or more than 5 m apart.

    Examples
    --------
    >>> nothing = detect(Chessboard(9, 6, 0.025), np.zeros((48, 64), np.uint8))
    >>> calibrate(Chessboard(9, 6, 0.025), [BoardView("a", nothing, nothing)])
    Traceback (most recent call last):
    tspslam.errors.InputError: board: 0 of 1 views can be used, expected 5 or more that both cameras see (a: no ...
    """
    if lens not in BOARD_LENSES:
        raise InputError(f"board: lens is {repr(lens)[:40]}, expected one of {', '.join(BOARD_LENSES)}")
    given = checked(board, views)
    size, left_out = size_of(given), unusable(board, given)
    used = {view.name: view._replace(right=aligned(board, view.left, view.right)) for view in given}
    used = {name: view for name, view in used.items() if name not in left_out}
    fit = _Fit(lens, size, used, dict(left_out), hint(board, given))
    fit.leave_out()
    if _free_more(fit) and len(fit.used) < len(used):
        fit.take_back(used, left_out)
        fit.leave_out()
    return _judged(board, fit)


class _Fit:
    """Views that are used, and the least squares over them."""

    def __init__(
        self, lens: str, size: tuple[int, int], used: dict[str, BoardView], left_out: dict[str, str], hint: str
    ) -> None:  # fmt: skip
        self.lens, self.size, self.used, self.left_out, self.hint = lens, size, used, left_out, hint
        self.held: tuple[str, ...] = HELD[lens]
        self.check_count()
        self.solution = self.solve(self._start())

    @property
    def seen(self) -> list[Seen]:
        """Corners of all views, each side that has some."""
        return [each for k in range(len(self.used)) for each in self.parts(k)]

    def parts(self, k: int) -> list[Seen]:
        """Corners of the k-th view that is used."""
        view = list(self.used.values())[k]
        return [Seen(k, side, c.xyz, c.uv) for side, c in enumerate((view.left, view.right)) if len(c)]

    @property
    def shape(self) -> Shape:
        return Shape(self.lens, 2, len(self.used))

    @property
    def cameras(self) -> tuple[FloatArray, FloatArray]:
        values = self.solution.values
        return values[self.shape.of_camera(0)], values[self.shape.of_camera(1)]

    @property
    def pose(self) -> FloatArray:
        return matrix_of_pose(self.solution.values[self.shape.of_pose])

    def free(self, shape: Shape) -> BoolArray:
        """Unknowns that are not held."""
        free = np.ones(shape.size, np.bool_)
        for side in range(shape.sides):
            for name in self.held:
                free[shape.of_camera(side).start + 4 + LENSES[self.lens].index(name)] = False
        return free

    def check_count(self) -> None:
        """Refuse too few views of both cameras."""
        both = sum(bool(len(view.left) and len(view.right)) for view in self.used.values())
        total = len(self.used) + len(self.left_out)
        if both < judging.FEWEST_VIEWS:
            why = "; ".join(f"{name}: {reason}" for name, reason in list(self.left_out.items())[:3])
            raise InputError(
                f"board: {both} of {total} views can be used, expected {judging.FEWEST_VIEWS} or more that both "
                f"cameras see{f' ({why})' if why else ''}{self.hint}"
            )

    def solve(self, start: FloatArray) -> Solution:
        """Least squares over the views that are used."""
        return adjust(self.shape, self.seen, start, self.free(self.shape))

    def _start(self) -> FloatArray:
        """Each camera alone, the pose on which most views agree, and the places of the board."""
        alone = [self._fit_alone(side) for side in (0, 1)]
        pose = start_pose(alone[0][1], alone[1][1])
        back = np.linalg.inv(matrix_of_pose(pose))
        places = {k: pose_of_matrix(back @ matrix_of_pose(place)) for k, place in alone[1][1].items()} | alone[0][1]
        return np.concatenate([alone[0][0], alone[1][0], pose, *(places[k] for k in range(len(self.used)))])

    def _fit_alone(self, side: int) -> tuple[FloatArray, dict[int, FloatArray]]:
        seen = [each for each in self.seen if each.side == side]
        camera, places = start_camera(self.lens, self.size, seen)
        order = [each.place for each in seen]
        shape = Shape(self.lens, 1, len(seen))
        start = np.concatenate([camera, *(places[k] for k in order)])
        renumbered = [replace(each, place=k, side=0) for k, each in enumerate(seen)]
        values = adjust(shape, renumbered, start, self.free(shape)).values
        return values[shape.of_camera(0)], {k: values[shape.of_place(at)] for at, k in enumerate(order)}

    def errors(self) -> list[judging.Judged]:
        """How far each view is off."""
        rig, found, at = self.rig(), [], 0
        for k in range(len(self.used)):
            sides, parts = [float("nan")] * 2, self.parts(k)
            for each in parts:
                sides[each.side] = judging.rms(self.solution.residuals[at])
                at += 1
            rows = judging.rms(self.rows(rig, k)) if len(parts) == 2 else float("nan")
            normal = matrix_of_pose(self.solution.values[self.shape.of_place(k)])[2, 2]
            found.append(
                judging.Judged(sides[0], sides[1], rows, float(np.degrees(np.arccos(np.clip(abs(normal), 0, 1)))))
            )
        return found

    def rows(self, rig: RawRig, k: int) -> FloatArray:
        """Differences of rows of the corners that both images of a view have, after rectification."""
        view = list(self.used.values())[k]
        _, left, right = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
        pair = [Seen(k, side, c.xyz[at], c.uv[at]) for side, c, at in ((0, view.left, left), (1, view.right, right))]
        return judging.row_errors(self.lens, self.cameras, rig, *pair)

    def rig(self) -> RawRig:
        """What was found."""
        left, right = (self._camera(numbers) for numbers in self.cameras)
        rows = [tuple(map(float, row)) for row in self.pose]
        return RawRig(left, right, tuple(rows))  # type: ignore[arg-type]

    def _camera(self, numbers: FloatArray) -> Camera:
        fx, fy, cx, cy = map(float, numbers[:4])
        return Camera(fx, fy, cx, cy, *self.size, distortion=tuple(map(float, numbers[4:])), lens=self.lens)

    def leave_out(self) -> None:
        """Leave out views that do not belong to the others, until all do."""
        for _ in range(_ROUNDS):
            errors = self.errors()
            limit = judging.limit_of(np.array([each[:2] for each in errors]))
            bad = [k for k, each in enumerate(errors) if np.nanmax(each[:2]) > limit]
            if not bad:
                return
            names = list(self.used)
            for k in bad:
                reason = judging.why_bad(self.lens, self.cameras, self.parts(k), errors[k], limit)
                self.left_out[names[k]] = reason
            self._keep([k for k in range(len(names)) if k not in bad])

    def take_back(self, used: dict[str, BoardView], left_out: dict[str, str]) -> None:
        """Use all views again: those that a lens of fewer coefficients could not fit may belong to this one."""
        cameras, pose, numbers = self.cameras, self.pose, self.solution.values[: self.shape.of_pose.stop]
        self.used, self.left_out = used, left_out
        places = []
        for k in range(len(used)):
            first = self.parts(k)[0]
            place = place_board(self.lens, cameras[first.side], first)[0]
            places.append(pose_of_matrix(np.linalg.inv(pose) @ matrix_of_pose(place)) if first.side else place)
        self.solution = self.solve(np.concatenate([numbers, *places]))

    def _keep(self, kept: list[int]) -> None:
        names, shape, values = list(self.used), self.shape, self.solution.values
        places = [values[shape.of_place(k)] for k in kept]
        self.used = {names[k]: self.used[names[k]] for k in kept}
        self.check_count()
        self.solution = self.solve(np.concatenate([values[: shape.of_pose.stop], *places]))


def _free_more(fit: _Fit) -> bool:
    """Free coefficients that are held if the corners speak for them and the lens has as many rays with them."""
    before, held, rig = fit.solution, fit.held, fit.rig()
    count, tried = sum(each.size for each in before.residuals), []
    for names in FREED[fit.lens]:
        fit.held = tuple(name for name in held if name not in names)
        solution = fit.solve(before.values)
        tried.append((evidence(before.cost, solution.cost, count, 2 * len(names)), fit.held, solution))
    for gain, fit.held, fit.solution in sorted(tried, key=lambda each: -each[0]):
        if gain > EVIDENCE and is_sound(rig, fit.rig()):
            return True
    fit.held, fit.solution = held, before
    return False


def _judged(board: Board, fit: _Fit) -> BoardCalibration:
    values, covariance, shape = fit.solution.values, fit.solution.covariance, fit.shape
    seen, residuals = fit.seen, fit.solution.residuals
    sides = [np.concatenate([e.uv for e in seen if e.side == side]) for side in (0, 1)]
    halves = [judging.half_of(uv, fit.size) for uv in sides]
    focal_sd = [float(np.sqrt(covariance[at, at])) for at in (0, shape.of_camera(1).start)]
    spreads = [sd / camera[0] for sd, camera in zip(focal_sd, fit.cameras, strict=True)]
    turn = judging.largest_turn([values[shape.of_place(k)] for k in range(len(fit.used))])
    judging.check_determined(turn, spreads, halves)
    judging.check_pose(fit.pose)
    rig, errors = fit.rig(), fit.errors()
    check_lens(rig)
    both = [k for k, view in enumerate(fit.used.values()) if len(view.left) and len(view.right)]
    rows = np.concatenate([fit.rows(rig, k) for k in both])
    shares = tuple(judging.coverage(uv, fit.size) for uv in sides)
    total = tuple(
        judging.rms(np.concatenate([r for r, e in zip(residuals, seen, strict=True) if e.side == side]))
        for side in (0, 1)
    )
    warnings = judging.doubts(len(both), turn, spreads, shares, halves, total, judging.rms(rows)) | lens_doubts(rig)
    return BoardCalibration(
        rig, board, fit.held,
        tuple(ViewErrors(name, *each) for name, each in zip(fit.used, errors, strict=True)), fit.left_out,
        (total[0], total[1]), judging.rms(rows), float(np.median(np.abs(rows))), (shares[0], shares[1]), turn,
        (focal_sd[0], focal_sd[1]), _baseline_sd(fit), _collected(seen, residuals), warnings,
    )  # fmt: skip


def _baseline_sd(fit: _Fit) -> float:
    at = fit.shape.of_pose
    move = slice(at.start + 3, at.stop)
    t = fit.solution.values[move]
    direction = t / np.linalg.norm(t)
    return float(np.sqrt(direction @ fit.solution.covariance[move, move] @ direction))


def _collected(seen: Sequence[Seen], residuals: Sequence[FloatArray]) -> BoardResiduals:
    view = np.concatenate([np.full(len(each.uv), each.place) for each in seen])
    side = np.concatenate([np.full(len(each.uv), each.side) for each in seen])
    return BoardResiduals(view, side, np.concatenate([each.uv for each in seen]), np.concatenate(residuals))
