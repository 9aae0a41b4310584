"""Exports of a real run: the programs that they are for read the run's own cameras, images and path."""

import json
import os
import shutil
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from tspslam import InputError, OutputError, load_map, load_run
from tspslam.io import RunFolder, read_image
from tspslam.run import _export_rrd
from tspslam.run._export_rrd import export_rrd, recorded_run
from tspslam.run._export_runs import export_bag, export_colmap, export_nerfstudio, load_run_data
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.vision.se3 import inverse

from ..sequences import SETTINGS, SMALL_RIG, corridor


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "run"
    run(corridor(2.0, SMALL_RIG), out, resolve(assignments=SETTINGS))
    return out


@pytest.fixture(scope="module")
def data(folder):
    return load_run_data(folder)


@pytest.fixture
def copied(folder, tmp_path):
    return shutil.copytree(folder, tmp_path / "copied")


@pytest.fixture(scope="module")
def recording(folder, tmp_path_factory):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    path = tmp_path_factory.mktemp("rrd") / "run.rrd"
    export_rrd(folder, path)
    return path


def test_colmap_reads_the_run_with_small_errors(data, tmp_path):
    pycolmap = pytest.importorskip("pycolmap", reason="pycolmap has no wheel here")
    export_colmap(data.run.path, tmp_path / "out")
    model = pycolmap.Reconstruction(tmp_path / "out" / "sparse" / "0")
    assert len(model.images) == len(data.map_.keyframes) > 1
    assert len(model.points3D) == len(data.map_)
    assert all(point.track.length() > 1 for point in model.points3D.values())
    assert 0 < model.compute_mean_reprojection_error() < 1.0
    for k, index in enumerate(data.map_.keyframes.tolist()):
        image = model.images[k + 1]
        assert np.abs(image.cam_from_world().matrix() - inverse(data.run.pose(index))[:3]).max() < 1e-9
        written = read_image(tmp_path / "out" / "images" / image.name)
        assert np.array_equal(written[..., 0], data.run.frame(index).image)


def test_nerfstudio_s_cameras_are_the_run_s(data, tmp_path):
    export_nerfstudio(data.run.path, tmp_path / "out")
    meta = json.loads((tmp_path / "out" / "transforms.json").read_text())
    for frame, index in zip(meta["frames"], data.map_.keyframes.tolist(), strict=True):
        assert frame["file_path"] == f"images/{index:06d}.png"
        place = np.array(frame["transform_matrix"])[:3, 3]
        assert np.allclose(place, data.run.pose(index)[:3, 3][[0, 2, 1]] * (1, 1, -1), atol=1e-12)


