"""The calibration's health: shifted right images are found out, whole rigs are left alone, frames are mended."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tspslam import Rig
from tspslam.datasets import synthetic
from tspslam.io import read_frame
from tspslam.run.config import resolve
from tspslam.run.health import judge_calibration
from tspslam.run.offset import refit_frame
from tspslam.run.offset_doubts import border_doubts, describe_health, offset_doubts, rows_doubts, rows_offset
from tspslam.run.pipeline import run
from tspslam.run.sequence import SequenceRun
from tspslam.session import Settings
from tspslam.view._report_advice import ADVICE
from tspslam.vision.rig import back_project, covariance
from tspslam.vision.slam.back_end.disparity_bias import CalibrationHealth, DisparityBias
from tspslam.vision.slam.back_end.offset_steps import OffsetStep
from tspslam.vision.slam.least_squares.offsets import Estimate
from tspslam.vision.slam.odometry import StereoOdometry

from ..sequences import RIG, SETTINGS, SMALL_RIG, Kept, corridor

STREET = Rig(fx=353.5, fy=353.5, cx=301.0, cy=91.5, baseline=0.54, width=613, height=185)
FAULTS = synthetic.Faults(noise=0.01, blur=0.5)
FINE = Estimate(0.0, 0.02)
NOTHING = CalibrationHealth(Estimate(0.0, 0.02), (FINE, FINE, FINE), FINE, FINE, FINE, Estimate(0.0, 0.01))


def street(seed, length=16.0, **faults):
    world = synthetic.street(length, seed=seed)
    return Kept(world, STREET, replace(FAULTS, **faults), seed=seed)


def finished(pairs, rig=STREET):
    odometry = StereoOdometry(rig)
    for pair in pairs:
        odometry.process(replace(pair, rig=rig))
    odometry.finish()
    odometry.close()
    return odometry


def codes(odometry):
    return [each["code"] for each in offset_doubts(odometry.rig, odometry.mapper.bias, is_fixed=False)]


@pytest.mark.parametrize(("seed", "shift"), [(1, 1.0), (2, -1.0), (3, -2.0), (4, 2.0), (5, -0.6)])
def test_a_calibration_whose_disparities_are_off_is_found_out(seed, shift):
    """Offset of a rig whose `doffs` is wrong: measured less true; the same street with the right one has none."""
    pairs = street(seed)
    odometry = finished(pairs, replace(STREET, doffs=shift))
    offset, std = odometry.disparity_offset
    assert offset == pytest.approx(shift, abs=min(0.2, max(3 * std, 0.03)))
    assert codes(odometry) == ["disparity_offset"]
    assert codes(finished(pairs)) == []


def test_a_shifted_right_image_is_found_out():
    offset, std = finished(street(6, right_shift=(1.0, 0.0))).disparity_offset
    assert offset == pytest.approx(-1.0, abs=min(0.2, max(3 * std, 0.03)))


def test_a_rig_that_is_knocked_on_the_way_is_said_and_its_offset_is_not_used():
    before, after = street(7, 36.0), street(7, 36.0, right_shift=(1.0, 0.0))
    half = len(before) // 2
    odometry = finished([*(before[k] for k in range(half)), *(after[k] for k in range(half, len(after)))])
    health = odometry.mapper.bias.health
    assert health.drift.value == pytest.approx(-1.0, abs=0.4)
    step = health.sure_step
    assert step.before < half <= step.after
    assert step.size.value == pytest.approx(-1.0, abs=min(0.2, 3 * step.size.std))
    assert codes(odometry) == ["offset_unexplained"]
    assert odometry.map.rig == STREET


def biased(value, std, **health):
    bias = DisparityBias(1.0, window=1)
    bias.settle(value, std)
    bias.health = replace(NOTHING, **health)
    bias.is_used = not bias.health.unexplained
    return bias


@pytest.mark.parametrize(
    ("bias", "found"),
    [
        (biased(-0.98, 0.05), ["disparity_offset"]),
        (biased(-0.98, 0.4), []),
        (biased(0.4, 0.01), []),
        (biased(0.4, 0.01, far_near=Estimate(0.7, 0.1)), ["offset_unexplained"]),
        (biased(0.4, 0.01, right_left=Estimate(-0.7, 0.1)), ["offset_unexplained"]),
        (biased(2.0, 0.01, drift=Estimate(-0.9, 0.2)), ["offset_unexplained"]),
        (biased(0.0, 0.01, drift=None, far_near=Estimate(0.9, 0.4)), []),
        (biased(0.4, 0.01, step=OffsetStep(Estimate(-0.9, 0.1), 17, 20, 10)), ["offset_unexplained"]),
        (biased(0.4, 0.01, step=OffsetStep(Estimate(-0.9, 0.28), 17, 20, 10)), []),  # of ten times, one is that far
        (biased(0.4, 0.01, step=OffsetStep(Estimate(-0.4, 0.01), 17, 20, 10)), []),
        (biased(0.0, 0.01, focal=Estimate(0.08, 0.01)), ["focal_length"]),
        (biased(0.0, 0.01, focal=Estimate(0.08, 0.05)), []),
    ],
)
def test_what_is_large_and_certain_is_said_in_one_line(bias, found):
    said = list(offset_doubts(STREET, bias, is_fixed=False))
    assert [each["code"] for each in said] == found
    assert set(found) <= ADVICE.keys()
    assert not any("\n" in each["message"] or "nan" in each["message"] for each in said)


def test_a_step_is_said_by_the_indices_of_the_pairs_that_it_lies_between():
    bias = biased(0.4, 0.01, step=OffsetStep(Estimate(-0.9, 0.1), 17, 20, 10))
    frames = range(100, 200, 2)  # of a run of every other pair from 100 on
    (said,) = offset_doubts(STREET, bias, is_fixed=False, frames=frames)
    assert "between frames from 140 on and those up to 134" in said["message"]
    told = describe_health([0.0], bias, is_fixed=False, frames=frames)
    assert told["disparity_offset_step_frames"] == [134, 140]
    assert told["unexplained"] == ["it differs by -0.90 ± 0.1 px between frames from 140 on and those up to 134"]


def test_it_is_said_where_recordings_of_one_run_have_other_calibrations():
    recording = np.repeat([0, 1], [18, 12])
    at_border, within = (biased(0.4, 0.01, step=OffsetStep(Estimate(-0.9, 0.1), *k, 10)) for k in ((17, 18), (9, 12)))
    (said,) = border_doubts(at_border, recording, ["monday", "tuesday"])
    assert said["code"] in ADVICE
    assert said["message"].startswith("tuesday and monday")
    assert "of tuesday are off by -0.90 ± 0.1 px more" in said["message"]
    for bias in (within, biased(0.4, 0.01), DisparityBias(1.0, window=1)):
        assert not list(border_doubts(bias, recording, ["monday", "tuesday"]))


def test_what_is_not_explained_is_not_taken_off_frames_that_it_was_asked_for():
    bias = biased(0.4, 0.01, far_near=Estimate(0.7, 0.1))
    (said,) = offset_doubts(STREET, bias, is_fixed=True)
    assert "It is not used, and frames stay as they are" in said["message"]


def test_it_is_said_what_an_offset_does_to_depth_at_10_and_30_m():
    (said,) = offset_doubts(STREET, biased(-1.0, 0.05), is_fixed=False)
    assert (
        "10 m come out as 10.6 m (+5.5 %), 30 m as 35.6 m (+19 %)" in said["message"]
    )  # 190.9 px m: 19.1 and 6.4 px, less 1
    (fixed,) = offset_doubts(STREET, biased(-1.0, 0.05), is_fixed=True)
    assert "From frames, path and map it is taken off" in fixed["message"]


def test_rows_that_are_off_or_move_are_said():
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.01, 30)
    assert list(rows_doubts(noise)) == list(rows_doubts([])) == []
    (said,) = rows_doubts(noise + 0.9)
    assert said["code"] == "vertical_offset"
    assert "off by +0.9" in said["message"]
    (moved,) = rows_doubts(noise + np.where(np.arange(30) < 15, 0.0, 1.0))
    assert "moved by +1" in moved["message"] or "moved by +0.99" in moved["message"]
    found = rows_offset(noise)
    assert abs(found.value) < 3 * found.std
    assert rows_offset([0.1]) is None


def test_the_report_says_it_in_words():
    given = {
        "disparity_offset_px": 0.9, "disparity_offset_std_px": 0.05,
        "disparity_offset_thirds_px": [0.2, 0.9, 1.4], "disparity_offset_thirds_std_px": [0.1, 0.1, 0.1],
        "disparity_offset_drift_px": 1.2, "disparity_offset_drift_std_px": 0.1,
        "focal_length_error_percent": 8.0, "focal_length_error_std_percent": 1.0, "unexplained": ["early and late"],
    }  # fmt: skip
    found = {one.what: one for one in judge_calibration(given, STREET, None)}
    assert {what: one.verdict for what, one in found.items()} == {
        "Disparities": "wrong", "Over time": "wrong", "Focal length": "look at it",
    }  # fmt: skip
    assert "early and late. It is not used" in found["Disparities"].words
    assert "+0.20 ± 0.1, +0.90 ± 0.1, +1.40 ± 0.1 px" in found["Over time"].words
    assert "wrong baseline" in found["Focal length"].words
    whole = given | {"disparity_offset_thirds_px": [0.9, 0.9, 0.9], "disparity_offset_drift_px": 0.0}
    verdicts = [judge_calibration(whole | {"disparity_offset_step_px": step}, STREET, None)[1] for step in (None, 1.1)]
    assert [(one.what, one.verdict) for one in verdicts] == [("Over time", "fine"), ("Over time", "wrong")]
    vague = judge_calibration(given | {"focal_length_error_std_percent": 4.0}, STREET, None)
    assert vague[-1].verdict == "not known"
    spoiled = {"disparity_offset_thirds_px": [None, "x", 1.0], "unexplained": 3, "focal_length_error_percent": "y"}
    assert [one.what for one in judge_calibration(given | spoiled, STREET, None)] == ["Disparities"]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """The same drive with images shifted by 1 px: as it is, and with the offset taken off."""
    pairs, folder = corridor(4.0, right_shift=(1.0, 0.0)), tmp_path_factory.mktemp("runs")
    plain, fixed = ([*SETTINGS, f"mapping.fix_offset={word}"] for word in ("false", "true"))
    return pairs, [run(pairs, folder / name, resolve(assignments=said)) for name, said in (("a", plain), ("b", fixed))]


def frames_of(result):
    return [read_frame(path) for path in sorted((result.folder / "frames").glob("*.npz"))]


def test_the_offset_is_taken_off_frames_map_and_responses(runs):
    _, (plain, fixed) = runs
    taken = fixed.run["calibration"]["offset_taken_off_frames_px"]
    assert taken == plain.run["calibration"]["disparity_offset_px"] == pytest.approx(-1.0, abs=0.2)
    assert plain.run["calibration"]["offset_taken_off_frames_px"] == 0.0
    assert plain.run["calibration"]["offset_taken_off_path_px"] == taken
    rig = replace(RIG, doffs=RIG.doffs - taken)
    for before, after in zip(frames_of(plain), frames_of(fixed), strict=True):
        assert (before.rig, after.rig) == (RIG, rig)
        np.testing.assert_allclose(after.cloud.xyz, back_project(rig, after.cloud.uv, after.cloud.disparity), rtol=1e-9)
        assert len(after.response.z) == len(after.signals.vertex) == len(after.cloud)
        assert np.median(after.cloud.xyz[:, 2]) < 0.97 * np.median(before.cloud.xyz[:, 2])
    assert (fixed.folder / "trajectory.tum").read_bytes() == (plain.folder / "trajectory.tum").read_bytes()
    (said,) = [each["message"] for each in fixed.run["warnings"] if each["code"] == "disparity_offset"]
    assert "it is taken off" in said
    assert "Frames, path and map" in (fixed.folder / "report.html").read_text()


def test_points_of_frames_are_then_where_landmarks_are(runs):
    """Of landmarks that two keyframes saw, in the first frame: half of what the offset does is left at most."""
    _, (plain, fixed) = runs

    def off(result):
        with np.load(result.folder / "landmarks.npz") as stored:
            ids, xyz, seen = stored["landmark_id"], stored["xyz"], stored["observed_id"]
        frame = frames_of(result)[0]
        known = np.isin(frame.landmark, np.flatnonzero(np.bincount(seen) > 1))
        depth = xyz[np.searchsorted(ids, frame.landmark[known]), 2]
        return float(np.median(np.abs(frame.cloud.xyz[known, 2] / depth - 1)))

    assert off(fixed) < 0.5 * off(plain)


def test_numbers_of_frames_and_the_whole_are_those_of_the_mended_frames(runs):
    _, (_, fixed) = runs
    for frame in frames_of(fixed):
        numbers = json.loads((fixed.folder / "frames" / f"{frame.index:06d}.json").read_text())
        assert numbers["points"] == len(frame.cloud)
        assert numbers["faces"] == len(frame.complex_.faces)
        assert numbers["defined"] == int(frame.response.defined.sum())


def test_a_finished_run_with_the_flag_is_taken_as_it_is_and_a_stopped_one_ends_the_same(runs, tmp_path):
    pairs, (_, fixed) = runs
    settings = resolve(assignments=[*SETTINGS, "mapping.fix_offset=true"])
    again = run(pairs, fixed.folder, settings)
    assert again.run == fixed.run
    assert not again.times["frames"]

    class StoppedError(Exception):
        pass

    def stop(step):
        if step.stage == "map":
            raise StoppedError

    with pytest.raises(StoppedError):  # after the frames were mended
        run(pairs, tmp_path / "c", settings, on_step=stop)
    ended = run(pairs, tmp_path / "c", settings)
    assert ended.run == fixed.run
    for path in sorted((fixed.folder / "frames").iterdir()):
        assert path.read_bytes() == (tmp_path / "c" / "frames" / path.name).read_bytes()


class Part:
    """The first pairs of a sequence, as a folder that still grows has them."""

    def __init__(self, pairs, count):
        self._pairs, self._count, self.name, self.rig = pairs, count, pairs.name, pairs.rig

    def __len__(self):
        return self._count

    def __getitem__(self, index):
        return self._pairs[index]


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """A drive of few pairs whose frames are made anew, and what is left of it."""
    pairs = corridor(3.0, SMALL_RIG, right_shift=(1.0, 0.0))
    settings = resolve(assignments=[*SETTINGS, "mapping.fix_offset=true"])
    return pairs, settings, files_of(run(Part(pairs, len(pairs)), tmp_path_factory.mktemp("short"), settings))


def files_of(result):
    paths = [result.folder / "run.json", result.folder / "state.npz", *(result.folder / "frames").iterdir()]
    return {path.name: path.read_bytes() for path in paths}


@pytest.mark.parametrize(("name", "count"), [("rewrite", 2), ("save_rows", 1)])
def test_a_run_stopped_while_frames_are_made_anew_goes_on_there(short, tmp_path, monkeypatch, name, count):
    pairs, settings, expected = short
    calls, before = [], getattr(SequenceRun, name)

    def stop(*given):
        calls.append(given)
        if len(calls) == count:
            raise KeyboardInterrupt
        return before(*given)

    monkeypatch.setattr(SequenceRun, name, stop)
    with pytest.raises(KeyboardInterrupt):
        run(Part(pairs, len(pairs)), tmp_path, settings)
    monkeypatch.undo()
    ended = run(Part(pairs, len(pairs)), tmp_path, settings)
    assert not ended.times["frames"]
    assert files_of(ended) == expected


def test_frames_made_for_a_shorter_path_are_made_anew_where_pairs_have_come_since(short, tmp_path, caplog):
    pairs, settings, expected = short
    run(Part(pairs, len(pairs) - 2), tmp_path, settings)
    assert files_of(run(Part(pairs, len(pairs)), tmp_path, settings)) == expected
    assert "of a shorter path" in caplog.text


def test_a_frame_is_made_anew_with_other_cameras_as_if_it_had_been_seen_by_them(runs):
    _, (plain, _) = runs
    frame, rig = frames_of(plain)[0], replace(RIG, doffs=RIG.doffs + 0.7)
    made = refit_frame(frame, rig, Settings())
    np.testing.assert_allclose(made.cloud.xyz, back_project(rig, made.cloud.uv, made.cloud.disparity), rtol=1e-9)
    one = np.ones(len(frame.cloud))
    exact = [covariance(each, frame.cloud.uv, frame.cloud.disparity, one) for each in (RIG, rig)]
    moved = refit_frame(replace(frame, cloud=replace(frame.cloud, covariance=exact[0])), rig, Settings())
    np.testing.assert_allclose(moved.cloud.covariance, exact[1], rtol=1e-6, atol=1e-12)
    lost = refit_frame(frame, replace(RIG, doffs=-float(np.median(frame.cloud.disparity))), Settings())
    assert 0 < len(lost.cloud) < len(frame.cloud)
    assert len(lost.landmark) == len(lost.cloud)
