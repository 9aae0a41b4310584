"""Recordings in the layouts of KITTI, EuRoC and UTIAS: pairs, stamps, rigs, truth, and what is wrong with bad ones."""

import shutil

import numpy as np
import pytest

from tspslam import datasets
from tspslam.datasets import EurocSequence, KittiSequence, StereoFolder, UtiasRun, open_sequence
from tspslam.errors import InputError

from . import standard

WRITE = {"kitti": standard.odometry, "euroc": standard.euroc, "utias": standard.utias}
READ = {"kitti": KittiSequence, "euroc": EurocSequence, "utias": UtiasRun}


@pytest.mark.parametrize("kind", WRITE)
def test_a_recording_is_a_sequence_of_pairs(tmp_path, kind):
    sequence = READ[kind](WRITE[kind](tmp_path))
    pairs = list(sequence)
    assert len(sequence) == len(pairs) == len(sequence.stamps) == 4
    assert [pair.index for pair in pairs] == [0, 1, 2, 3]
    assert [pair.stamp for pair in pairs] == sequence.stamps.tolist()
    assert sequence.unpaired == []
    assert sequence[-1].name == pairs[3].name
    assert pairs[0].left.shape == (sequence.rig.height, sequence.rig.width)
    assert not np.array_equal(pairs[0].left, pairs[0].right)
    assert sequence.name == tmp_path.name
    with pytest.raises(IndexError):
        sequence[4]


@pytest.mark.parametrize("kind", WRITE)
def test_the_layout_is_found_by_itself(tmp_path, kind):
    assert type(open_sequence(WRITE[kind](tmp_path))) is READ[kind]


def test_other_layouts_are_found_or_refused(tmp_path, sequence):
    assert type(open_sequence(sequence)) is StereoFolder
    assert open_sequence(standard.odometry(tmp_path / "colour", cameras="23")).rig.baseline == pytest.approx(0.5)
    with pytest.raises(InputError, match="has none of the known layouts"):
        open_sequence(tmp_path)
    with pytest.raises(InputError, match="is no folder"):
        open_sequence(tmp_path / "nowhere")
    with pytest.raises(InputError, match="brings its own calibration"):
        open_sequence(tmp_path / "colour", calib="calib.yaml")


@pytest.mark.parametrize(
    ("kind", "gone", "paired", "unpaired"),
    [
        ("kitti", "image_1/000002.png", [0, 1, 3], ["image_0/000002.png"]),
        ("utias", "images/left/000000.png", [1, 2, 3], ["right/000000.png"]),
    ],
)
def test_images_without_a_partner_are_reported_and_none_is_paired_by_position(tmp_path, kind, gone, paired, unpaired):
    (WRITE[kind](tmp_path) / gone).unlink()
    sequence = READ[kind](tmp_path)
    assert [int(pair.name) for pair in sequence] == paired
    assert sequence.unpaired == unpaired
    whole = READ[kind](WRITE[kind](tmp_path / "whole"))
    for pair in sequence:
        assert pair.right.tobytes() == whole[int(pair.name)].right.tobytes()


def test_euroc_pairs_by_the_nearest_stamp_within_a_quarter_of_an_interval(tmp_path):
    assert len(EurocSequence(standard.euroc(tmp_path / "near", late=9_000_000))) == 4
    with pytest.raises(InputError, match="has no pair of images"):
        EurocSequence(standard.euroc(tmp_path / "far", late=20_000_000))
    gone = standard.euroc(tmp_path / "gone")
    next((gone / "mav0" / "cam1" / "data").iterdir()).unlink()
    sequence = EurocSequence(gone)
    assert len(sequence) == 3
    assert {name.split("/")[0] for name in sequence.unpaired} == {"cam0", "cam1"}


def test_images_are_sorted_as_numbers(tmp_path):
    folder = standard.odometry(tmp_path, count=12)
    for side in ("image_0", "image_1"):
        for k in range(12):
            (folder / side / f"{k:06d}.png").rename(folder / side / f"{k}.png")
    assert [pair.name for pair in KittiSequence(folder)] == [str(k) for k in range(12)]


