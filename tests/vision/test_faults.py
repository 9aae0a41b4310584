"""What goes wrong with frames is survived, told, and does not bend the path more than it must."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tspslam import GeometryError, InputError, Session, Settings, Trajectory, evaluate_trajectory, load_map
from tspslam.datasets import KittiSequence, synthetic
from tspslam.datasets.synthetic import shapes
from tspslam.io import read_trajectory
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.vision.slam.least_squares import bundle
from tspslam.vision.slam.odometry import StereoOdometry, Tracking

from ..datasets.standard import kitti_seq1
from ..sequences import DETECTOR, RIG, SETTINGS, Kept, corridor


class Edited:
    """Pairs of a sequence, changed by a function of place and pair that may raise."""

    name = "edited"

    def __init__(self, sequence, edit, order=None):
        self.sequence, self.edit, self.rig = sequence, edit, sequence.rig
        self.order = list(order if order is not None else range(len(sequence)))

    def __len__(self):
        return len(self.order)

    def __getitem__(self, index):
        return replace(self.edit(index, self.sequence[self.order[index]]), index=index)


@pytest.fixture(scope="module")
def walk():
    return corridor(12.0)


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """Real pairs of a drive, with true poses."""
    return KittiSequence(kitti_seq1(tmp_path_factory.mktemp("kitti")))


def driven(source, out, settings=SETTINGS):
    return run(source, out, resolve(assignments=settings)).run


def path_error(out, sequence, order=None):
    kept = np.arange(len(sequence)) if order is None else np.asarray(order)
    found = read_trajectory(out / "trajectory.tum")
    truth = Trajectory(sequence.stamps[kept], sequence.truth[kept])
    return evaluate_trajectory(found, truth).ate_rmse_m


def black(pair):
    return replace(pair, left=np.zeros_like(pair.left), right=np.zeros_like(pair.right))


def unreadable(pair):
    raise InputError(f"{pair.name}: image is truncated, expected a whole file")


def gone(pair):
    return replace(pair, right=np.zeros_like(pair.right))


def brighter(pair):
    return replace(pair, **{s: cv2.convertScaleAbs(getattr(pair, s), alpha=1.6, beta=10) for s in ("left", "right")})


@pytest.mark.parametrize(
    ("spoil", "places", "code", "lost"),
    [(black, (9,), "tracking_lost", 1), (unreadable, (7, 8), "frame_skipped", 0), (gone, range(6, 12), None, 0),
     (brighter, range(10, 51), None, 0)],
)  # fmt: skip
def test_spoilt_real_frames_are_survived(street, tmp_path, spoil, places, code, lost):
    source = Edited(street, lambda k, pair: spoil(pair) if k in places else pair, range(30))
    result = driven(source, tmp_path / "run", [])
    assert result["status"] == ("degraded" if code else "complete")
    assert [w["code"] for w in result["warnings"] if w["code"] in ("tracking_lost", "frame_skipped")] == (
        [code] * (len(places) if spoil is unreadable else 1) if code else []
    )
    assert result["tracked"] == 30 - len(places) * (spoil is unreadable) - lost
    kept = [k for k in range(30) if spoil is not unreadable or k not in places]
    assert path_error(tmp_path / "run", street, kept) < 0.15


def test_frames_out_of_order_are_skipped_and_doubles_are_one_moment(walk, tmp_path):
    order = [0, 1, 2, 3, 3, 4, 2, 5, 6, 7, 8]
    result = driven(Edited(walk, lambda k, pair: pair, order), tmp_path / "run")
    assert (result["status"], result["frames"], result["tracked"]) == ("degraded", 11, 10)
    assert next(w["message"] for w in result["warnings"] if w["code"] == "frame_skipped").startswith("frame 6: ")
    assert "1 frames have the stamp of the one before" in str(result["warnings"])
    assert path_error(tmp_path / "run", walk, range(9)) < 0.01


@pytest.mark.parametrize("stamp", [float("nan"), float("inf"), "noon"])
def test_a_stamp_that_is_no_time_is_skipped(walk, tmp_path, stamp):
    result = driven(
        Edited(walk, lambda k, pair: replace(pair, stamp=stamp) if k == 2 else pair, range(5)), tmp_path / "r"
    )
    assert (result["status"], result["tracked"]) == ("degraded", 4)
    assert "expected seconds" in result["warnings"][0]["message"]


def test_black_frames_to_the_end_leave_the_run_degraded(walk, tmp_path):
    result = driven(Edited(walk, lambda k, pair: black(pair) if k > 4 else pair, range(12)), tmp_path / "run")
    assert (result["status"], result["frames"], result["tracked"]) == ("degraded", 12, 5)


def test_pictures_without_a_world_behind_them_are_lost(walk, tmp_path):
    def noise(k, pair):
        image = np.random.default_rng(k).integers(0, 255, pair.left.shape).astype(np.uint8)
        return replace(pair, left=image, right=np.roll(image, -9, axis=1))

    assert driven(Edited(walk, noise, range(6)), tmp_path / "run")["status"] == "degraded"


def test_nothing_to_finish_is_fine(walk):
    odometry = StereoOdometry(walk.rig)
    odometry.finish()
    assert len(odometry.trajectory) == 0
    assert odometry.disparity_offset == (0.0, pytest.approx(0.3))


def test_a_jump_in_time_is_bridged(walk, tmp_path):
    order = [*range(10), *range(14, 25)]
    result = driven(Edited(walk, lambda k, pair: pair, order), tmp_path / "run")
    assert result["status"] == "complete"
    assert path_error(tmp_path / "run", walk, order) < 0.02


def test_an_image_of_another_size_is_skipped(walk, tmp_path):
    def edit(k, pair):
        return replace(pair, left=pair.left[:-8], right=pair.right[:-8]) if k == 5 else pair

    result = driven(Edited(walk, edit, range(10)), tmp_path / "run")
    assert (result["status"], result["tracked"]) == ("degraded", 9)
    assert "frame 5" in result["warnings"][0]["message"]


@pytest.fixture(scope="module")
def turning():
    """A camera that turns on the spot in a room, by 2° a frame."""
    poses = np.stack([shapes.pose_at((0, 0, 0), (0, np.radians(2) * k, 0)) for k in range(30)])
    return Kept(replace(synthetic.room(), path=poses), RIG, synthetic.Faults(noise=0.01))


def test_a_pure_rotation_is_followed(turning, tmp_path):
    result = driven(Edited(turning, lambda k, pair: pair), tmp_path / "run")
    assert result["status"] == "complete"
    assert path_error(tmp_path / "run", turning) < 0.02


def test_a_turn_with_little_texture_is_followed_or_told(turning, tmp_path):
    def fade(k, pair):
        if not 12 <= k < 24:
            return pair
        return replace(pair, **{s: np.uint8(110 + getattr(pair, s) // 12) for s in ("left", "right")})

    result = driven(Edited(turning, fade), tmp_path / "run")
    error = path_error(tmp_path / "run", turning)
    assert error < 0.05 or result["status"] == "degraded"


def test_a_moving_object_over_a_third_of_the_view_does_not_take_the_camera_along(walk, tmp_path):
    patch = np.random.default_rng(0).integers(0, 255, (48, 32)).astype(np.uint8)
    patch = cv2.resize(patch, (RIG.width // 3, int(RIG.height * 0.9)), interpolation=cv2.INTER_CUBIC)

    def edit(k, pair):
        if k < 4:
            return pair
        left, right = pair.left.copy(), pair.right.copy()
        for image, shift in ((left, 0), (right, -20)):
            at = 30 + 6 * (k - 4) + shift
            width = max(0, min(patch.shape[1], image.shape[1] - at))
            image[20 : 20 + patch.shape[0], max(at, 0) : at + width] = patch[:, max(-at, 0) : width]
        return replace(pair, left=left, right=right)

    result = driven(Edited(walk, edit), tmp_path / "run")
    assert result["tracked"] == len(walk)
    assert path_error(tmp_path / "run", walk) < 0.06


def test_a_path_that_tears_is_no_clean_success(walk, tmp_path):
    order = [*range(6), *range(len(walk) - 1, len(walk) - 8, -1)]

    def edit(k, pair):
        turned = {s: np.ascontiguousarray(getattr(pair, s)[::-1]) for s in ("left", "right")} if k >= 6 else {}
        return replace(pair, stamp=float(k), **turned)

    assert driven(Edited(walk, edit, order), tmp_path / "run")["status"] == "degraded"


def test_an_adjustment_without_a_solution_leaves_the_map_and_is_told(walk, tmp_path, monkeypatch):
    solved = bundle._solved
    monkeypatch.setattr(bundle, "_solved", lambda S, b: None if len(b) > 7 else solved(S, b))
    odometry = StereoOdometry(walk.rig, detector=DETECTOR)
    tracked = [odometry.process(pair) for pair in walk]
    odometry.finish()
    assert odometry.unsolved > 0
    assert not any(one.is_lost for one in tracked)
    assert evaluate_trajectory(odometry.trajectory, Trajectory(walk.stamps, walk.truth)).ate_rmse_m < 0.1
    assert driven(Edited(walk, lambda k, pair: pair, range(10)), tmp_path / "run")["status"] == "degraded"


def test_a_frame_without_a_complex_keeps_its_place_in_the_path(walk, tmp_path):
    """Its pose stands, so the frames after it lie where they were seen from; a resumed run counts it too."""
    source = Edited(walk, lambda k, pair: black(pair) if k == 3 else pair, range(8))
    settings = [*SETTINGS, "tracking.every_frame=true"]
    result = driven(source, tmp_path / "run", settings)
    assert (result["status"], result["frames"], len(result["per_frame"])) == ("degraded", 8, 8)
    assert "no_complex" in result["per_frame"][3]
    world, path = load_map(tmp_path / "run"), read_trajectory(tmp_path / "run/trajectory.tum").T_world_camera
    assert world.keyframes.max() > 3
    np.testing.assert_allclose(world.T_world_camera, path[world.keyframes], atol=1e-6)
    again = driven(source, tmp_path / "run", settings)
    assert again == result


def test_a_surface_that_fails_at_a_keyframe_leaves_its_pose(walk):
    def failing(cloud):
        raise GeometryError("no surface")

    session = Session(walk.rig, Settings(detector=DETECTOR, surface=failing))
    frames = [session.process(walk[k]) for k in range(4)]
    assert len(frames) == len(session.trajectory) == 4
    with pytest.raises(GeometryError, match="no surface"):
        _ = frames[0].response


@pytest.mark.parametrize(
    ("name", "value"), [("window", "x"), ("window", 2.5), ("patience", None), ("every_frame", "x"),
                        ("sigma_disparity", True), ("keyframe_share", None)],
)  # fmt: skip
def test_settings_of_another_type_are_refused(name, value):
    with pytest.raises(InputError, match=f"tracking: {name} is"):
        Tracking(**{name: value})
