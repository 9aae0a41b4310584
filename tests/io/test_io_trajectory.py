import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.io import write_kitti, write_tum
from tspslam.io.trajectory import quaternions


def rotation(q):
    """The matrix of a unit quaternion (x, y, z, w)."""
    x, y, z, w = q
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + 2 * w * cross + 2 * cross @ cross


def poses(count):
    rng = np.random.default_rng(4)
    T = np.tile(np.eye(4), (count, 1, 1))
    for pose in T:
        q = rng.normal(size=4)
        pose[:3, :3], pose[:3, 3] = rotation(q / np.linalg.norm(q)), rng.normal(size=3)
    return T


def test_tum_and_kitti_read_back_to_the_same_poses(tmp_path):
    stamp, T = np.arange(7) * 0.1 + 1.6e9, poses(7)
    write_tum(tmp_path / "a.tum", stamp, T)
    write_kitti(tmp_path / "a.txt", T)
    tum = np.loadtxt(tmp_path / "a.tum")
    np.testing.assert_array_equal(tum[:, 0], stamp)
    np.testing.assert_array_equal(tum[:, 1:4], T[:, :3, 3])
    np.testing.assert_allclose([rotation(q) for q in tum[:, 4:]], T[:, :3, :3], atol=1e-14)
    assert (tum[:, 7] >= 0).all()
    np.testing.assert_array_equal(np.loadtxt(tmp_path / "a.txt").reshape(-1, 3, 4), T[:, :3])


@given(st.tuples(*[st.sampled_from([-1.0, -1e-9, 0.0, 1e-9, 0.3, 1.0])] * 4).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_the_quaternion_of_a_rotation_gives_that_rotation(q):
    q = np.array(q) / np.linalg.norm(q)
    back = quaternions(rotation(q)[None])[0]
    assert abs(np.linalg.norm(back) - 1) < 1e-14
    np.testing.assert_allclose(rotation(back), rotation(q), atol=1e-14)


def test_no_pose_gives_an_empty_file(tmp_path):
    write_tum(tmp_path / "a.tum", [], np.empty((0, 4, 4)))
    assert (tmp_path / "a.tum").read_bytes() == b""


SHEAR, FLAT, MIRROR = np.eye(4), np.eye(4), np.diag([1.0, 1, -1, 1])
SHEAR[0, 1], FLAT[3, 0] = 0.1, 1


@pytest.mark.parametrize(
    ("stamp", "T", "said"),
    [
        ([0, 1], np.eye(4)[None], "shape"),
        ([0], np.eye(3)[None], "shape"),
        (0, np.eye(4), "shape"),
        ([np.nan], np.eye(4)[None], "finite"),
        ([0], np.full((1, 4, 4), np.inf), "finite"),
        ([0, 1], np.stack([np.eye(4), SHEAR]), "pose 1 is not a rigid motion"),
        ([0], MIRROR[None], "rigid"),
        ([0], FLAT[None], "rigid"),
    ],
)
def test_a_path_that_is_none_is_refused(tmp_path, stamp, T, said):
    with pytest.raises(InputError, match=said):
        write_tum(tmp_path / "a.tum", stamp, T)
    if said == "rigid":
        with pytest.raises(InputError, match=said):
            write_kitti(tmp_path / "a.txt", T)
