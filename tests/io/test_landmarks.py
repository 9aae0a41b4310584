import dataclasses

import numpy as np
import pytest

from tests.io.test_io_frames import RIG, assert_equal, entries, npy, saved, zipped
from tspslam import InputError, MapSnapshot
from tspslam.io.landmarks import read_landmarks, write_landmarks


def snapshot(**changes):
    """Three landmarks and two keyframes, of which the second sees all of them."""
    values = {
        "landmark_id": np.array([2, 3, 1 << 40]),
        "xyz": np.arange(9.0).reshape(3, 3),
        "keyframe": np.array([0, 7]),
        "T_world_camera": np.array([np.eye(4)] * 2),
        "start": np.array([0, 1, 4]),
        "observed_id": np.array([3, 1 << 40, 2, 3]),
        "uv": np.arange(8.0).reshape(4, 2),
        "disparity": np.array([1.5, np.nan, 2, 3]),
        "merged": np.array([[5, 3]]),
    }
    return MapSnapshot(**values | changes)


def stored(tmp_path):
    write_landmarks(tmp_path / "stored.npz", snapshot(), RIG)
    return (tmp_path / "stored.npz").read_bytes()


def test_landmarks_read_back_exactly_and_the_same_ones_give_the_same_bytes(tmp_path):
    first = stored(tmp_path)
    back, rig = read_landmarks(tmp_path / "stored.npz")
    assert_equal(back, snapshot())
    assert rig == RIG
    write_landmarks(tmp_path / "b.npz", back, rig)
    assert (tmp_path / "b.npz").read_bytes() == first


def test_a_path_without_landmarks_is_kept_too(tmp_path):
    nothing = np.empty(0, np.int64)
    empty = MapSnapshot(nothing, np.empty((0, 3)), nothing, np.empty((0, 4, 4)), np.zeros(1, np.int64), nothing,
                        np.empty((0, 2)), np.empty(0), np.empty((0, 2), np.int64))  # fmt: skip
    write_landmarks(tmp_path / "a.npz", empty, RIG)
    assert_equal(read_landmarks(tmp_path / "a.npz")[0], empty)


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (snapshot(landmark_id=np.array([2, 3, 3])), "landmark_id does not ascend"),
        (snapshot(landmark_id=np.array([-1, 3, 4])), "landmark_id holds -1, where 0 is the least"),
        (snapshot(xyz=np.full((3, 3), np.nan)), "xyz holds a value that is not finite"),
        (snapshot(xyz=np.zeros((2, 3))), "xyz has shape"),
        (snapshot(keyframe=np.array([7, 0])), "keyframe does not ascend"),
        (snapshot(T_world_camera=np.zeros((2, 4, 4))), "no rigid motion"),
        (snapshot(start=np.array([0, 4])), "start has shape"),
        (snapshot(start=np.array([0, 1, 3])), "start does not ascend from 0 to 4"),
        (snapshot(observed_id=np.array([3, 4, 2, 3])), "observed_id holds the number of no landmark"),
        (snapshot(observed_id=np.array([3, 2, 2, 3])), "observed_id holds a landmark twice in a keyframe"),
        (snapshot(uv=np.full((4, 2), np.inf)), "uv holds a value"),
        (snapshot(disparity=np.full(4, np.inf)), "disparity holds a value"),
        (snapshot(merged=np.array([[5, -1]])), "merged holds -1"),
        (RIG, "snapshot is Rig, expected a MapSnapshot"),
    ],
)
def test_inconsistent_landmarks_are_not_written(tmp_path, bad, said):
    with pytest.raises(InputError, match=said) as caught:
        write_landmarks(tmp_path / "a.npz", bad, RIG)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "a.npz").exists()


@pytest.mark.parametrize(
    ("part", "data", "said"),
    [
        ("version", npy(np.int64(2)), "format version 2 of a later tspslam, and the run is to be made anew"),
        ("magic", npy(np.zeros(17, np.uint8)), "mark of landmarks"),
        ("merged", None, "no array merged"),
        ("surprise", npy(np.zeros(3)), "unknown array"),
        ("uv", npy(np.zeros((4, 2)))[:-1], "claims 64 bytes and has 63"),
        ("rig", npy(np.zeros(7)), "rig: fx"),
        ("start", npy(np.array([0, -1, 4])), "start does not ascend"),
    ],
)
def test_each_fault_is_named_in_one_line(tmp_path, part, data, said):
    parts = entries(stored(tmp_path))
    parts.pop(f"{part}.npy", None)
    parts |= {} if data is None else {f"{part}.npy": data}
    with pytest.raises(InputError, match=said) as caught:
        read_landmarks(saved(tmp_path, zipped(parts)))
    assert "\n" not in str(caught.value)


def test_the_offset_of_the_disparities_is_kept(tmp_path):
    rig = dataclasses.replace(RIG, doffs=0.0608)
    write_landmarks(tmp_path / "a.npz", snapshot(), rig)
    assert read_landmarks(tmp_path / "a.npz")[1] == rig


def test_every_truncation_is_seen(tmp_path):
    data = stored(tmp_path)
    for size in range(1, len(data), 97):
        with pytest.raises(InputError):
            read_landmarks(saved(tmp_path, data[:size]))
