"""Recordings of RGB-D cameras: layouts, cameras, clocks, units, what is wrong with bad ones; and the path of a room."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from tspslam.datasets import RgbdSequence, open_sequence
from tspslam.errors import InputError
from tspslam.io import RunFolder
from tspslam.io.trajectory import write_tum
from tspslam.run.pipeline import run
from tspslam.settings import Settings
from tspslam.types import Camera, FloatArray, RawRig, Trajectory
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.depth.sensor import SENSORS
from tspslam.vision.evaluate import evaluate_trajectory
from tspslam.vision.slam.odometry import StereoOdometry
from tspslam.vision.stereo.reconstruct import reconstruct

from .rgbd_folders import CAMERA, T0, Noise, room, spoiled, steps, write_tum_folder

FRAMES = 20
SENSOR_OF: dict[Noise, str] = {
    "none": "time_of_flight", "structured_light": "structured_light", "time_of_flight": "time_of_flight",
}  # fmt: skip


@pytest.fixture(scope="module")
def tum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a Kinect in a room."""
    return write_tum_folder(tmp_path_factory.mktemp("rgbd") / "walk", room(FRAMES), "structured_light")


@pytest.fixture
def small(tmp_path: Path, tum: Path) -> Path:
    """A folder of three pairs, to be spoiled."""
    folder = tmp_path / "walk"
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
        lines = (tum / f"{name}.txt").read_text().splitlines()[:4]
        for line in lines[1:]:
            shutil.copy(tum / line.split()[1], folder / name)
        (folder / f"{name}.txt").write_text("\n".join(lines) + "\n")
    for name in ("calib.yaml", "groundtruth.txt"):
        shutil.copy(tum / name, folder)
    return folder


def error_of(sequence: RgbdSequence, change: Callable[[int, FloatArray], None] | None = None) -> tuple[float, int]:
    """Error of the path as a share of its length, and frames lost; disparities may be changed before."""
    odometry, lost = StereoOdometry(sequence.rig), 0
    for k, pair in enumerate(sequence):
        if change is not None:
            assert pair.disparity is not None
            change(k, pair.disparity)
        lost += odometry.process(pair).is_lost
    odometry.finish()
    odometry.close()
    truth = sequence.truth
    assert truth is not None
    errors = evaluate_trajectory(odometry.trajectory, Trajectory(sequence.stamps, truth))
    length = float(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1).sum())
    return errors.ate_rmse_m / length, lost


@pytest.mark.parametrize(("noise", "most"), [("none", 0.003), ("structured_light", 0.005), ("time_of_flight", 0.005)])
def test_path_through_a_room_is_right_with_each_sensor(tmp_path: Path, noise: Noise, most: float) -> None:
    folder = write_tum_folder(tmp_path / "walk", room(FRAMES), noise)
    share, lost = error_of(RgbdSequence(folder, sensor=SENSORS[SENSOR_OF[noise]]))
    assert lost == 0
    assert share <= most


