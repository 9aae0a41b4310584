from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tspslam import Frame, Rig
from tspslam.topology.complex import Complex, build_complex
from tspslam.types import Cloud, Image, Response, Signals, Surface

HEIGHT, WIDTH = 60, 90


def make_frame(
    *,
    side: int = 6,
    faces: NDArray[np.int32] | None = None,
    edges: NDArray[np.int32] | None = None,
    n: int | None = None,
    channels: int = 0,
    depth: float = 4.0,
    order: int = 1,
    name: str = "frame",
) -> Frame:
    """Build a grid of vertices over a smooth image; everything about it is deterministic."""
    v, u = (g.ravel() for g in np.meshgrid(np.linspace(5, 55, side), np.linspace(5, 85, side), indexing="ij"))
    n = side * side if n is None else n
    uv = np.stack([u, v], axis=1)[:n].astype(np.float64)
    z = depth + 0.02 * uv[:, 0] + 0.3 * np.sin(uv[:, 1])
    xyz = np.stack([z * (uv[:, 0] - 45) / 80, z * (uv[:, 1] - 30) / 80, z], axis=1)
    if faces is None:
        corner = np.array([r * side + c for r in range(side - 1) for c in range(side - 1)], np.int32)
        faces = np.concatenate(
            [
                np.stack([corner, corner + 1, corner + side], 1),
                np.stack([corner + 1, corner + side + 1, corner + side], 1),
            ]
        ).astype(np.int32)
    complex_ = build_complex(faces, n, edges)
    image = np.add.outer(np.arange(HEIGHT), np.arange(WIDTH)).astype(np.uint8)
    return Frame(
        index=0,
        stamp=0.0,
        name=name,
        rig=Rig(fx=80, fy=80, cx=45, cy=30, width=WIDTH, height=HEIGHT),
        image=image,
        cloud=Cloud(xyz, uv, 400 / np.maximum(z, 1e-9)),
        surface=Surface(faces),
        complex_=complex_,
        signals=_signals(uv, complex_, channels),
        response=Response(np.exp(1j * np.arange(n)) * (1 + np.arange(n)) / 10, order, np.ones(n, bool)),
    )


def _signals(uv: NDArray[np.float64], complex_: Complex, channels: int) -> Signals:
    def level(places: NDArray[np.float64]) -> NDArray[np.float64]:
        plain = places.sum(axis=1) / 255
        return plain if not channels else np.stack([plain / (c + 1) for c in range(channels)], axis=1)

    edge_uv = uv[complex_.edges].mean(axis=1).reshape(-1, 2)
    face_uv = uv[complex_.faces].mean(axis=1).reshape(-1, 2)
    E, F = len(edge_uv), len(face_uv)
    return Signals(
        *(level(uv), level(edge_uv), level(face_uv), edge_uv, face_uv),
        *(np.ones(E, np.int32), np.ones(F, np.int32), np.ones(len(uv), bool), np.ones(E, bool), np.ones(F, bool)),
    )


NO_FACES = np.empty((0, 3), np.int32)


def nothing_defined() -> Frame:
    frame = make_frame()
    n = frame.complex_.n
    signals = frame.signals
    return replace(
        frame,
        signals=replace(
            signals,
            vertex_ok=np.zeros_like(signals.vertex_ok),
            edge_ok=np.zeros_like(signals.edge_ok),
            face_ok=np.zeros_like(signals.face_ok),
        ),
        response=Response(np.zeros(n, complex), 1, np.zeros(n, bool)),
    )


def unseen_points() -> Frame:
    frame = make_frame()
    xyz, uv = frame.cloud.xyz.copy(), frame.cloud.uv.copy()
    uv[3], xyz[7], xyz[8, 2] = np.nan, np.nan, -1.0
    return replace(frame, cloud=Cloud(xyz, uv, frame.cloud.disparity))


def far_outlier() -> Frame:
    frame = make_frame(side=12)
    xyz = frame.cloud.xyz.copy()
    xyz[40] *= 1e6
    return replace(frame, cloud=Cloud(xyz, frame.cloud.uv, frame.cloud.disparity))


def of_image(image: Image) -> Frame:
    return replace(make_frame(), image=image)


ODD_FRAMES: dict[str, Callable[[], Frame]] = {
    "plain": make_frame,
    "no faces": lambda: make_frame(faces=NO_FACES, edges=np.array([[0, 1], [1, 2]], np.int32)),
    "no edges": lambda: make_frame(faces=NO_FACES),
    "one vertex": lambda: make_frame(faces=NO_FACES, n=1),
    "no vertex": lambda: make_frame(faces=NO_FACES, n=0),
    "one face": lambda: make_frame(faces=np.array([[0, 1, 6]], np.int32)),
    "nothing defined": nothing_defined,
    "unseen points": unseen_points,
    "far outlier": far_outlier,
    "all at one place": lambda: replace(
        make_frame(), cloud=Cloud(np.full((36, 3), 2.0), np.full((36, 2), 9.0), np.ones(36))
    ),
    "two channels": lambda: make_frame(channels=2),
    "three channels": lambda: make_frame(channels=3),
    "order 0": lambda: make_frame(order=0),
    "order 2": lambda: make_frame(order=2),
    "colour image": lambda: of_image(np.full((HEIGHT, WIDTH, 3), 90, np.uint8)),
    "16-bit image": lambda: of_image(np.full((HEIGHT, WIDTH), 9000, np.uint16)),
    "float image with NaN": lambda: of_image(np.full((HEIGHT, WIDTH), np.nan, np.float32)),
    "thin image": lambda: of_image(np.zeros((1, WIDTH), np.uint8)),
    "tall image": lambda: of_image(np.zeros((300, 20), np.uint8)),
    "hard name": lambda: make_frame(name="$x_{<script>alert(1)</script> 漢字\n\x00 " + "long " * 30),
}


@pytest.fixture
def frame() -> Frame:
    return make_frame()


@pytest.fixture(params=list(ODD_FRAMES))
def odd_frame(request: pytest.FixtureRequest) -> Frame:
    return ODD_FRAMES[request.param]()


@pytest.fixture
def build() -> Callable[..., Frame]:
    return make_frame


@pytest.fixture
def odd() -> Callable[[str], Frame]:
    return lambda which: ODD_FRAMES[which]()
