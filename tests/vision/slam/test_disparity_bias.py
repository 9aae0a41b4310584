"""The offset of all disparities: what windows say of it, weighed, and what the whole path does, on numbers alone."""

from dataclasses import replace

import numpy as np
import pytest

from tspslam import Rig
from tspslam.vision.rig import project
from tspslam.vision.se3 import inverse
from tspslam.vision.slam.back_end.calibration_health import measure_health, settle_offset
from tspslam.vision.slam.back_end.disparity_bias import DisparityBias
from tspslam.vision.slam.keyframes.keyframe import Keyframe
from tspslam.vision.slam.keyframes.map import Map
from tspslam.vision.slam.least_squares.bundle import Observations, adjust

RIG = Rig(fx=350, fy=350, cx=300, cy=95, baseline=0.5, width=600, height=190)
NOISE = 0.3  # px
SHARED = np.hypot(0.01, 0.02 * 0.4)  # px: what images and gates add to the deviation of a whole offset of 0.4 px


def test_the_offset_is_the_weighed_mean_of_the_windows():
    offset = DisparityBias(0.3, window=4)
    assert (offset.value, offset.std) == (0.0, pytest.approx(0.3))
    rng = np.random.default_rng(0)
    for _ in range(400):
        measured = 0.2 + rng.normal(0, 0.05)
        information = 0.05**-2 + 0.3**-2  # a window begins at the same 0 ± 0.3
        offset.update(measured * 0.05**-2 / information, information**-0.5)
    assert offset.value == pytest.approx(0.2, abs=0.01)
    assert offset.std == pytest.approx(0.05 * (4 / 400) ** 0.5, rel=0.05)
    offset.update(5.0, 0.3)  # a window that saw nothing
    assert offset.value == pytest.approx(0.2, abs=0.01)


def test_an_offset_that_is_not_used_is_neither_applied_nor_estimated():
    bias = DisparityBias(0.3, window=4)
    bias.settle(0.8, 0.05)
    assert bias.correct(RIG).doffs == pytest.approx(-0.8)
    bias.is_used = False
    bias.settle(0.0, 0.0)
    assert (bias.value, bias.correct(RIG), bias.prior) == (0.8, RIG, (0.0, None))


def walk(seed, *, frames=18, step=2.0, turn=0.0, offset=0.0, per_point=0.0, rig=RIG, noise=NOISE):
    """A map as it is adjusted after a drive; `offset` (o, disparity, uv, frame) -> px, `per_point` of each point, px."""
    rng = np.random.default_rng(seed)
    angle = turn * np.arange(frames)
    T = np.tile(np.eye(4), (frames, 1, 1))
    T[:, 0, 0] = T[:, 2, 2] = np.cos(angle)
    T[:, 0, 2], T[:, 2, 0] = np.sin(angle), -np.sin(angle)
    T[:, :3, 3] = np.cumsum(step * T[:, :3, 2], axis=0) - step * T[0, :3, 2]
    start = rng.integers(0, frames, 90 * frames)
    depth = rng.uniform(4, 40, len(start))
    uv = rng.uniform((0, 0), (rig.width - 1, rig.height - 1), (len(start), 2))
    near = np.column_stack([(uv - (RIG.cx, RIG.cy)) * depth[:, None] / RIG.fx, depth])
    xyz = np.einsum("pij,pj->pi", T[start, :3, :3], near) + T[start, :3, 3]
    wrong, common = offset if callable(offset) else lambda d, uv, k: offset, rng.normal(0, per_point, len(start))
    kept = []
    for k in range(frames):
        inside = (xyz - T[k, :3, 3]) @ T[k, :3, :3]
        seen, disparity = project(RIG, inside), RIG.fx * RIG.baseline / inside[:, 2]
        is_in = (inside[:, 2] > 3) & (inside[:, 2] < 60) & ((seen >= 0) & (seen < (rig.width, rig.height))).all(axis=1)
        rows = np.flatnonzero(is_in & (start <= k) & (k < start + 5))
        found = disparity[rows] + wrong(disparity[rows], seen[rows], k) + common[rows]
        errors = rng.normal(0, noise, (3, len(rows)))
        kept.append((rows, seen[rows] + errors[:2].T, found + errors[2]))
    return adjusted(rig, T, xyz, kept)


