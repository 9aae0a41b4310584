import dataclasses
import io
import time

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import tspslam
from tests.io.test_io_frames import RIG, assert_equal, entries, npy, saved, zipped
from tspslam import InputError, OutputError, Response, Signals, Surface, TopologicalMap, build_complex, load_map
from tspslam.io import RunFolder, read_map, write_map
from tspslam.topological_map import Levels, Observations

FUZZ = settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
FACES = np.array([[0, 2, 1], [0, 2, 3]], np.int32)


def map_(**changes):
    """A map with every field filled, of three keyframes."""
    rng, complex_ = np.random.default_rng(3), build_complex(FACES, 5, edges=np.array([[3, 4]]))
    sizes = 5, len(complex_.edges), 2
    pose = np.array([[0.0, 0, 1, 2], [1, 0, 0, -3], [0, 1, 0, 5.5], [0, 0, 0, 1]])
    values = {
        "xyz": rng.normal(size=(5, 3)),
        "covariance": rng.normal(size=(5, 3, 3)),
        "surface": Surface(FACES),
        "complex_": complex_,
        "signals": Signals(
            *(rng.random(size) for size in sizes), *(rng.random((size, 2)) for size in sizes[1:]),
            *(np.arange(size, dtype=np.int32) for size in sizes[1:]), *(rng.random(size) < 0.5 for size in sizes),
        ),
        "view_count": Levels(*(np.arange(size, dtype=np.int32) % 4 for size in sizes)),
        "view_variance": Levels(*(rng.random(size) for size in sizes)),
        "best_view": Levels(*(np.arange(size, dtype=np.int32) % 4 - 1 for size in sizes)),
        "response_view": np.array([2, 0, 1, -1, -1], np.int32),
        "response": Response(rng.normal(size=5) + 1j * rng.normal(size=5), 1, np.arange(5) < 3),
        "direction": np.array([[1.0, 0, 0], [0, 0.6, -0.8], [0, 1, 0], [0, 0, 0], [0, 0, 0]]),
        "direction_spread": rng.random(5),
        "direction_count": np.array([1, 2, 3, 0, 0], np.int32),
        "landmark_id": np.array([3, 1 << 40, -1, 0, -1]),
        "observations": Observations(
            np.array([0, 2, 2, 5, 6, 6]), np.array([0, 2, 0, 1, 2, 1]), rng.normal(size=(6, 2)),
            np.array([1, np.nan, 2, 3, 4, 5]), rng.random(6),
        ),
        "keyframes": np.array([0, 4, 9]),
        "T_world_camera": np.array([np.eye(4), pose, pose @ pose]),
        "gain": np.array([1.0, 0.5, 2.0]),
        "rig": RIG,
    }  # fmt: skip
    return TopologicalMap(**values | changes)


def leaves(value):
    """Its arrays and numbers, with levels as a plain dict."""
    parts = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    for name, part in parts.items():
        if isinstance(part, Levels):
            yield from ((f"{name}.{level}", array) for level, array in part._asdict().items())
        elif dataclasses.is_dataclass(part):
            yield from ((f"{name}.{inner}", array) for inner, array in leaves(part))
        else:
            yield name, part


def stored(tmp_path, **changes):
    write_map(tmp_path / "stored.npz", map_(**changes))
    return (tmp_path / "stored.npz").read_bytes()


def with_observations(**fields):
    return map_(observations=dataclasses.replace(map_().observations, **fields))


def test_a_map_reads_back_exactly(tmp_path):
    stored(tmp_path)
    back = read_map(tmp_path / "stored.npz")
    for (name, first), (_, second) in zip(leaves(map_()), leaves(back), strict=True):
        np.testing.assert_array_equal(second, first, err_msg=name)
        assert getattr(first, "dtype", None) == getattr(second, "dtype", None), name
    assert back.rig == RIG
    assert back.part.tolist() == map_().part.tolist()


def test_equal_maps_give_equal_bytes_whenever_they_are_written(tmp_path, monkeypatch):
    first = stored(tmp_path)
    monkeypatch.setattr(time, "time", lambda: 2e9)
    write_map(tmp_path / "b.npz", read_map(tmp_path / "stored.npz"))
    assert (tmp_path / "b.npz").read_bytes() == first


