"""A checkpoint that something else has changed, its hash made to match, does not count: frames are made anew."""

import io
import json
import logging
import shutil
import tracemalloc
import zipfile

import numpy as np
import pytest

from tspslam.errors import InputError
from tspslam.io import RunFolder
from tspslam.run.sequence import STATE_NAME, SequenceRun
from tspslam.session import Session, Settings
from tspslam.vision.slam.odometry import StereoOdometry, Tracking

from ..sequences import DETECTOR, RIG, corridor

FRAMES = 6
SETTINGS = Settings(detector=DETECTOR, tracking=Tracking(keyframe_share=0.9))


class Walk:
    """Pairs in memory."""

    name, rig = "walk", RIG

    def __init__(self):
        sequence = corridor(3.0)
        self.pairs = [sequence[index] for index in range(FRAMES)]

    def __len__(self):
        return FRAMES

    def __getitem__(self, index):
        return self.pairs[index]


def sequence(walk, folder):
    return SequenceRun(walk, range(FRAMES), Session(RIG, SETTINGS), folder)


@pytest.fixture(scope="module")
def walk():
    return Walk()


@pytest.fixture(scope="module")
def whole(walk, tmp_path_factory):
    """A run folder with the checkpoint of a run over all frames."""
    out = tmp_path_factory.mktemp("whole") / "run"
    with RunFolder.create(out, {}) as folder:
        list(sequence(walk, folder).proceed())
    return out


@pytest.fixture
def changed(walk, whole, tmp_path, caplog):
    """Rows that a run takes over from a folder where a file was changed and its hash made to match, and the descriptors."""

    def resumed(change, name=STATE_NAME):
        out = tmp_path / "run"
        shutil.copytree(whole, out)
        change(out / name)
        with RunFolder.create(out, {}) as folder:
            folder.record(out / name, input_hash=folder.units[name].input)
        with RunFolder.create(out, {}) as folder, caplog.at_level(logging.WARNING):
            rows = sequence(walk, folder).rows
        return rows, [record.getMessage() for record in caplog.records]

    return resumed


def arrays_changed(change):
    def apply(path):
        with np.load(path) as archive:
            state = dict(archive)
        change(state)
        np.savez(path, **state)

    return apply


def rows_changed(change):
    def apply(state):
        rows = json.loads(state["rows"].tobytes())
        text = change(rows) or json.dumps(rows).encode()
        state["rows"] = np.frombuffer(text, np.uint8)

    return arrays_changed(apply)


def put(name, place, value):
    def apply(state):
        state[name][place] = value

    return apply


def scaled(state):
    """A world thrice as large looks the same from everywhere, but for the disparities."""
    state["xyz"] *= 3
    for name in ("keyframe_pose", "anchored", "poses"):
        state[name][:, :3, 3] *= 3


def turned(state):
    state["keyframe_pose"][1, :3, :3] = state["keyframe_pose"][1, :3, :3] @ np.diag([-1.0, 1, -1])