def test_half_the_depths_are_enough(tum: Path) -> None:
    def hide(_: int, disparity: FloatArray) -> None:
        disparity[:, : disparity.shape[1] // 2] = np.nan

    share, lost = error_of(RgbdSequence(tum), hide)
    assert lost == 0
    assert share <= 0.01


def test_frames_without_depths_are_tracked_by_bearings_or_lost_but_never_wrong(tum: Path) -> None:
    def hide(k: int, disparity: FloatArray) -> None:
        if 6 <= k < 10:
            disparity[:] = np.nan

    share, _ = error_of(RgbdSequence(tum), hide)
    assert share <= 0.02


def test_depths_of_the_cloud_scatter_as_its_covariance_says(tum: Path) -> None:
    walk, sequence = room(FRAMES), RgbdSequence(tum)
    for k in (0, FRAMES - 1):
        cloud = reconstruct(sequence[k])
        assert cloud.covariance is not None
        left, top = np.minimum(cloud.uv.astype(int), (CAMERA.width - 2, CAMERA.height - 2)).T
        a, b = cloud.uv[:, 0] - left, cloud.uv[:, 1] - top
        near = 1 / walk.depths[k]
        corners = [near[top, left], near[top, left + 1], near[top + 1, left], near[top + 1, left + 1]]
        true = 1 / (
            (1 - a) * (1 - b) * corners[0] + a * (1 - b) * corners[1] + (1 - a) * b * corners[2] + a * b * corners[3]
        )
        on_one = np.ptp(corners, axis=0) < 0.02 * corners[0]
        off = (cloud.xyz[:, 2] - true)[on_one] / np.sqrt(cloud.covariance[on_one, 2, 2])
        assert on_one.mean() > 0.8
        assert 0.7 <= np.sqrt(np.mean(off**2)) <= 1.5


def test_a_run_has_path_map_error_and_what_is_known_of_the_depths(tum: Path, tmp_path: Path) -> None:
    sequence = open_sequence(tum)
    assert isinstance(sequence, RgbdSequence)
    found = run(sequence, tmp_path / "run", Settings(), frames=range(8)).run
    assert found["tracked"] == 8
    assert found["evaluation"]["ate_rmse_m"] < 0.01
    assert found["depth"]["layout"] == "TUM"
    assert found["depth"]["calibration"] == "calib.yaml"
    assert 0.5 < found["depth"]["known_share"] < 1
    assert 0 <= found["depth"]["flying_share"] < 0.05
    names = {path.name for path in RunFolder.open(tmp_path / "run").path.iterdir()}
    assert {"map.vtu", "map.ply", "report.html", "trajectory.tum"} <= names


def test_depths_of_a_pair_are_those_of_the_map_and_scatter_as_the_sensor(small: Path) -> None:
    sequence = RgbdSequence(small)
    pair, rig = sequence[1], sequence.rig
    assert pair.disparity is not None
    assert pair.sigma is not None
    line = (small / "depth.txt").read_text().splitlines()[2]
    stored = np.asarray(Image.open(small / line.split()[1])) / 5000
    z, known = rig.fx * rig.baseline / pair.disparity, np.isfinite(pair.disparity)
    np.testing.assert_allclose(z[known], stored[known], rtol=1e-12)
    spread = pair.sigma * z / pair.disparity
    np.testing.assert_allclose(spread[known], SENSORS["structured_light"].sigma(z[known]), rtol=1e-3)
    np.testing.assert_array_equal(np.isnan(pair.sigma), ~known)
    assert (stored > 0).sum() - known.sum() < 0.02 * known.sum()


def test_truth_is_not_known_where_there_is_no_pose(small: Path) -> None:
    walk = room(FRAMES)
    write_tum(small / "groundtruth.txt", T0 + walk.stamps[:1], walk.truth[:1])
    truth = RgbdSequence(small).truth
    assert truth is not None
    np.testing.assert_allclose(truth[0], walk.truth[0], atol=1e-5)
    (small / "groundtruth.txt").unlink()
    assert RgbdSequence(small).truth is None


def test_images_pair_with_the_nearest_depths_and_clocks_are_told(tmp_path: Path) -> None:
    near = RgbdSequence(write_tum_folder(tmp_path / "near", room(4), late=0.004))
    np.testing.assert_allclose(near.apart, 0.004, atol=2e-6)
    assert not list(near.doubts())
    far = RgbdSequence(write_tum_folder(tmp_path / "far", room(4), late=0.014))
    (doubt,) = far.doubts()
    assert doubt["code"] == "depth_clock"
    assert "14.0 ms from their images" in doubt["message"]


def test_cameras_that_are_published_are_taken_by_the_folders_name_and_undistort(tmp_path: Path) -> None:
    folder = tmp_path / "rgbd_dataset_freiburg1_desk"
    for name, pixels in (("rgb", np.full((480, 640), 90, np.uint8)), ("depth", np.full((480, 640), 5000, np.uint16))):
        (folder / name).mkdir(parents=True)
        pixels[::7] += 3
        Image.fromarray(pixels).save(folder / name / "1.5.png")
        (folder / f"{name}.txt").write_text(f"1.5 {name}/1.5.png\n")
    sequence = RgbdSequence(folder)
    assert sequence.calibration.startswith("freiburg1: published for TUM")
    assert (sequence.rig.fx, sequence.rig.cy) == (517.3, 255.3)
    pair = sequence[0]
    assert pair.valid is not None
    assert pair.disparity is not None
    assert 0.9 < pair.valid.mean() < 1
    assert np.isnan(pair.disparity[~pair.valid]).all()


def test_y_of_icl_nuims_poses_is_turned_down(tmp_path: Path) -> None:
    folder = tmp_path / "living_room_traj2"
    turn = np.diag([1.0, -1.0, 1.0, 1.0])
    walk = room(4)
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for k in range(4):
        Image.fromarray(np.zeros((480, 640), np.uint8)).save(folder / f"rgb/{k}.png")
        Image.fromarray(np.full((480, 640), 9000, np.uint16)).save(folder / f"depth/{k}.png")
    (folder / "associations.txt").write_text("".join(f"{k} depth/{k}.png {k} rgb/{k}.png\n" for k in range(4)))
    write_tum(folder / "livingRoom2.gt.freiburg", np.arange(1.0, 4.0), (turn @ walk.truth @ turn)[1:])
    sequence = RgbdSequence(folder)
    assert (sequence.kind, sequence.rig.fy) == ("ICL-NUIM", 480.0)
    assert sequence.truth is not None
    assert np.isnan(sequence.truth[0]).all()
    np.testing.assert_allclose(sequence.truth[1:], walk.truth[1:], atol=1e-6)
    np.testing.assert_allclose(np.diff(sequence.stamps), 1 / 30)


def scannet(folder: Path) -> Path:
    """Two pairs of ScanNet's layout, depths of half the images' size."""
    walk = room(2)
    for name in ("color", "depth", "pose", "intrinsic"):
        (folder / name).mkdir(parents=True)
    for k in range(2):
        Image.fromarray(walk.images[k]).save(folder / f"color/{k}.png")
        Image.fromarray(steps(walk.depths[k][::2, ::2], 1000)).save(folder / f"depth/{k}.png")
    np.savetxt(folder / "pose/0.txt", walk.truth[0])
    np.savetxt(folder / "pose/1.txt", np.full((4, 4), -np.inf))
    K = np.array([[CAMERA.fx, 0, CAMERA.cx, 0], [0, CAMERA.fy, CAMERA.cy, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    half = K.copy()
    half[:2] /= 2
    np.savetxt(folder / "intrinsic/intrinsic_color.txt", K)
    np.savetxt(folder / "intrinsic/intrinsic_depth.txt", half)
    return folder


def test_depths_of_another_size_are_registered_and_poses_may_be_infinite(tmp_path: Path) -> None:
    sequence = RgbdSequence(scannet(tmp_path / "scene0000_00"))
    assert sequence.kind == "ScanNet"
    pair, rig = sequence[0], sequence.rig
    assert pair.disparity is not None
    z = rig.fx * rig.baseline / pair.disparity
    known = np.isfinite(z)
    assert known.mean() > 0.8
    off = np.abs(z - room(2).depths[0])[known]
    assert np.median(off) < 2e-3
    assert (off < 0.02 * z[known] + 0.02).mean() > 0.98
    assert sequence.truth is not None
    np.testing.assert_allclose(sequence.truth[0], room(2).truth[0])
    assert np.isnan(sequence.truth[1]).all()


def plain(folder: Path, unit: int = 1000) -> Path:
    walk = room(2)
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for k in range(2):
        Image.fromarray(walk.images[k]).save(folder / f"rgb/{k:03d}.png")
        Image.fromarray(steps(walk.depths[k], unit)).save(folder / f"depth/{k:03d}.png")
    save_cameras(CAMERA, folder / "calib.yaml")
    return folder


def test_plain_folders_need_a_unit_and_arrays_none(tmp_path: Path) -> None:
    folder = plain(tmp_path / "plain")
    with pytest.raises(InputError, match=r"depth map is uint16 without a unit, expected metres in one step"):
        RgbdSequence(folder)
    whole = RgbdSequence(folder, unit=0.001)[0].disparity
    for file in (folder / "depth").glob("*.png"):
        np.save(file.with_suffix(".npy"), room(2).depths[int(file.stem)].astype(np.float32))
    floats = open_sequence(folder)[0].disparity
    assert whole is not None
    assert floats is not None
    both = np.isfinite(whole) & np.isfinite(floats)
    assert both.mean() > 0.95
    assert np.abs(whole - floats)[both].max() < 0.5


def test_a_calibration_of_two_cameras_registers_the_depths(tmp_path: Path) -> None:
    folder = plain(tmp_path / "two")
    camera = Camera(CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy, CAMERA.width, CAMERA.height)
    aside = ((1.0, 0.0, 0.0, -0.025), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    save_cameras(RawRig(camera, camera, aside), folder / "calib.yaml")
    sequence = RgbdSequence(folder, unit=0.001)
    assert sequence.describe()["is_registered_here"] is True
    assert sequence[0].disparity is not None


def spoil_size(folder: Path) -> None:
    for file in (folder / "depth").glob("*.png"):
        Image.fromarray(np.full((120, 160), 9000, np.uint16)).save(file)


def spoil_clock(folder: Path) -> None:
    path = folder / "depth.txt"
    path.write_text(path.read_text().replace("\n13", "\n12"))


def spoil_depths(value: int, kind: type = np.uint16) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        for file in (folder / "depth").glob("*.png"):
            Image.fromarray(np.full((240, 320), value, kind)).save(file)

    return spoil


@pytest.mark.parametrize(("spoil", "message"), [
    (spoil_size, "depth map is 160 x 120 px, expected 320 x 240 as its camera's: depths of the colour camera's pixels"),
    (spoil_clock, "pairs 0 of 3 images with one of 3 depth maps: the nearest depth map is 1e.08 s from an image"),
    (spoil_depths(0), "no depth is known in 3 maps"),
    (spoil_depths(200, np.uint8), "depth map is uint8, expected 16 bits or floats"),
    (spoil_depths(100), "have a median of 0.02 m, expected 0.4 to 10 m: is the unit right"),
    (lambda folder: (folder / "calib.yaml").unlink(), "holds no calibration; expected calib.yaml"),
    (lambda folder: (folder / "depth.txt").write_text("1 ../secret.png\n"), "lists ../secret.png; expected files below"),
    (lambda folder: (folder / "rgb.txt").write_text(f"1 rgb/{'a' * 5000}.png\n"), r"rgb.txt: lists rgb/aaa.*too long"),
    (lambda folder: (folder / "depth.txt").write_text(f"1 {'a/' * 4000}b\n"), r"depth.txt: lists a/a/.*too long"),
    (lambda folder: (folder / "rgb.txt").write_text("nan rgb/1.png\n"), "rgb.txt: line 1 has a value that is not finite"),
    (lambda folder: (folder / "rgb.txt").write_text("# nothing\n"), "rgb.txt: has no line of values"),
    (lambda folder: (folder / "rgb.txt").write_text("1 rgb/none.png\n"), "none of which is there"),
    (lambda folder: (folder / "groundtruth.txt").write_text("1 0 0 0 0 0 0 1\n"), "has no pose of any of the 3 images"),
])  # fmt: skip
def test_bad_folders_are_refused_in_one_line(small: Path, spoil: Callable[[Path], object], message: str) -> None:
    spoil(small)
    with pytest.raises(InputError, match=message) as error:
        _ = RgbdSequence(small).truth
    assert "\n" not in str(error.value)


def test_millimetres_read_as_metres_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"read as steps of 1 m, have a median of [0-9.e+]+ m, expected"):
        RgbdSequence(plain(tmp_path / "plain"), unit=1.0)


def test_few_depths_are_said(small: Path) -> None:
    for file in (small / "depth").glob("*.png"):
        depth = np.array(Image.open(file))
        depth[40:] = 0
        Image.fromarray(depth).save(file)
    (doubt,) = RgbdSequence(small).doubts()
    assert doubt["code"] == "depth_holes"


def test_a_map_without_any_depth_is_said(small: Path) -> None:
    file = sorted((small / "depth").glob("*.png"))[1]
    Image.fromarray(np.zeros_like(np.array(Image.open(file)))).save(file)
    sequence = RgbdSequence(small)
    assert "depth_empty" not in {doubt["code"] for doubt in sequence.doubts()}
    assert [bool(np.isfinite(pair.disparity).any()) for pair in sequence] == [True, False, True]
    (doubt,) = (each for each in sequence.doubts() if each["code"] == "depth_empty")
    assert doubt["message"].startswith("no depth is known in 1 of the maps that were read, first in that of frame 1 (")


def test_depths_beyond_what_the_sensor_measures_are_said(small: Path) -> None:
    (doubt,) = (each for each in RgbdSequence(small, unit=0.001).doubts() if each["code"] == "depth_range")
    assert "outside of the 0.4 to 10 m that the sensor measures (median" in doubt["message"]
    assert "depth_range" not in {each["code"] for each in RgbdSequence(small).doubts()}


def test_many_stamps_that_do_not_pair_are_told_in_a_moment(small: Path) -> None:
    """As many as 200 000 x 200 000 differences would be 300 GB."""
    for name, first in (("rgb", 0.0), ("depth", 1e5)):
        file = (small / f"{name}.txt").read_text().split()[-1]
        (small / f"{name}.txt").write_text("".join(f"{first + 0.1 * k:.1f} {file}\n" for k in range(200_000)))
    with pytest.raises(InputError, match=r"the nearest depth map is [0-9.e+]+ s from an image in the median"):
        RgbdSequence(small)


def test_depths_that_scatter_more_than_the_sensor_are_said(small: Path) -> None:
    rng = np.random.default_rng(0)
    for file in (small / "depth").glob("*.png"):
        Image.fromarray(rng.integers(4000, 30_000, (240, 320)).astype(np.uint16)).save(file)
    assert [doubt["code"] for doubt in RgbdSequence(small).doubts()] == ["depth_flying", "depth_sensor"]


def test_a_sensor_that_scatters_more_than_is_said_is_told(small: Path) -> None:
    assert not list(RgbdSequence(small).doubts())
    assert 0.5 < RgbdSequence(small).describe()["scatter"] < 1.5
    (doubt,) = RgbdSequence(small, sensor=SENSORS["time_of_flight"]).doubts()
    assert doubt["code"] == "depth_sensor"


def test_unit_and_sensor_are_for_depths_alone(tmp_path: Path) -> None:
    (tmp_path / "mav0" / "cam0").mkdir(parents=True)
    with pytest.raises(InputError, match=r"has no depths, expected a folder of RGB-D with unit=0\.001"):
        open_sequence(tmp_path, unit=0.001)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(["rgb.txt", "depth.txt", "groundtruth.txt"]), data=st.data())
def test_any_text_is_a_recording_or_refused(small: Path, name: str, data: st.DataObject) -> None:
    path = small / name
    kept = path.read_bytes()
    changed = bytearray(kept)
    for _ in range(data.draw(st.integers(1, 3))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    try:
        path.write_bytes(bytes(changed[: data.draw(st.integers(1, len(changed)))]))
        sequence = RgbdSequence(small)
        assert len(sequence) <= 3
        assert sequence.truth is None or sequence.truth.shape == (len(sequence), 4, 4)
    except InputError:
        pass
    finally:
        path.write_bytes(kept)


def test_kinects_noise_is_as_wide_as_its_law() -> None:
    depth = np.full((200, 200), 3.0) + np.linspace(0, 0.3, 200)
    off = spoiled(depth, "structured_light", np.random.default_rng(0)) - depth
    assert np.std(off) == pytest.approx(float(SENSORS["structured_light"].sigma(3.15)), rel=0.1)


def test_a_sensor_that_is_none_is_refused_in_one_line(small: Path) -> None:
    with pytest.raises(InputError, match=r"sensor is .*, expected a DepthSensor: tspslam\.vision"):
        RgbdSequence(small, sensor="kinect.")  # type: ignore[arg-type]