def test_numpy_reads_a_map_without_pickles(tmp_path):
    with np.load(io.BytesIO(stored(tmp_path)), allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["xyz"], map_().xyz)


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (map_(xyz=np.full((5, 3), np.nan)), "xyz holds a value that is not finite"),
        (map_(xyz=np.zeros((4, 3))), "xyz has shape"),
        (map_(covariance=np.zeros((5, 3))), "covariance has shape"),
        (map_(surface=Surface(FACES[:1])), "complex_faces has shape"),
        (map_(surface=Surface(FACES[::-1])), "surface_faces that are not complex_faces"),
        (map_(complex_=dataclasses.replace(map_().complex_, edges=map_().complex_.edges[::-1])), "lexicographic"),
        (map_(view_count=Levels(np.full(5, -1), *map_().view_count[1:])), "view_count_vertex holds -1, where 0"),
        (map_(view_variance=Levels(np.full(5, -0.5), *map_().view_variance[1:])), "variance_vertex holds -0.5, where 0"),
        (map_(view_variance=Levels(np.zeros((5, 3)), *map_().view_variance[1:])), "variance_vertex has shape"),
        (map_(signals=dataclasses.replace(map_().signals, edge_pixels=np.full(6, -1))), "edge_pixels holds -1"),
        (map_(response=dataclasses.replace(map_().response, defined=np.ones(5))), "response_defined has dtype"),
        (map_(direction=np.full((5, 3), 0.5)), "neither of length 1 nor 0"),
        (map_(direction_spread=np.full(5, -1.0)), "direction_spread holds -1, where 0 is the least"),
        (map_(direction_count=np.full(5, -1)), "direction_count holds -1, where 0 is the least"),
        (map_(landmark_id=np.array([0, 1, 2, 3, -2])), "landmark_id holds -2, where -1 is the least"),
        (map_(landmark_id=np.array([0, 1, 2, 3, 3])), "landmark_id holds a landmark twice"),
        (map_(keyframes=np.array([0, 4, 4])), "keyframes does not ascend"),
        (map_(keyframes=np.array([-1, 4, 5])), "keyframes holds -1"),
        (map_(T_world_camera=np.array([2 * np.eye(4)] * 3)), "T_world_camera holds no rigid motion"),
        (map_(gain=np.array([1.0, -1, 1])), "gain holds -1, where 0 is the least"),
        (with_observations(start=np.array([0, 2, 5, 6, 6])), "observations_start has shape"),
        (with_observations(start=np.array([1, 2, 2, 5, 6, 6])), "observations_start does not ascend from 0 to 6"),
        (with_observations(start=np.array([0, 2, 1, 5, 6, 6])), "observations_start does not ascend from 0 to 6"),
        (with_observations(start=np.array([0, 2, 2, 5, 5, 5])), "observations_start does not ascend from 0 to 6"),
        (with_observations(keyframe=np.array([0, 2, 0, 1, 3, 1])), "observations_keyframe holds 0 to 3, where 0 to 2"),
        (with_observations(keyframe=np.array([0, 2, 0, 0, 2, 1])), "does not ascend within a vertex"),
        (with_observations(uv=np.full((6, 2), np.nan)), "observations_uv holds a value that is not finite"),
        (with_observations(disparity=np.full(6, np.inf)), "observations_disparity holds a value"),
        (with_observations(weight=np.full(6, -1.0)), "observations_weight holds -1"),
    ],
)  # fmt: skip
def test_an_inconsistent_map_is_not_written(tmp_path, bad, said):
    with pytest.raises(InputError, match=said) as caught:
        write_map(tmp_path / "a.npz", bad)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "a.npz").exists()


def test_what_is_no_map_and_a_place_below_a_file_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"map_ is Rig, expected a TopologicalMap: what tspslam.build_map makes"):
        write_map(tmp_path / "a.npz", RIG)
    saved(tmp_path, b"", "file")
    with pytest.raises(OutputError):
        write_map(tmp_path / "file" / "a.npz", map_())