ARRAYS = {
    "wild landmarks": lambda state: state.update(xyz=state["xyz"] * 1e6),
    "huge landmarks": lambda state: state.update(xyz=state["xyz"] * 1e300),
    "other landmarks": lambda state: state.update(xyz=state["xyz"][::-1]),
    "landmarks of another type": lambda state: state.update(xyz=state["xyz"].astype(np.float32)),
    "landmarks in another order": lambda state: state.update(xyz=np.asfortranarray(state["xyz"])),
    "a larger world": scaled,
    "no number": put("poses", (0, 0, 3), np.nan),
    "an infinite one": put("row_offset", (), np.inf),
    "no rotation": put("keyframe_pose", (1, 0, 0), 3.0),
    "a mirror": put("anchored", 2, np.diag([1.0, 1, -1, 1])),
    "another last row": put("anchored", (2, 3, 3), 1.5),
    "a keyframe that looks back": turned,
    "a frame far away": put("anchored", (2, 0, 3), 1e5),
    "a wild motion": put("poses", (1, 2, 3), 1e5),
    "another pose": put("poses", (0, 2, 3), 1.0),
    "a negative count": put("counts", 2, -1),
    "a large count": put("counts", 0, 1 << 40),
    "more lost than there are": put("counts", 1, 1000),
    "asked twice": put("counts", 3, 2),
    "a loop into the future": lambda state: state.update(closures=np.array([[1, 2]], np.int64)),
    "a loop at a frame that is none": lambda state: state.update(closures=np.array([[1000, 2]], np.int64)),
    "two loops at one frame": lambda state: state.update(closures=np.array([[2, 0], [2, 1]], np.int64)),
    "a place seen again in the future": lambda state: state.update(
        loops=np.array([[1, 2]], np.int64), looped=np.eye(6)[None]
    ),
    "a place seen again without a covariance": lambda state: state.update(loops=np.array([[2, 0]], np.int64)),
    "fewer keyframes than there are": put("added", (), 0),
    "a landmark before the first": put("landmark", 0, -1),
    "a landmark beyond the last": put("landmark", 0, 1 << 40),
    "a landmark seen twice": lambda state: state["landmark"].__setitem__(0, state["landmark"][1]),
    "negative observations": put("keyframe_observations", 0, -1),
    "more observations than there are": put("keyframe_observations", 0, 1 << 60),
    "a sight outside": put("uv", (0, 0), 1e6),
    "descriptors of another length": lambda state: state.update(descriptors=state["descriptors"][:, :3].copy()),
    "descriptors of another type": lambda state: state.update(descriptors=state["descriptors"].astype(np.int64)),
    "frames on no keyframe": put("anchors", 1, 77),
    "frames on a later keyframe": lambda state: state["anchors"].__setitem__(0, state["keyframe_index"][-1]),
    "a keyframe twice": lambda state: state["keyframe_index"].__setitem__(1, state["keyframe_index"][0]),
    "a keyframe that is no frame": put("keyframe_index", -1, FRAMES),
    "stamps that fall": lambda state: state.update(stamps=state["stamps"][::-1].copy()),
    "a number beyond all": put("next_id", (), 2**63 - 1),
    "numbers that fall": put("landmark_id", 0, 10**6),
    "an offset without an end": put("bias", 1, 0.0),
    "an offset as wide as the image": put("bias", 0, 1e4),
    "a scalar for an array": lambda state: state.update(stamps=np.array(0.0)),
    "no keyframes": lambda state: state.update(
        {name: values[:0] for name, values in state.items() if name.startswith("keyframe")}
    ),
    "an array missing": lambda state: state.pop("uv"),
    "an array more": lambda state: state.update(more=np.zeros(3)),
}


@pytest.mark.parametrize("what", ARRAYS)
def test_a_state_that_no_run_can_have_does_not_count(changed, what):
    rows, said = changed(arrays_changed(ARRAYS[what]))
    assert rows == []
    assert len(said) == 1
    assert "state.npz: does not count (" in said[0]
    assert "\n" not in said[0]


ROWS = {
    "nested lists": lambda rows: b"[" * 100_000,
    "no JSON": lambda rows: b"{",
    "no text": lambda rows: b"\xff\xfe",
    "no list": lambda rows: b"{}",
    "descriptors": lambda rows: json.dumps(["stamp"] * FRAMES).encode(),
    "no number": lambda rows: rows[1].update(stamp=float("nan")),
    "a number too large": lambda rows: json.dumps(rows).replace('"faces": ', '"faces": 1' + 5000 * "0").encode(),
    "another index": lambda rows: rows[1].update(index=0),
    "true for 1": lambda rows: rows[1].update(index=True),
    "a name that is none": lambda rows: rows[1].update(name=["a"]),
    "another name": lambda rows: rows[1].update(name="\x1b[31m"),
    "no pose": lambda rows: rows[1].pop("landmarks_seen") and None,
    "another count": lambda rows: rows[0].update(points=rows[0]["points"] + 1),
    "another offset": lambda rows: rows[0].update(vertical_offset_px=40.0),
    "a count that is none": lambda rows: rows[0].update(edges="many"),
    "nested values": lambda rows: rows[0].update(more={"a": {}}),
    "a value more": lambda rows: rows[0].update(more=1),
    "another input": lambda rows: rows[1].update(input_hash="0" * 64),
    "no keyframe": lambda rows: rows[0].update(is_keyframe=False),
    "a frame skipped": lambda rows: rows[1].update(skipped="it says so"),
    "a row less": lambda rows: rows.pop() and None,
    "a row more": lambda rows: rows.append(rows[-1] | {"index": FRAMES}),
}