def test_kitti_poses_are_those_of_the_left_camera_of_the_pairs(tmp_path):
    folder = standard.odometry(tmp_path, cameras="0123", shift=0.06)
    T = standard.poses(4)
    (folder / "poses.txt").write_text(standard.rows_of(T))
    grey, colour = KittiSequence(folder), KittiSequence(folder, colour=True)
    beside = np.eye(4)
    beside[0, 3] = 0.06
    np.testing.assert_allclose(grey.truth, T, atol=1e-9)
    np.testing.assert_allclose(colour.truth, T @ beside, atol=1e-9)
    assert colour.rig.baseline == pytest.approx(0.5)
    elsewhere = tmp_path / "mine.txt"
    shutil.move(folder / "poses.txt", elsewhere)
    assert KittiSequence(folder).truth is None
    np.testing.assert_allclose(KittiSequence(folder, poses=elsewhere).truth, T, atol=1e-9)


def test_euroc_truth_is_interpolated_and_carried_to_the_camera(tmp_path):
    folder = standard.euroc(tmp_path)
    stamps = (EurocSequence(folder).stamps * 1e9).astype(np.int64)
    T = standard.poses(4)
    standard.euroc_truth(folder, T, stamps)
    np.testing.assert_allclose(EurocSequence(folder).truth, T, atol=1e-6)
    standard.euroc_truth(folder, T[::2], stamps[::2])  # 100 ms apart: between them the path is nearly straight
    truth = EurocSequence(folder).truth
    np.testing.assert_allclose(truth[1][:3, 3], (T[0] + T[2])[:3, 3] / 2, atol=1e-5)
    np.testing.assert_allclose(truth[1][:3, :3], T[1][:3, :3], atol=1e-5)
    assert np.isnan(truth[3]).all()


def test_utias_transforms_are_chained(tmp_path):
    truth = UtiasRun(standard.utias(tmp_path)).truth
    travelled = truth[:, :3, 3] - truth[0, :3, 3]
    np.testing.assert_allclose(np.linalg.norm(travelled, axis=1), [0, 0.5, 1.0, 1.5], atol=1e-6)
    assert (np.diff(travelled[:, 2]) > 0.4).all()  # the camera looks ahead, and down a little
    (tmp_path / "transforms_temporal.txt").unlink()
    assert UtiasRun(tmp_path).truth is None


def test_utias_takes_a_calibration_of_its_own(tmp_path):
    folder = standard.utias(tmp_path)
    rig = UtiasRun(folder).rig
    assert (rig.fx, rig.width) == (387.777, 512)
    (folder / "calib.yaml").write_text("{fx: 400, fy: 400, cx: 256, cy: 192, baseline: 0.2, width: 512, height: 384}\n")
    assert UtiasRun(folder).rig.fx == 400


def edit(folder, name, change):
    path = folder / name
    path.write_text(change(path.read_text()))


def microseconds(text):
    return "".join(line if line[0] == "#" else line.replace("000000,", ",", 1) for line in text.splitlines(True))