@pytest.mark.parametrize(
    ("part", "data", "said"),
    [
        ("version", npy(np.int64(2)), 'version 2 of a later tspslam, and "tspslam map RUN" makes it anew; expected a map'),
        ("version", npy(np.array([1])), "format version"),
        ("magic", npy(np.zeros(11, np.uint8)), "mark of a map"),
        ("magic", None, "no array magic"),
        ("xyz", None, "no array xyz"),
        ("surprise", npy(np.zeros(3)), "unknown array"),
        ("xyz", npy(np.array([None]), allow_pickle=True), "no header of ours"),
        ("xyz", npy(np.zeros((5, 3), np.float32)), "has type <f4"),
        ("xyz", npy(np.zeros((5, 3)))[:-1], "claims 120 bytes and has 119"),
        ("xyz", npy(np.zeros((5, 2))), "xyz has shape"),
        ("response_defined", npy(np.ones(5, bool))[:-1] + b"\7", "neither true nor false"),
        ("rig", npy(np.zeros(7)), "rig: fx"),
    ],
)  # fmt: skip
def test_each_fault_is_named_in_one_line(tmp_path, part, data, said):
    parts = entries(stored(tmp_path))
    parts.pop(f"{part}.npy", None)
    parts |= {} if data is None else {f"{part}.npy": data}
    with pytest.raises(InputError, match=said) as caught:
        read_map(saved(tmp_path, zipped(parts)))
    assert "\n" not in str(caught.value)


def test_a_version_is_told_before_what_it_lacks(tmp_path):
    parts = entries(stored(tmp_path)) | {"version.npy": npy(np.int64(7)), "surprise.npy": npy(np.zeros(3))}
    del parts["gain.npy"]
    with pytest.raises(InputError, match="has the format version 7 of a later tspslam"):
        read_map(saved(tmp_path, zipped(parts)))


def test_every_truncation_is_seen(tmp_path):
    data = stored(tmp_path)
    for size in range(1, len(data), 97):
        with pytest.raises(InputError):
            read_map(saved(tmp_path, data[:size]))


@FUZZ
@given(data=st.data())
def test_a_damaged_map_is_a_map_or_an_input_error(tmp_path, data):
    parts = entries(stored(tmp_path))
    name = data.draw(st.sampled_from(sorted(parts)))
    part = bytearray(parts[name])
    for _ in range(data.draw(st.integers(1, 4))):
        part[data.draw(st.integers(0, len(part) - 1))] = data.draw(st.integers(0, 255))
    said = ""
    try:
        back = read_map(saved(tmp_path, zipped(parts | {name: bytes(part)})))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    if not said:
        write_map(tmp_path / "again.npz", back)
        assert_equal(read_map(tmp_path / "again.npz").observations, back.observations)


@pytest.fixture
def run(tmp_path):
    """A run folder with a map."""
    with RunFolder.create(tmp_path / "run", {}) as folder:
        write_map(folder.map_npz_path, map_())
        folder.record(folder.map_npz_path, input_hash="")
    return tmp_path / "run"


def test_a_map_is_loaded_from_its_run_and_from_its_file(run):
    for path in (run, str(run), run / "map.npz"):
        np.testing.assert_array_equal(load_map(path).xyz, map_().xyz)
    assert tspslam.topological_map.TopologicalMap is TopologicalMap


def test_a_run_without_a_map_names_the_command_that_makes_one(tmp_path):
    with RunFolder.create(tmp_path / "run", {}) as folder:
        folder.record(folder.write_run({}), input_hash="")
    expected = 'run: has no map.npz; expected the run of a sequence whose map was made: "tspslam map RUN" makes it$'
    with pytest.raises(InputError, match=expected):
        load_map(tmp_path / "run")


def test_a_map_that_was_changed_since_the_run_is_refused(run):
    write_map(run / "map.npz", map_(gain=np.ones(3)))
    with pytest.raises(InputError, match="was changed since the run"):
        load_map(run)


def test_a_folder_of_another_kind_has_no_map(tmp_path):
    with pytest.raises(InputError, match="a run folder"):
        load_map(tmp_path)
