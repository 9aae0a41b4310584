"""A finished run is read back as it was; what it has not is said with what it has."""

import json

import numpy as np
import pytest

import tspslam
from tests.sequences import SETTINGS, corridor
from tspslam import InputError, load_run
from tspslam.io import read_trajectory, write_bytes
from tspslam.run.config import resolve
from tspslam.run.pipeline import run as run_pipeline


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "corridor"
    run_pipeline(corridor(1.0), out, resolve(assignments=SETTINGS))
    return out


def test_a_run_has_its_path_keyframes_and_frames(folder):
    run = load_run(folder)
    record = json.loads((folder / "run.json").read_text())
    assert run.record == record
    assert len(run) == record["frames"] == len(run.trajectory) > len(run.keyframes) == record["keyframes"]
    assert run.keyframes == run.stored == tuple(int(path.stem) for path in sorted((folder / "frames").glob("*.npz")))
    frames = list(run.frames)
    assert [frame.index for frame in frames] == list(run.keyframes)
    assert all(len(frame.response) == len(frame.cloud) for frame in frames)
    assert run.frame(run.keyframes[-1]).stamp == frames[-1].stamp
    assert repr(run).endswith(f"complete, {len(run)} frames, {len(run.keyframes)} keyframes, {len(run.stored)} stored)")


def test_each_tracked_frame_has_a_pose_and_the_first_is_the_world(folder):
    run = load_run(str(folder))
    poses = np.array([run.pose(k) for k in range(len(run))])
    assert np.array_equal(poses, run.trajectory.T_world_camera)
    assert np.abs(poses[0] - np.eye(4)).max() < 1e-12
    with pytest.raises(InputError, match=f"has no pose of frame 999; expected one of {len(run)} tracked frames"):
        run.pose(999)


def test_a_frame_that_is_no_keyframe_is_named_as_such_with_the_nearest_that_are(folder):
    run = load_run(folder)
    middle = next(k for k in range(len(run)) if k not in run.keyframes)
    before = max(k for k in run.keyframes if k < middle)
    after = [f" and {k}" for k in run.keyframes if k > middle][:1]
    nearest = f"the nearest {before}{''.join(after)}"
    wanted = f"frame {middle}: it is no keyframe, so it has a pose and no file; expected one of its .*, {nearest}$"
    with pytest.raises(InputError, match=wanted):
        run.frame(middle)
    with pytest.raises(InputError, match=r"has no finished frame 999; expected one of its \d+ frames, the nearest"):
        run.frame(999)


def test_a_path_is_read_from_the_folder_of_its_run(folder):
    run, file = read_trajectory(folder), read_trajectory(folder / "trajectory.tum")
    assert np.array_equal(run.T_world_camera, file.T_world_camera)
    assert np.array_equal(run.stamp, file.stamp)
    with pytest.raises(InputError, match=r"is a folder without trajectory.tum; expected a run folder that has a path"):
        read_trajectory(folder / "frames")


def test_a_folder_without_a_finished_run_is_named(tmp_path, folder):
    with pytest.raises(InputError, match=r"holds no config.yaml of a run"):
        load_run(tmp_path)
    for name in ("config.yaml", "manifest.jsonl"):
        write_bytes(tmp_path / name, (folder / name).read_bytes())
    with pytest.raises(InputError, match=r"has no run.json yet; expected a finished run"):
        load_run(tmp_path)


@pytest.mark.parametrize("record", [
    {}, {"status": "complete", "frames": "3"}, {"status": "complete", "frames": 1, "per_frame": 7},
    {"status": "complete", "frames": 1, "per_frame": [{"index": 0}]}, {"status": "complete", "frames": -1},
])  # fmt: skip
def test_a_record_of_something_else_is_refused(tmp_path, folder, record):
    for name in ("config.yaml", "manifest.jsonl"):
        write_bytes(tmp_path / name, (folder / name).read_bytes())
    (tmp_path / "run.json").write_text(json.dumps(record))
    with pytest.raises(
        InputError, match=r"run.json: (is not what a run writes|holds per_frame, a int|row 0 of per_frame)"
    ):
        load_run(tmp_path)


def test_a_filtered_mesh_is_a_run_of_one_frame_without_a_path(tmp_path, small_pair):
    from PIL import Image

    from tspslam.run.mesh import filter_mesh
    from tspslam.topology.harmonic import Tmahf

    left, _, rig = small_pair
    Image.fromarray(left).save(tmp_path / "photo.png")
    (tmp_path / "mesh.obj").write_text("v 0 0 20\nv 1 0 20\nv 0 1 20\nv 1 1 -5\nf 1 2 3\nf 2 4 3\n")
    calib = f"{{fx: {rig.fx}, fy: {rig.fy}, cx: 100, cy: 100, width: 300, height: 200}}\n"
    (tmp_path / "calib.yaml").write_text(calib)  # a single camera: no baseline
    filter_mesh(tmp_path / "mesh.obj", tmp_path / "photo.png", tmp_path / "calib.yaml", tmp_path / "run", Tmahf())
    run = load_run(tmp_path / "run")
    assert (len(run), run.keyframes, run.stored) == (1, (), (0,))
    frame = run.frame(0)
    assert frame.rig == tspslam.Rig(rig.fx, rig.fy, 100, 100, width=300, height=200)
    assert frame.signals.vertex_ok.tolist() == [True, True, True, False]
    assert np.isnan(frame.cloud.disparity).all()
    with pytest.raises(InputError, match=r"is a folder without trajectory.tum"):
        _ = run.trajectory