def adjusted(rig, T, xyz, kept):
    """The map after an adjustment that starts from the truth, and its offset."""
    pose = np.repeat(np.arange(len(T)), [len(rows) for rows, _, _ in kept])
    point, uv, disparity = (np.concatenate(column) for column in zip(*kept, strict=True))
    sigma = np.full(len(point), NOISE)
    seen = Observations(pose, point, uv, disparity, sigma, sigma)
    found = adjust(rig, T, xyz, seen, offset=0.0, offset_sigma=3.0)
    made, ends = Map(replace(rig, doffs=rig.doffs - found.offset), window=7), np.cumsum([len(each[0]) for each in kept])
    made.xyz = found.xyz
    for k, (rows, places, depths) in enumerate(kept):
        spread = sigma[ends[k] - len(rows) : ends[k]]
        made.keyframes.append(Keyframe(k, found.T_world_camera[k], None, rows, places, depths, spread))
    return made


def health_of(made, rig=RIG):
    return measure_health(made, rig, NOISE, 3.0)


@pytest.mark.parametrize(("per_point", "noise"), [(0.0, NOISE), (0.6, NOISE), (0.0, NOISE / 2)])
def test_the_deviation_of_the_offset_is_honest(per_point, noise):
    """Also where a point is matched wrongly in all its keyframes, of which single observations know nothing.

    And where observations are better than they are said to be.
    """
    found = [health_of(walk(seed, frames=12, offset=0.4, per_point=per_point, noise=noise)) for seed in range(16)]
    own = [np.sqrt(health.offset.std**2 - SHARED**2) for health in found]
    errors = [(health.offset.value - 0.4) / std for health, std in zip(found, own, strict=True)]
    assert 0.6 < float(np.sqrt(np.mean(np.square(errors)))) < 1.6  # 16 draws: 1 ± 0.18
    thirds = [(third.value - 0.4) / third.std for health in found for third in health.thirds]
    assert 0.6 < float(np.sqrt(np.mean(np.square(thirds)))) < 1.6
    assert not any(health.unexplained for health in found)


@pytest.mark.parametrize(
    ("offset", "said", "size"),
    [
        (lambda d, uv, k: float(k >= 9), "the last and first third of the path", 1.0),
        (lambda d, uv, k: -1.5 * (d < 8), "far and near points", -1.5),
        (lambda d, uv, k: 1.5 * (uv[:, 0] > 300), "the right and left of the image", 1.5),
    ],
)
def test_what_one_offset_cannot_explain_is_said_and_not_used(offset, said, size):
    made, bias = walk(1, offset=offset), DisparityBias(3.0, window=7)
    bias.settle(-made.rig.doffs, 0.01)
    assert not settle_offset(bias, made, RIG, NOISE)
    large = dict(bias.health.unexplained)
    assert np.sign(large[said].value) == np.sign(size)
    assert bias.correct(RIG) == RIG


@pytest.mark.parametrize("size", [-1.0, 1.0, 2.0])
@pytest.mark.parametrize(("time", "turn", "step"), [(9, 0.0, 2.0), (2, 0.0, 2.0), (16, 0.0, 2.0), (9, 0.05, 1.0)])
def test_a_knock_is_found_with_its_time_and_size(size, time, turn, step):
    made = walk(8, turn=turn, step=step, offset=lambda d, uv, k: size * (k >= time))
    found = health_of(made).sure_step
    assert (found.before, found.after) == (time - 1, time)
    assert found.size.value == pytest.approx(size, abs=min(0.2, 3 * found.size.std))


def test_a_knock_is_found_where_pieces_of_a_path_meet(monkeypatch):
    monkeypatch.setattr("tspslam.vision.slam.back_end.calibration_health._PIECE", 8)
    for time in (7, 8, 9, 10):
        found = health_of(walk(9, frames=16, offset=lambda d, uv, k, time=time: float(k >= time))).sure_step
        assert (found.before, found.after) == (time - 1, time)