def test_a_bag_has_every_tracked_frame_of_the_run(data, tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the extra ros is not installed")
    export_bag(data.run.path, tmp_path / "out")
    with rosbag2.Reader(tmp_path / "out") as reader:
        assert {each.topic: each.msgcount for each in reader.connections} == {
            "/tf_static": 1, "/path": 1, "/map_points": 1, "/tf": len(data.trajectory), "/pose": len(data.trajectory),
        }  # fmt: skip
        assert reader.start_time == round(data.trajectory.stamp[0] * 1e9)


def columns_of(recording, place):
    """Columns of one entity of a recording, as rerun's own reader gives them."""
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun has no reader of chunks")
    tables = [each.to_record_batch() for each in chunk.RrdReader(recording).stream().to_chunks()
              if each.entity_path == place]  # fmt: skip
    found = {}
    for table in tables:
        for name in table.schema.names:
            found.setdefault(name.split(":")[-1], []).extend(table.column(name).to_pylist())
    return found


def test_rerun_reads_the_map_and_the_cameras_of_the_run(recording, data):
    map_, T = data.map_, data.trajectory.T_world_camera
    (xyz,) = columns_of(recording, "/world/map/vertices")["positions"]
    assert np.array_equal(xyz, map_.xyz.astype(np.float32))
    faces = columns_of(recording, "/world/map/faces")
    corners = map_.xyz.astype(np.float32)[map_.surface.faces].reshape(-1, 3)
    assert np.array_equal(faces["vertex_positions"][0], corners)
    assert len(faces["vertex_colors"][0]) == len(corners)
    assert len(columns_of(recording, "/world/map/edges")["strips"][0]) == len(map_.complex_.edges)
    assert len(columns_of(recording, "/world/map/directions")["vectors"][0]) == map_.defined.sum()
    (strip,) = columns_of(recording, "/world/path")["strips"][0]
    assert np.array_equal(strip, T[:, :3, 3].astype(np.float32))
    camera = columns_of(recording, "/world/camera")
    order = np.argsort(camera["frame"])
    assert np.array_equal(np.array(camera["translation"])[order, 0], T[:, :3, 3].astype(np.float32))
    assert np.array_equal(np.array(camera["frame"])[order], np.arange(len(T)))


def test_rerun_s_camera_sees_the_observed_vertices_where_the_image_has_them(recording, data):
    rig, seen = data.map_.rig, data.map_.observations
    columns = columns_of(recording, "/world/keyframe/image/observed")
    K = np.array(columns_of(recording, "/world/keyframe/image")["image_from_camera"][0]).reshape(3, 3).T
    frames = columns["frame"]
    assert sorted(frames) == data.map_.keyframes.tolist()
    for place, frame in zip(columns["positions"], frames, strict=True):
        row = int(np.searchsorted(data.map_.keyframes, frame))
        assert np.allclose(place, seen.uv[seen.keyframe == row] + 0.5, atol=1e-3)
    assert np.allclose(K, [[rig.fx, 0, rig.cx + 0.5], [0, rig.fy, rig.cy + 0.5], [0, 0, 1]], atol=1e-3)


def test_rerun_has_the_images_and_the_landmarks_tracked(recording, data):
    from io import BytesIO

    from PIL import Image

    image = columns_of(recording, "/world/keyframe/image")
    kept = [blob for blob in image["blob"] if blob is not None]
    assert len(kept) == len(data.map_.keyframes)
    with Image.open(BytesIO(bytes(kept[0][0]))) as first:
        assert np.array_equal(np.asarray(first), data.image_of(0))
    seen = columns_of(recording, "/landmarks_seen")
    known = {row["index"]: row["landmarks_seen"] for row in data.run.record["per_frame"] if "landmarks_seen" in row}
    assert dict(zip(seen["frame"], (each[0] for each in seen["scalars"]), strict=True)) == known


def test_a_second_recording_holds_the_same_and_nothing_is_left_beside_it(recording, folder, tmp_path, monkeypatch):
    """Rerun stamps rows and views with the time: bytes differ, what is shown and the recording's name do not."""
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun has no reader of chunks")
    (tmp_path / "home").mkdir()
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("RERUN", "0")  # turns rerun off elsewhere
    (tmp_path / "again.rrd").write_bytes(b"older")
    export_rrd(folder, tmp_path / "again.rrd")
    assert not list((tmp_path / "home").iterdir())
    assert sorted(each.name for each in tmp_path.iterdir()) == ["again.rrd", "home"]
    one, other = (chunk.RrdReader(path) for path in (recording, tmp_path / "again.rrd"))
    assert one.recordings() == other.recordings()
    for place in ("/world/map/vertices", "/world/map/faces", "/world/camera", "/world/keyframe/image"):
        first, second = columns_of(recording, place), columns_of(tmp_path / "again.rrd", place)
        stamped = {name for name in first if "RowId" in name or name in ("log_time", "log_tick")}
        assert {k: v for k, v in first.items() if k not in stamped} == {
            k: v for k, v in second.items() if k not in stamped
        }


@pytest.mark.skipif(sys.platform == "win32", reason="no file size limit there")
def test_a_full_disk_leaves_no_recording(recording, folder, tmp_path):
    limit = int(0.999 * recording.stat().st_size)  # the last bytes do not fit, which is hardest to notice
    code = textwrap.dedent(f"""
        import resource
        from pathlib import Path
        from tspslam.errors import OutputError
        from tspslam.run._export_rrd import export_rrd
        resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
        try:
            export_rrd(Path({str(folder)!r}), Path({str(tmp_path / "a.rrd")!r}))
        except OutputError as error:
            print("refused:", error)
    """)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith(f"refused: {tmp_path}/a.rrd: cannot be written (")
    assert "\x1b" not in done.stdout
    assert not list(tmp_path.iterdir())


def test_a_rerun_that_hangs_is_ended(folder, tmp_path, monkeypatch):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    monkeypatch.setattr(_export_rrd, "_LONGEST", 0.01)
    with pytest.raises(OutputError, match=r"a.rrd: cannot be written \(rerun did not end within 0.01 s\)"):
        export_rrd(folder, tmp_path / "a.rrd")
    assert not list(tmp_path.iterdir())


def test_without_rerun_one_line_says_what_to_install(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'tspslam\[rerun\]'"):
        export_rrd(folder, tmp_path / "a.rrd")


def test_an_older_recording_stays_where_a_new_one_cannot_be_made(copied, tmp_path):
    pytest.importorskip("rerun", reason="the extra rerun is not installed")
    (tmp_path / "a.rrd").write_bytes(b"older")
    stored = min((copied / "frames").glob("*.npz"))
    stored.unlink()
    with pytest.raises(InputError, match=f"{stored.name}: is missing or was changed since the run"):
        export_rrd(copied, tmp_path / "a.rrd")
    assert (tmp_path / "a.rrd").read_bytes() == b"older"
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.rrd", "copied"]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("map.npz", "map.npz: is missing or was changed"),
        ("run.json", "has no run.json yet"),
        ("trajectory.tum", "trajectory.tum: is missing or was changed since the run"),
        ("config.yaml", "holds no config.yaml"),
    ],
)
def test_a_run_that_lacks_a_file_is_refused_by_the_file_s_name(copied, name, said):
    os.unlink(copied / name)
    with pytest.raises(InputError, match=said):
        load_run_data(copied)


def test_a_damaged_image_is_named_and_nothing_is_left(copied, tmp_path):
    last = sorted((copied / "frames").glob("*.npz"))[-1]
    last.write_bytes(last.read_bytes()[:-9])
    for export in (export_colmap, export_nerfstudio):
        with pytest.raises(InputError, match=f"{last.name}: is missing or was changed"):
            export(copied, tmp_path / "out")
        assert [each.name for each in tmp_path.iterdir()] == ["copied"]


def test_a_run_without_a_map_has_a_bag_of_its_path(copied, tmp_path):
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the extra ros is not installed")
    os.unlink(copied / "map.npz")
    lines = (copied / "manifest.jsonl").read_text().splitlines(keepends=True)
    (copied / "manifest.jsonl").write_text("".join(line for line in lines if '"map.npz"' not in line))
    export_bag(copied, tmp_path / "out")
    with rosbag2.Reader(tmp_path / "out") as reader:
        assert {each.topic for each in reader.connections} == {"/tf_static", "/path", "/tf", "/pose"}


def test_what_is_read_of_a_run_is_what_its_readers_give(data, folder):
    assert np.array_equal(data.map_.xyz, load_map(folder).xyz)
    assert len(data.trajectory) == len(load_run(folder).record["per_frame"])
    assert len(recorded_run(data).index) == len(data.trajectory)
    assert np.array_equal(data.image_of(0), load_run(folder).frame(0).image)
    assert RunFolder.open(folder).stored_frames == tuple(data.map_.keyframes.tolist())
