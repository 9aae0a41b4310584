"""Boards, and their corners in images."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from tspslam.datasets.synthetic.boards import render_board
from tspslam.errors import InputError
from tspslam.types import Camera
from tspslam.vision.calibration import targets
from tspslam.vision.calibration.targets import Charuco, Chessboard, Corners, aligned, detect

from .boards import CAMERAS, CHARUCO, CHESSBOARD, SIZE, images, places, project

LEFT = CAMERAS["brown"][0]


def turned(T, degrees, board):
    """The board turned in its own plane, about its middle."""
    middle, turn = np.eye(4), np.eye(4)
    middle[:3, 3] = board.corners.mean(axis=0)
    turn[:3, :3] = cv2.Rodrigues(np.array([0, 0, np.radians(degrees)]))[0]
    return T @ middle @ turn @ np.linalg.inv(middle)


@pytest.mark.parametrize("board", [CHESSBOARD, CHARUCO])
def test_corners_are_found_to_a_tenth_of_a_pixel(board):
    for T, (left, _) in zip(places(board, count=4), images(board, count=4), strict=True):
        found, true = detect(board, left), project(LEFT, board.corners, T)
        errors = [np.linalg.norm(found.uv - uv, axis=1) for uv in (true[found.ids], true[::-1][found.ids])]
        off = min(errors, key=np.sum)
        assert len(found) > 0.6 * len(board.corners)
        assert np.sqrt(np.mean(off**2)) < 0.1
        assert np.array_equal(found.xyz, board.corners[found.ids])


@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_a_board_that_lies_on_its_side_is_found_and_not_mirrored(degrees):
    T = turned(places(count=1)[0], degrees, CHESSBOARD)
    T[2, 3] *= 1.5
    found = detect(CHESSBOARD, render_board(CHESSBOARD, LEFT, T))
    true = project(LEFT, CHESSBOARD.corners, T)
    assert min(np.abs(found.uv - uv).max() for uv in (true, true[::-1])) < 0.5


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_pixels_of_all_types_give_the_same_corners(dtype):
    image = next(images(count=1))[0]
    expected = detect(CHESSBOARD, image)
    most = 1.0 if dtype == np.float32 else np.iinfo(dtype).max
    other = np.asarray(image / 255 * most, dtype)
    for given_image in (other, np.dstack([other] * 3)):
        assert np.abs(detect(CHESSBOARD, given_image).uv - expected.uv).max() < 0.1


def test_a_large_image_is_searched_small_and_refined_at_its_own_size():
    camera = Camera(1600.0, 1600.0, 1000.0, 700.0, 2000, 1400)
    T = places(count=1)[0]
    found = detect(CHESSBOARD, render_board(CHESSBOARD, camera, T))
    true = project(camera, CHESSBOARD.corners, T)
    assert min(np.sqrt(np.mean((found.uv - uv) ** 2)) for uv in (true, true[::-1])) < 0.1
    assert found.size == (2000, 1400)


def test_blur_is_the_width_of_an_edge():
    T = places(count=1)[0]
    widths = [detect(CHESSBOARD, render_board(CHESSBOARD, LEFT, T, blur=blur)).blur for blur in (0.6, 1.5, 3.0)]
    assert widths[0] < widths[1] < widths[2]
    assert 1 < widths[0] < 4


def test_an_image_without_a_board_has_no_corners():
    grey = np.random.default_rng(0).integers(0, 255, (120, 160)).astype(np.uint8)
    for board in (CHESSBOARD, CHARUCO):
        found = detect(board, grey)
        assert len(found) == 0
        assert found.size == (160, 120)


def test_a_part_of_a_charuco_board_is_enough_and_a_row_of_it_is_not():
    T, size = places(CHARUCO, count=1)[0], SIZE
    image = render_board(CHARUCO, LEFT, T)
    uv = project(LEFT, CHARUCO.corners, T)
    half = image.copy()
    half[:, : int(uv[:, 0].mean())] = 128
    found = detect(CHARUCO, half)
    assert 6 <= len(found) < len(detect(CHARUCO, image))
    assert np.abs(found.uv - uv[found.ids]).max() < 1
    assert found.size == size


def test_what_is_printed_of_a_charuco_board_is_what_opencv_draws():
    board, dots = Charuco(5, 7, 0.04, 0.03, "5X5_100"), 70  # a square; a module is a whole number of dots
    made = np.full((7 * dots, 5 * dots), 255, np.uint8)
    for x0, y0, x1, y1 in np.rint(board.black / 0.04 * dots * 1.0).astype(int):
        made[y0:y1, x0:x1] = 0
    drawn = board._detector().getBoard().generateImage((5 * dots, 7 * dots))
    assert np.mean(made != drawn) < 0.03  # edges of modules are rounded differently


def test_black_and_white_alternate_on_a_chessboard():
    black = CHESSBOARD.black
    assert len(black) == 10 * 7 // 2
    assert np.allclose(black[:, 2:] - black[:, :2], 0.025)
    assert np.isclose(black[:, :2].min(), -0.025)
    assert len(np.unique(np.rint(black[:, :2] / 0.025).sum(axis=1) % 2)) == 1


@pytest.mark.parametrize(
    ("size", "turns"), [((9, 6), 0), ((9, 6), 2), ((8, 6), 2), *(((6, 6), turns) for turns in range(4))]
)
def test_the_right_image_is_numbered_as_the_left_one(size, turns):
    board = Chessboard(*size, 0.03)
    uv = board.corners[:, :2] * 3000
    grid = np.rot90(uv.reshape(size[1], size[0], 2), turns).reshape(-1, 2)
    left = Corners(np.arange(len(uv)), uv, board.corners, SIZE)
    right = Corners(np.arange(len(uv)), grid - (30, 2), board.corners, SIZE)
    assert np.allclose(aligned(board, left, right).uv, uv - (30, 2))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Chessboard(1, 6, 0.02), "columns is 1, expected 3 to 100"),
        (lambda: Chessboard(9, 6, 25), "square is 25 m, expected 0.0001 to 10: 25 mm are 0.025"),
        (lambda: Chessboard(9, 6, float("nan")), "square is nan"),
        (lambda: Chessboard(9, 2, 0.02), "chessboard: rows is 2, expected 3 to 100"),
        (lambda: Chessboard(True, 6, 0.02), "columns is True"),
        (lambda: Charuco(5, 7, 0.04, 0.04), "marker is 0.04 m in squares"),
        (lambda: Charuco(2, 7, 0.04, 0.03), "ChArUco board: columns is 2, expected 3 to 100"),
        (lambda: Charuco(5, 7, 0.04, 0.03, "9X9"), "dictionary is '9X9'"),
        (lambda: Charuco(20, 20, 0.04, 0.03), "4X4_50 has 50 markers, but 200"),
    ],
)
def test_boards_that_cannot_be_are_refused(make, said):
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        make()


@settings(max_examples=15, deadline=None)
@given(arrays.arrays(np.uint8, st.tuples(st.integers(1, 60), st.integers(1, 60))))
def test_any_image_gives_corners_or_none(image):
    for board in (Chessboard(3, 3, 0.02), CHARUCO):
        found = detect(board, image)
        assert np.isfinite(found.uv).all()


@pytest.mark.parametrize("shape", [(1, 5000), (5000, 1), (3, 5000), (14, 60), (40, 9000), (100, 9000)])
def test_an_image_too_thin_for_a_board_has_no_corners(shape):
    image = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
    for board in (CHESSBOARD, CHARUCO):
        assert len(detect(board, image)) == 0


def test_floats_that_are_no_luminance_are_refused():
    for value in (np.nan, np.inf, 200.0):
        image = np.full((48, 64), 0.5)
        image[3, 4] = value
        with pytest.raises(InputError, match="expected 0 to 1"):
            detect(CHESSBOARD, image)


def test_what_is_no_board_or_no_corners_is_refused():
    image = np.zeros((48, 64), np.uint8)
    nothing = detect(CHESSBOARD, image)
    with pytest.raises(InputError, match="board is NoneType, expected a Chessboard or a Charuco"):
        detect(None, image)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="board is NoneType"):
        aligned(None, nothing, nothing)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="right is NoneType, expected a Corners"):
        aligned(CHESSBOARD, nothing, None)  # type: ignore[arg-type]


def test_what_is_no_image_is_refused():
    with pytest.raises(InputError, match="image"):
        detect(CHESSBOARD, "left.png")  # type: ignore[arg-type]


def test_a_lens_that_cannot_be_rendered_is_named():
    camera = Camera(300.0, 300.0, 32.0, 24.0, 64, 48, (0.5, 1.0), lens="eucm")
    with pytest.raises(InputError, match="lens is eucm"):
        render_board(CHESSBOARD, camera, places(count=1)[0])


def test_a_large_image_without_a_board_is_done_with_at_half_its_size(monkeypatch):
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 256, (60, 80)).astype(np.uint8)
    image = cv2.resize(coarse, (1280, 960), interpolation=cv2.INTER_CUBIC)
    looked, find = [], cv2.findChessboardCornersSB
    monkeypatch.setattr(cv2, "findChessboardCornersSB", lambda grey, *more, **named: looked.append(grey.shape) or find(grey, *more, **named))  # fmt: skip
    assert len(detect(CHESSBOARD, image)) == 0
    assert looked == [(480, 640)]
    looked.clear()
    assert len(detect(CHESSBOARD, image[:480, :640])) == 0
    assert looked == [(480, 640)]


def test_a_blurred_board_in_a_large_image_is_still_found(monkeypatch):
    """Where the detector of squares fails, half the size is enough to tell that there is a board."""
    T = np.eye(4)
    T[:3, 3] = -0.1, -0.06, 0.45
    grey = render_board(CHESSBOARD, LEFT, T)
    large = cv2.GaussianBlur(cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC), (0, 0), 3)
    monkeypatch.setattr(cv2, "findChessboardCorners", lambda *_, **__: (False, None))
    assert targets._may_hold(large, (CHESSBOARD.columns, CHESSBOARD.rows))
    assert len(detect(CHESSBOARD, large)) == CHESSBOARD.columns * CHESSBOARD.rows