FIRST, STAMPS = "mav0/cam0/data.csv", "timestamps_images.txt"
MEASURED = "mav0/state_groundtruth_estimate0/data.csv"
BAD = {
    "lacks the folder image_0": ("kitti", lambda f: shutil.rmtree(f / "image_0")),
    "times.txt": ("kitti", lambda f: (f / "times.txt").unlink()),
    "calib.txt": ("kitti", lambda f: (f / "calib.txt").unlink()),
    "stamps in seconds that increase": ("kitti", lambda f: edit(f, "times.txt", lambda t: t.replace("2.0", "0.0"))),
    "apart in the median": ("kitti", lambda f: (f / "times.txt").write_text("0\n100000000\n200000000\n300000000\n")),
    "line 2 has": ("kitti", lambda f: (f / "times.txt").write_text("0\nsoon\n")),
    "a value that is not finite": ("kitti", lambda f: (f / "times.txt").write_text("0\nnan\n")),
    "a value that is not finite or above 1e\\+10": (
        "kitti",
        lambda f: (f / "times.txt").write_text("0\n.1\n.2\n1e300\n"),
    ),
    "line 2 has '1_0'": ("kitti", lambda f: (f / "times.txt").write_text("0\n1_0\n")),
    "line 2 has '١'": ("kitti", lambda f: (f / "times.txt").write_text("0\n١\n", "utf-8")),
    "line 1 has '9223372036854775808'": ("euroc", lambda f: (f / FIRST).write_text(f"{2**63},a.png\n")),
    "line 5 has '9223372036854775808'": ("utias", lambda f: edit(f, STAMPS, lambda t: t + f"4,{2**63}\n")),
    "line 5 has pose 3 behind 3": ("utias", lambda f: edit(f, STAMPS, lambda t: t + t.splitlines()[-1] + "\n")),
    "line 2 has pose 1 behind 9": ("utias", lambda f: edit(f, STAMPS, lambda t: "9" + t[1:])),
    "has 2 values": ("kitti", lambda f: (f / "times.txt").write_text("0 1\n")),
    "is no text": ("kitti", lambda f: (f / "times.txt").write_bytes(b"\xff\xfe\x00")),
    "has no line of values": ("kitti", lambda f: (f / "times.txt").write_text("# nothing\n")),
    "has a name that is no number": ("kitti", lambda f: (f / "image_0/000000.png").rename(f / "image_0/a.png")),
    "has the number of": ("kitti", lambda f: shutil.copy(f / "image_0/000000.png", f / "image_0/0.png")),
    "has no pair of images": ("kitti", lambda f: (f / "image_1").rename(f / "gone") and (f / "image_1").mkdir()),
    "lacks the folder mav0/cam0": ("euroc", lambda f: shutil.rmtree(f / "mav0/cam0")),
    "cam1/data.csv": ("euroc", lambda f: (f / "mav0/cam1/data.csv").unlink()),
    "cam1": ("euroc", lambda f: shutil.rmtree(f / "mav0/cam1")),
    "sensor.yaml": ("euroc", lambda f: (f / "mav0/cam0/sensor.yaml").unlink()),
    "stamps in nanoseconds that increase": ("euroc", lambda f: edit(f, FIRST, lambda t: t + t.splitlines()[1] + "\n")),
    "lines? 2 has": ("euroc", lambda f: edit(f, FIRST, lambda t: t.replace("\n", "\nx", 1))),
    "images/left: is missing": ("utias", lambda f: shutil.rmtree(f / "images/left")),
    "timestamps_images.txt": ("utias", lambda f: (f / "timestamps_images.txt").unlink()),
    "lines of one and of two values": ("utias", lambda f: edit(f, "timestamps_images.txt", lambda t: t + "17\n")),
}


@pytest.mark.parametrize("said", BAD)
def test_a_bad_recording_gets_one_line_that_names_the_file(tmp_path, said):
    kind, spoil = BAD[said]
    spoil(WRITE[kind](tmp_path))
    with pytest.raises(InputError, match=said) as error:
        READ[kind](tmp_path)
    assert "\n" not in str(error.value)


def test_stamps_in_another_unit_are_refused(tmp_path):
    folder = standard.euroc(tmp_path)
    for camera in ("cam0", "cam1"):
        path = folder / "mav0" / camera / "data.csv"
        rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
        path.write_text("".join(f"{int(t) // 1000},{name}\n" for t, name in rows))
    with pytest.raises(InputError, match="read as nanoseconds, are 5e-05 s apart in the median"):
        EurocSequence(folder)


TRUTH = {
    "lines of 12 numbers": ("kitti", "poses.txt", "1 2 3\n"),
    "holds no rotation": ("kitti", "poses.txt", "2 0 0 0 0 1 0 0 0 0 1 0\n" * 4),
    "line 1 has 1 values": ("kitti", "poses.txt", "x\n"),
    "line 1 has a value that is not finite or above 1e+10": ("kitti", "poses.txt", "1 0 0 1e308 0 1 0 0 0 0 1 0\n"),
    "line 1 has 3 values": ("euroc", MEASURED, "1,2,3\n"),
    "quaternion of pose 1 has norm 2": ("euroc", MEASURED, "1,0,0,0,2,0,0,0\n"),
    "not finite or above 1e+10": ("euroc", MEASURED, "1,0,0,1e308,1,0,0,0\n"),
    "line 1 has '99": ("euroc", MEASURED, "9999999999999999999,0,0,0,1,0,0,0\n"),
    "has no pose of any of the 4 images": ("euroc", MEASURED, "1,0,0,0,1,0,0,0\n100000001,0,0,0,1,0,0,0\n"),
    "line 1 has 5 values": ("utias", "transforms_temporal.txt", "1,2,3,4,5\n"),
    "line 1 ends with": ("utias", "transforms_temporal.txt", "3,1,3,0" + ",1,0,0,0,0,1,0,0,0,0,1,0" + ",0,0,0,2\n"),
    "line 1 has '1.5'": ("utias", "transforms_temporal.txt", "3,1.5,3,0" + ",1,0,0,0,0,1,0,0,0,0,1,0\n"),
    "above 1e+10": ("utias", "transforms_temporal.txt", "3,1,3,0" + ",1,0,0,-1e308,0,1,0,0,0,0,1,0\n"),
}


