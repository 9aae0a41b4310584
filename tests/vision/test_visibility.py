from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.types import Rig
from tspslam.vision.rig import project
from tspslam.vision.visibility import visible_uv

RIG = Rig(fx=60, fy=60, cx=31.5, cy=23.5, baseline=0.1, width=64, height=48)
SQUARE = np.array([[0, 1, 2], [0, 2, 3]])


def square(z: float, half: float = 0.3) -> np.ndarray:
    return np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]])


def wall(z: float, count: int = 400) -> np.ndarray:
    xy = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 2)) * z
    return np.column_stack([xy, np.full(count, z)])


def seen(uv: np.ndarray) -> np.ndarray:
    return np.isfinite(uv).all(axis=1)


def test_a_face_hides_what_stands_behind_it_and_nothing_else() -> None:
    xyz = np.concatenate([square(2.0), wall(4.0)])
    uv = visible_uv(RIG, xyz, SQUARE)
    u, v = project(RIG, xyz).T
    corners = project(RIG, square(2.0))
    behind = (u > corners[0, 0] + 1) & (u < corners[2, 0] - 1) & (v > corners[0, 1] + 1) & (v < corners[2, 1] - 1)
    beside = (u < corners[0, 0] - 1) | (u > corners[2, 0] + 1) | (v < corners[0, 1] - 1) | (v > corners[2, 1] + 1)
    assert seen(uv)[:4].all()
    assert behind[4:].sum() > 20
    assert not seen(uv)[4:][behind[4:]].any()
    assert seen(uv)[beside].all()
    np.testing.assert_array_equal(uv[seen(uv)], project(RIG, xyz)[seen(uv)])


def test_a_wall_of_points_hides_the_wall_behind_it() -> None:
    v, u = np.mgrid[0:48, 0:64].reshape(2, -1)
    near = np.column_stack([(u - 31.5) / 60, (v - 23.5) / 60, np.ones(u.size)]) * 2.0
    kept = seen(visible_uv(RIG, np.concatenate([near, wall(4.0)]), radius=1))
    assert kept[: len(near)].all()
    v = project(RIG, wall(4.0))[:, 1]
    assert not kept[len(near) :][(v > 0) & (v < 47)].any()
    assert seen(visible_uv(RIG, wall(4.0))).all()


def test_a_slanted_face_does_not_hide_its_own_corners() -> None:
    slanted = np.array([[-0.5, -0.3, 1.5], [0.6, -0.3, 3.0], [0.6, 0.4, 3.2], [-0.5, 0.4, 1.4]])
    assert seen(visible_uv(RIG, slanted, SQUARE)).all()


def test_the_order_of_points_changes_nothing() -> None:
    xyz = np.concatenate([wall(3.0), wall(2.0, 50)])
    order = np.random.default_rng(1).permutation(len(xyz))
    np.testing.assert_array_equal(visible_uv(RIG, xyz)[order], visible_uv(RIG, xyz[order]))


values = st.floats(-1e300, 1e300) | st.floats(-3, 3) | st.just(np.nan)


@given(st.lists(st.tuples(values, values, values), min_size=3, max_size=12), st.booleans())
@settings(max_examples=200, deadline=None)
def test_any_points_are_seen_where_they_project_or_not_at_all(rows: list[tuple[float, ...]], with_faces: bool) -> None:
    xyz = np.array(rows)
    uv = visible_uv(RIG, xyz, np.array([[0, 1, 2]]) if with_faces else None)
    np.testing.assert_array_equal(uv[seen(uv)], project(RIG, xyz)[seen(uv)])


def test_no_points_are_no_pixels() -> None:
    assert visible_uv(RIG, np.zeros((0, 3))).shape == (0, 2)
    assert visible_uv(RIG, np.zeros((0, 3)), np.zeros((0, 3), int)).shape == (0, 2)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"xyz": np.zeros((3, 2))}, r"\(N, 3\)"),
    ({"faces": [[0, 1]]}, r"faces are int64 of shape \(1, 2\)"),
    ({"faces": [[0.0, 1, 2]]}, "faces are float64"),
    ({"faces": [[0, 1, 7]]}, "vertices 0 to 7, expected 0 to 2"),
    ({"faces": [[0, -1, 2]]}, "vertices -1 to 2"),
    ({"radius": 16}, "radius, tolerance are 16"),
    ({"tolerance": np.nan}, "tolerance are 1, nan"),
])  # fmt: skip
def test_bad_input_is_named(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        visible_uv(RIG, **({"xyz": np.ones((3, 3))} | arguments))
