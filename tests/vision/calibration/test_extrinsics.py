"""Where a scanner stands: every form gives the same motion; what is none is refused in a line."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tspslam import InputError
from tspslam.vision.calibration.extrinsics import read_extrinsics

DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[4] / "shared" / "data"))
T = np.eye(4)
T[:3, :3] = Rotation.from_rotvec([1.2, -1.1, 1.3]).as_matrix()
T[:3, 3] = 0.1, -0.2, -0.3
R_RECT = Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix()


def words(values):
    return " ".join(map(repr, np.ravel(values).tolist()))


def without(rectified):
    """The motion before the rectifying turn."""
    moved = np.eye(4)
    moved[:3] = R_RECT.T @ rectified[:3]
    return moved


BEFORE = without(T)
FORMS = {
    "ours.yaml": f"T_camera_scan: {T.tolist()}\n",
    "calib.txt": f"P0: {words(np.eye(3, 4))}\nTr: {words(T[:3])}\n",
    "000000.txt": f"R0_rect: {words(R_RECT)}\nTr_velo_to_cam: {words(BEFORE[:3])}\n",
    "calib_velo_to_cam.txt": f"calib_time: 15-Mar-2012 11:37:16\nR: {words(BEFORE[:3, :3])}\nT: {words(BEFORE[:3, 3])}\n",
    "rows.txt": "# four rows\n" + "\n".join(map(words, T)),
    "line.txt": words(T[:3]),
}


@pytest.mark.parametrize("name", FORMS)
def test_every_form_gives_the_motion(tmp_path, name):
    (tmp_path / "calib_cam_to_cam.txt").write_text(f"S_00: 10 10\nR_rect_00: {words(R_RECT)}\n")
    (tmp_path / name).write_text(FORMS[name])
    np.testing.assert_allclose(read_extrinsics(tmp_path / name), T, atol=1e-14)


BROKEN = {
    "lacks": (FORMS["calib_velo_to_cam.txt"], "is without calib_cam_to_cam.txt beside it"),
    "other": ("P0: 1 2 3\n", "says of no scanner where it stands (its keys: P0)"),
    "few": ("1 2 3\n", "holds 3 numbers"),
    "word": ("1 2 x\n", "line 1 holds a word that is no number: 'x'"),
    "flat": (words(np.zeros((4, 4))), "last row"),
    "scaled": (words(2 * np.eye(3, 4)), "holds no rotation"),
    "mirror": (words(np.diag([1, 1, -1.0, 1])), "holds no rotation"),
    "far": (f"Tr: {words(np.column_stack([np.eye(3), [5e3, 0, 0]]))}", "Tr is [5000.0, 0.0, 0.0] away"),
    "nan": (words(np.full(12, np.nan)), "holds the line"),
    "shape": ("T_camera_scan: [1, 2]\n", "T_camera_scan has 2 numbers"),
    "list": ("- T_camera_scan: 3\n", "is no mapping"),
    "yaml": ("T_camera_scan: [[1\n", "is not plain YAML"),
    "short": ("Tr: 1 2 3\n", "Tr has 3 numbers"),
    "empty": ("", "is empty"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_what_is_no_motion_is_refused_in_one_line(tmp_path, name):
    text, said = BROKEN[name]
    (tmp_path / "calib.txt").write_text(text)
    with pytest.raises(InputError) as caught:
        read_extrinsics(tmp_path / "calib.txt")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_any_text_is_a_motion_or_an_input_error(tmp_path_factory, data):
    text = data.draw(st.sampled_from(list(FORMS.values())))
    at = data.draw(st.integers(0, len(text)))
    broken = text[:at] + data.draw(st.text(max_size=6)) + text[at + data.draw(st.integers(0, 20)) :]
    path = tmp_path_factory.getbasetemp() / "fuzz.txt"
    path.write_text(broken, encoding="utf-8", newline="")
    try:
        found = read_extrinsics(path)
    except InputError:
        return
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)


def test_kittis_own_file_turns_ahead_into_z():
    path = DATA / "kitti_raw_0926/calib_velo_to_cam.txt"
    if not path.is_file():
        pytest.skip("kitti_raw_0926 is not in the data folder (TSPSLAM_DATA)")
    found = read_extrinsics(path)
    np.testing.assert_allclose(found[:3, :3] @ (1, 0, 0), (0, 0, 1), atol=0.02)
    assert np.linalg.norm(found[:3, 3]) < 0.5