@pytest.mark.parametrize("said", TRUTH)
def test_a_bad_truth_is_refused_when_it_is_asked_for(tmp_path, said):
    kind, name, text = TRUTH[said]
    folder = WRITE[kind](tmp_path)
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    sequence = READ[kind](folder)
    assert len(sequence) == 4
    with pytest.raises(InputError) as error:
        _ = sequence.truth
    assert name.rpartition("/")[2] in str(error.value)
    assert said in str(error.value).replace("; ", ", ")
    assert "\n" not in str(error.value)


def test_images_of_another_size_need_a_calibration(tmp_path):
    folder = standard.utias(tmp_path)
    for side in ("left", "right"):
        standard.write_images(folder / "images" / side, [f"{k:06d}.png" for k in range(4)])
    with pytest.raises(InputError, match=r"64 x 48 px and there is no calib\.yaml"):
        UtiasRun(folder)


def test_a_street_of_kitti_is_read(tmp_path):
    sequence = open_sequence(standard.kitti_seq1(tmp_path))
    assert len(sequence) == 51
    assert sequence.rig.baseline == pytest.approx(0.53715, abs=1e-4)
    assert np.linalg.norm(np.diff(sequence.truth[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(59.86, abs=0.05)
    assert sequence[50].left.shape == (370, 1226)


def test_a_raw_drive_of_kitti_is_rectified(tmp_path):
    sequence = open_sequence(standard.kitti_raw(tmp_path))
    assert len(sequence) == 100
    assert sequence.rig.baseline == pytest.approx(0.537, abs=2e-3)
    assert np.diff(sequence.stamps).mean() == pytest.approx(0.1036, abs=1e-3)
    assert np.linalg.norm(np.diff(sequence.truth[:, :3, 3], axis=0), axis=1).sum() == pytest.approx(75, abs=1.5)
    assert abs(datasets_offset(sequence[0])) < 0.5


def test_a_room_of_euroc_is_read(tmp_path):
    sequence = open_sequence(standard.euroc_v101(tmp_path))
    assert len(sequence) == 100
    assert sequence.rig.fx == pytest.approx(436.2443, abs=1e-3)
    assert np.isfinite(sequence.truth).all(axis=(1, 2)).sum() == 99
    assert abs(datasets_offset(sequence[3])) < 0.5


def datasets_offset(pair):
    """Median of v_right - v_left, px."""
    from tspslam.vision.stereo.reconstruct import reconstruct_with_quality

    return reconstruct_with_quality(pair)[1].vertical_offset_px


@pytest.mark.parametrize("kind", WRITE)
@pytest.mark.parametrize("path", [None, 7, "a\nb", "a\x00b", "a" * 5000, "a/" * 3000])
def test_a_path_that_can_be_no_folder_gets_one_line(kind, path):
    with pytest.raises(InputError, match=r"is no path|lacks the folder|is missing") as error:
        READ[kind](path)
    assert "\n" not in str(error.value)
    assert "\x00" not in str(error.value)


@pytest.mark.parametrize(("kind", "given"), [("kitti", "poses"), ("utias", "calib")])
def test_a_file_that_is_given_as_no_path_gets_one_line(tmp_path, kind, given):
    with pytest.raises(InputError, match=r"7: is no path .*expected the name of a file or folder"):
        READ[kind](WRITE[kind](tmp_path), **{given: 7})


@pytest.mark.parametrize("kind", WRITE)
@pytest.mark.parametrize("index", [slice(0, 2), "0", None, 1.0, True])
def test_an_index_that_is_no_number_is_refused(tmp_path, kind, index):
    sequence = READ[kind](WRITE[kind](tmp_path))
    with pytest.raises(InputError, match=r"^index is .*, expected a whole number from -4 to 3$"):
        sequence[index]
    assert sequence[np.int8(-1)].index == 3


def test_readers_are_public():
    assert {"KittiSequence", "EurocSequence", "UtiasRun", "open_sequence"} <= set(datasets.__all__)


def test_a_path_that_cannot_be_looked_at_is_bad_input(tmp_path):
    with pytest.raises(InputError, match=r"cannot be looked at .*expected one with left/"):
        open_sequence(tmp_path / ("a" * 300))
