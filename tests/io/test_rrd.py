"""Maps of all kinds as recordings of rerun, which its own reader opens."""

from dataclasses import replace

import numpy as np
import pytest
from seen_maps import grey_of, seen_map, turned_poses

from tests.view.view_maps import ODD_MAPS
from tspslam import InputError, Trajectory
from tspslam.io.rrd import RecordedRun, write_rrd

rerun = pytest.importorskip("rerun", reason="the extra rerun is not installed")


def recorded(map_, start=0.0):
    def grey(n):
        return np.full((n, 3), 90, np.uint8)

    count = int(map_.keyframes[-1]) + 1
    index, T = np.arange(count), turned_poses(count)
    seen = np.where(index % 2, np.nan, 100.0)
    sizes = len(map_.surface.faces), len(map_.complex_.edges), len(map_)
    return RecordedRun("a run", map_, index, Trajectory(start + 0.1 * index, T), seen, *map(grey, sizes), grey_of(map_))


def places_of(path):
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun has no reader of chunks")
    reader = chunk.RrdReader(path)
    assert len(reader.recordings()) == len(reader.blueprints()) == 1
    return {each.entity_path for each in reader.stream().to_chunks()}


@pytest.mark.parametrize("name", ODD_MAPS)
def test_odd_maps_are_recorded(name, tmp_path):
    map_ = ODD_MAPS[name]()
    write_rrd(tmp_path / "a.rrd", recorded(map_))
    expected = {"/world", "/world/camera", "/world/keyframe", "/world/keyframe/image", "/landmarks_seen"}
    expected |= {"/world/map/vertices", "/world/map/faces"} if len(map_) else set()
    assert expected <= places_of(tmp_path / "a.rrd")


@pytest.mark.parametrize(("start", "kind"), [(0.0, "duration"), (1_403_715_273.26, "timestamp")])
def test_stamps_that_count_from_1970_are_dates(tmp_path, start, kind):
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun has no reader of chunks")
    write_rrd(tmp_path / "a.rrd", recorded(seen_map(), start))
    tables = [each.to_record_batch() for each in chunk.RrdReader(tmp_path / "a.rrd").stream().to_chunks()
              if each.entity_path == "/landmarks_seen"]  # fmt: skip
    assert {str(table.schema.field("stamp").type).split("[")[0] for table in tables} == {kind}


def test_recordings_of_other_runs_have_other_names(tmp_path):
    """Rerun joins recordings of one name."""
    chunk = pytest.importorskip("rerun.chunk", reason="this rerun has no reader of chunks")
    one, other = seen_map(), replace(seen_map(), xyz=seen_map().xyz + 1e-9)
    for name, map_ in (("a", one), ("b", other), ("c", one)):
        write_rrd(tmp_path / f"{name}.rrd", recorded(map_))
    first, second, again = (chunk.RrdReader(tmp_path / f"{name}.rrd").recordings()[0] for name in "abc")
    assert first == again != second


def test_without_rerun_one_line_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rerun", None)
    with pytest.raises(InputError, match=r"pip install 'tspslam\[rerun\]'"):
        write_rrd(tmp_path / "a.rrd", recorded(seen_map()))


def test_a_map_without_a_camera_that_rerun_knows_is_refused(tmp_path):
    map_ = seen_map()
    with pytest.raises(InputError, match="rerun: the camera has a skew of 1 px"):
        write_rrd(tmp_path / "a.rrd", recorded(replace(map_, rig=replace(map_.rig, skew=1.0))))
    assert not list(tmp_path.iterdir())