@pytest.mark.parametrize("what", ROWS)
def test_rows_that_are_not_those_of_the_run_do_not_count(changed, what):
    rows, said = changed(rows_changed(ROWS[what]))
    assert rows == []
    assert "state.npz: does not count (" in said[0]
    assert "\n" not in said[0]


def raw(name, header, body=b""):
    """A change of one array's bytes in the file."""

    def apply(path):
        with zipfile.ZipFile(path) as archive:
            parts = {each: archive.read(each) for each in archive.namelist()}
        text = header.ljust(117) + "\n"
        parts[f"{name}.npy"] = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode() + body
        with zipfile.ZipFile(path, "w") as archive:
            for each, data in parts.items():
                archive.writestr(each, data)

    return apply


def test_a_header_of_sixteen_tebibytes_takes_no_memory(changed):
    header = "{'descr': '<f8', 'fortran_order': False, 'shape': (91625968981, 24), }"
    tracemalloc.start()
    rows, said = changed(raw("xyz", header, bytes(24)))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert rows == []
    assert f"claims {91625968981 * 24 * 8} bytes" in said[0]
    assert peak < 100e6


@pytest.mark.parametrize("header", ["{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", "[" * 9000, "("])
def test_a_header_that_is_not_ours_does_not_count(changed, header):
    rows, said = changed(raw("bias", header))
    assert rows == []
    assert "array bias has no header of ours" in said[0]


@pytest.mark.parametrize("data", [b"x", b"PK\x05\x06" + bytes(18), b"[" * 1000])
def test_a_file_that_is_no_npz_does_not_count(changed, data):
    rows, said = changed(lambda path: path.write_bytes(data))
    assert rows == []
    assert "does not count" in said[0]


def test_an_array_that_unpacks_to_far_more_than_the_file_is_refused_before_it_is_read(changed, monkeypatch):
    def bomb(path):
        with zipfile.ZipFile(path) as archive:
            parts = {each: archive.read(each) for each in archive.namelist()}
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for each, data in parts.items():
                archive.writestr(each, data + bytes(50 << 20) if each == "rows.npy" else data)

    monkeypatch.setattr("tspslam._files._UNPACKED", 1 << 20)
    rows, said = changed(bomb)
    assert rows == []
    assert "state.npz: does not count (claims " in said[0]


@pytest.mark.parametrize("name", ["frames/000000.npz", "frames/000000.json"])
def test_a_frame_that_is_damaged_is_made_anew(changed, walk, whole, tmp_path, name):
    rows, said = changed(lambda path: path.write_bytes(b"nothing of a frame"), name)
    assert rows == []
    assert "does not count" in said[0]
    with RunFolder.create(tmp_path / "run", {}) as folder:
        list(sequence(walk, folder).proceed())
    assert (tmp_path / "run" / name).read_bytes() == (whole / name).read_bytes()


def test_a_checkpoint_that_was_not_changed_counts_in_silence(walk, whole, tmp_path, caplog):
    shutil.copytree(whole, tmp_path / "run")
    with RunFolder.create(tmp_path / "run", {}) as folder:
        assert len(sequence(walk, folder).rows) == FRAMES
    assert not caplog.records


def test_a_state_of_nothing_is_gone_on_from(walk):
    odometry = StereoOdometry(RIG, detector=DETECTOR)
    odometry.restore(StereoOdometry(RIG, detector=DETECTOR).state(), lambda number: walk[number].left)
    assert odometry.process(walk[0]).is_keyframe


def test_a_state_of_other_cameras_does_not_hold_together(walk):
    import dataclasses

    odometry = StereoOdometry(RIG, detector=DETECTOR)
    for index in range(2):
        odometry.process(walk[index])
    other = StereoOdometry(dataclasses.replace(RIG, cx=RIG.cx + RIG.width), detector=DETECTOR)
    with pytest.raises(InputError, match="keyframe 0 does not see its landmarks where they are"):
        other.restore(odometry.state(), lambda number: walk[number].left)


def test_the_state_of_a_run_is_no_pickle(whole):
    with zipfile.ZipFile(io.BytesIO((whole / STATE_NAME).read_bytes())) as archive:
        assert all(b"|O" not in archive.read(name)[:128] for name in archive.namelist())
