"""Two cameras, places of a board before them, and its corners: rendered and found, or projected with noise."""

from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tspslam.datasets.synthetic.boards import render_board
from tspslam.types import Camera
from tspslam.vision.calibration.board import BoardView, Charuco, Chessboard, Corners, detect

CHESSBOARD, CHARUCO = Chessboard(9, 6, 0.025), Charuco(5, 7, 0.04, 0.028)
SIZE = (640, 480)
BASELINE = 0.12
T_RIGHT_LEFT = np.eye(4)
T_RIGHT_LEFT[:3, :3] = Rotation.from_euler("xyz", [0.4, -1.2, 0.6], degrees=True).as_matrix()
T_RIGHT_LEFT[:3, 3] = np.array([-1, 0.01, 0.02]) / np.linalg.norm([-1, 0.01, 0.02]) * BASELINE
CAMERAS = {
    "brown": (
        Camera(530.0, 532.0, 325.0, 236.0, *SIZE, (-0.28, 0.08, 0.0005, -0.0003, 0.0)),
        Camera(534.0, 533.0, 316.0, 243.0, *SIZE, (-0.29, 0.09, -0.0004, 0.0003, 0.0)),
    ),
    "rational": (
        Camera(
            530.0, 532.0, 325.0, 236.0, *SIZE, (0.1, -0.05, 0.0005, -0.0003, 0.01, 0.35, 0.02, 0.0), lens="rational"
        ),
        Camera(534.0, 533.0, 316.0, 243.0, *SIZE, (0.1, -0.04, 0.0004, 0.0003, 0.01, 0.36, 0.02, 0.0), lens="rational"),
    ),
    "equidistant": (
        Camera(290.0, 291.0, 325.0, 236.0, *SIZE, (0.02, -0.005, 0.001, -0.0004), lens="equidistant"),
        Camera(292.0, 292.0, 316.0, 243.0, *SIZE, (0.018, -0.004, 0.001, -0.0003), lens="equidistant"),
    ),
}


def project(camera, xyz, T):
    """Pixels of points of the board."""
    K = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    turn, move, coefficients = cv2.Rodrigues(T[:3, :3])[0], T[:3, 3].copy(), np.array(camera.distortion)
    if camera.lens == "equidistant":
        return cv2.fisheye.projectPoints(xyz[None], turn, move, K, coefficients)[0].reshape(-1, 2)
    return cv2.projectPoints(xyz, turn, move, K, coefficients)[0].reshape(-1, 2)


@cache
def places(board=CHESSBOARD, lens="brown", count=12, tilt=40.0, span=(-0.5, 0.6), seed=3):
    """Poses of the board at which both cameras see all of it; `span` is where it is across, of the focal length."""
    rng, cameras, found = np.random.default_rng(seed), CAMERAS[lens], []
    middle, reach = board.corners.mean(axis=0), np.ptp(board.corners, axis=0).max()
    wide = 530 / cameras[0].fx
    while len(found) < count:
        angles = [rng.normal(0, 15), rng.uniform(-tilt, tilt), rng.uniform(-tilt, tilt)]
        z = rng.uniform(1.6, 3.0) * reach / wide
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("zxy", angles, degrees=True).as_matrix()
        T[:3, 3] = np.array([*(rng.uniform((span[0], -0.4), (span[1], 0.4)) * wide * z), z]) - T[:3, :3] @ middle
        sides = [project(c, board.corners, P) for c, P in zip(cameras, (T, T_RIGHT_LEFT @ T), strict=True)]
        if all((uv > 12).all() and (uv < np.array(SIZE) - 12).all() for uv in sides):
            found.append(T)
    return found


def exact_views(board=CHESSBOARD, lens="brown", noise=0.0, seed=0, moved=None, poses=None, **where):
    """Views with projected corners; `moved` maps a view's number to a motion of the board before the right image."""
    rng = np.random.default_rng(seed)
    found = []
    for k, T in enumerate(places(board, lens, **where) if poses is None else poses):
        sides = []
        for camera, P in zip(CAMERAS[lens], (T, T_RIGHT_LEFT @ T @ (moved or {}).get(k, np.eye(4))), strict=True):
            uv = project(camera, board.corners, P) + rng.normal(0, noise, (len(board.corners), 2))
            sides.append(Corners(np.arange(len(uv)), uv, board.corners, SIZE, 2.0))
        found.append(BoardView(f"{k:02}", *sides))
    return found


def images(board=CHESSBOARD, lens="brown", noise=0.01, blur=0.6, poses=None, **where):
    """Rendered pairs."""
    for k, T in enumerate(places(board, lens, **where) if poses is None else poses):
        both = zip(CAMERAS[lens], (T, T_RIGHT_LEFT @ T), strict=True)
        yield tuple(
            render_board(board, camera, P, noise=noise, blur=blur, seed=2 * k + side)
            for side, (camera, P) in enumerate(both)
        )


def rendered_views(board=CHESSBOARD, lens="brown", **where):
    """Views with the corners that are found in rendered pairs."""
    return [
        BoardView(f"{k:02}", detect(board, left), detect(board, right))
        for k, (left, right) in enumerate(images(board, lens, **where))
    ]