@pytest.mark.parametrize(
    "offset",
    [
        lambda d, uv, k: 0.1 * k,  # a slow drift is none, though it makes 1.7 px
        lambda d, uv, k: 0.4 * np.sin(k),
        lambda d, uv, k: 1.0 * (k == 9),
        lambda d, uv, k: 0.3 * (k >= 9),
        lambda d, uv, k: 0.0,
    ],
)
def test_what_drifts_or_goes_back_is_no_knock(offset):
    assert health_of(walk(10, offset=offset)).sure_step is None


def test_few_keyframes_know_no_step():
    assert health_of(walk(11, frames=4, offset=lambda d, uv, k: float(k >= 2))).step is None


def test_of_keyframes_without_common_landmarks_a_step_is_told_by_the_fit_alone():
    made = walk(12, offset=lambda d, uv, k: float(k >= 9))
    before, after = made.keyframes[8:10]
    only = np.isin(after.landmark, np.setdiff1d(after.landmark, before.landmark))
    cut = {name: getattr(after, name)[only] for name in ("landmark", "uv", "disparity", "sigma")}
    made.keyframes[9] = replace(after, **cut)
    found = health_of(made).sure_step
    assert found.size.value == pytest.approx(1.0, abs=3 * found.size.std)


def test_a_perfect_map_has_finite_deviations():
    health = health_of(walk(13, noise=0.0))
    assert 0 < health.offset.std < 0.02
    assert 0 < health.step.size.std < 0.01
    assert not health.unexplained


@pytest.mark.parametrize("share", [-0.08, 0.0, 0.08])
def test_a_camera_that_turns_knows_its_focal_length(share):
    """The rig says f (1 - share): the true one is more by that share of it."""
    wrong = replace(RIG, fx=RIG.fx * (1 - share), fy=RIG.fy * (1 - share), baseline=RIG.baseline / (1 - share))
    focal = health_of(walk(2, frames=12, turn=0.1, step=1.0, rig=wrong), wrong).focal
    assert focal.value == pytest.approx(share, abs=max(0.02, 3 * focal.std))
    assert focal.exceeds(0.05, 3) == (share != 0)


def test_a_wrong_baseline_cannot_be_seen():
    wrong = replace(RIG, baseline=1.1 * RIG.baseline)
    health = health_of(walk(3, rig=wrong), wrong)
    assert abs(health.offset.value) < max(0.05, 3 * health.offset.std)
    assert not health.unexplained
    assert abs(health.focal.value) < max(0.02, 3 * health.focal.std)


def test_a_still_camera_knows_what_it_knew_before():
    health = measure_health(walk(4, frames=6, step=0.0), RIG, NOISE, 0.3)
    assert health.offset.std == pytest.approx(0.3, rel=0.2)
    assert abs(health.offset.value) < 0.3
    assert not health.unexplained


def test_one_keyframe_tells_nothing():
    made = walk(5, frames=3)
    made.keyframes = made.keyframes[:1]
    bias = DisparityBias(0.3, window=7)
    assert health_of(made) is None
    assert settle_offset(bias, made, RIG, NOISE)
    assert bias.health is None


def test_long_paths_are_looked_at_piece_by_piece(monkeypatch):
    made = walk(6, frames=16, offset=0.4)
    whole = health_of(made).offset
    monkeypatch.setattr("tspslam.vision.slam.back_end.calibration_health._PIECE", 8)
    pieces = health_of(made).offset
    assert pieces.value == pytest.approx(whole.value, abs=3 * pieces.std)
    assert 0.85 * whole.std < pieces.std < 3 * whole.std  # three of eleven keyframes count twice


def test_poses_are_not_what_the_offset_is_judged_by():
    """Poses and points follow: moved together, they tell the same."""
    made = walk(7, frames=12, offset=0.4)
    moved = np.eye(4)
    moved[:3, 3] = 1.0, -2.0, 3.0
    before = health_of(made).offset
    made.xyz = made.xyz + moved[:3, 3]
    made.keyframes = [replace(frame, T_world_camera=moved @ frame.T_world_camera) for frame in made.keyframes]
    after = health_of(made).offset
    assert (after.value, after.std) == (pytest.approx(before.value, abs=1e-6), pytest.approx(before.std, rel=1e-6))
    assert inverse(moved)[0, 3] == -1.0
