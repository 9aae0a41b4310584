import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam.errors import InputError
from tspslam.io import read_trajectory, write_kitti, write_tum
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


COUNT = 5
NS = 1403636580838555648 + 50_000_000 * np.arange(COUNT)
HEAD = "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []"


def columns():
    """Places and quaternions with w last."""
    T = poses(COUNT)
    return T, T[:, :3, 3], quaternions(T[:, :3, :3])


def joined(rows, separator):
    return "\n".join(separator.join(map(str, row)) for row in rows) + "\n"


def euroc(more=0):
    _, xyz, q = columns()
    rows = [[NS[k], *xyz[k], *q[k][[3, 0, 1, 2]], *([0.5] * more)] for k in range(COUNT)]
    return joined(rows, ",")


@pytest.mark.parametrize("more", [0, 9])
@pytest.mark.parametrize("head", ["", HEAD + "\n", "% said\n" + HEAD + ", v_RS_R_x [m s^-1]\r\n"])
def test_a_csv_of_euroc_has_stamps_in_ns_and_w_first(tmp_path, more, head):
    (tmp_path / "data.csv").write_text(head + euroc(more))
    found = read_trajectory(tmp_path / "data.csv")
    np.testing.assert_allclose(found.T_world_camera, columns()[0], atol=1e-12)
    np.testing.assert_allclose(found.stamp, NS / 1e9, rtol=1e-15)


@pytest.mark.parametrize("separator", [" ", "\t", ",", ", ", "  \t "])
def test_the_values_of_tum_are_apart_by_blanks_tabs_or_commas(tmp_path, separator):
    T, xyz, q = columns()
    (tmp_path / "a.txt").write_text(joined([[0.5 + k, *xyz[k], *q[k]] for k in range(COUNT)], separator))
    found = read_trajectory(tmp_path / "a.txt")
    np.testing.assert_allclose(found.T_world_camera, T, atol=1e-12)
    assert found.stamp.tolist() == [0.5, 1.5, 2.5, 3.5, 4.5]


@pytest.mark.parametrize("head", ["timestamp,tx,ty,tz,qw,qx,qy,qz", "# stamp, x, y, z, q_w, q_x, q_y, q_z"])
def test_names_of_columns_tell_the_order_of_quaternions(tmp_path, head):
    T, xyz, q = columns()
    rows = joined([[0.5 + k, *xyz[k], *q[k][[3, 0, 1, 2]]] for k in range(COUNT)], ",")
    (tmp_path / "a.csv").write_text(f"{head}\n{rows}")
    found = read_trajectory(tmp_path / "a.csv")
    np.testing.assert_allclose(found.T_world_camera, T, atol=1e-12)
    assert found.stamp[0] == 0.5


def test_rows_of_nan_are_unknown_in_each_form(tmp_path):
    lines = euroc().splitlines()
    lines[1] = f"{NS[1]}" + ",nan" * 7
    (tmp_path / "data.csv").write_text("\n".join(lines))
    assert np.isnan(read_trajectory(tmp_path / "data.csv").T_world_camera[:, 0, 0]).tolist() == [0, 1, 0, 0, 0]
    (tmp_path / "more.csv").write_text(
        euroc(9).replace(",0.5" * 9, ",nan" * 9)
    )  # a velocity that is not known is no pose
    assert np.isfinite(read_trajectory(tmp_path / "more.csv").T_world_camera).all()


def test_poses_of_kitti_get_the_stamps_of_a_file(tmp_path):
    write_kitti(tmp_path / "poses.txt", poses(3))
    (tmp_path / "times.txt").write_text("0.000000e+00\n1.0e-01\n\n0.21\n")
    assert read_trajectory(tmp_path / "poses.txt", tmp_path / "times.txt").stamp.tolist() == [0, 0.1, 0.21]
    assert read_trajectory(tmp_path / "poses.txt").stamp.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ("0\n1\n", "has 2 stamps; expected 3, one for each line of"),
        ("0\n1\n1\n", "line 3: stamp 3 is 1.000000000, that before it 1.0"),
        ("0\n1\nnan\n", "has a stamp that is not finite"),
        ("0 1\n2\n3\n", "line 1 has 2 values"),
        ("0\n1_0\n30\n", "no number"),
        ("# none\n", "has no stamps"),
    ],
)
def test_stamps_that_do_not_fit_are_one_line(tmp_path, times, said):
    write_kitti(tmp_path / "poses.txt", poses(3))
    (tmp_path / "times.txt").write_text(times)
    with pytest.raises(InputError, match=said):
        read_trajectory(tmp_path / "poses.txt", tmp_path / "times.txt")
    write_tum(tmp_path / "a.tum", [0, 1, 2], poses(3))
    with pytest.raises(InputError, match="has stamps of its own"):
        read_trajectory(tmp_path / "a.tum", tmp_path / "times.txt")


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_path_is_a_path_or_an_input_error(tmp_path, data):
    whole = data.draw(st.sampled_from([HEAD + "\n" + euroc(), euroc(9), joined(np.eye(12).tolist(), ","), "0 " * 8]))
    damaged = bytearray(whole.encode())
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "a.csv").write_bytes(bytes(damaged[: data.draw(st.integers(1, len(damaged)))]))
    try:
        found = read_trajectory(tmp_path / "a.csv")
    except InputError as error:
        found = error
    assert "\n" not in str(found) if isinstance(found, InputError) else np.isfinite(found.stamp).all()


@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text(st.sampled_from("0123456789.,-+e \t\n#nq[]_wsaifr"), min_size=1, max_size=120))
def test_any_text_is_a_path_or_an_input_error(tmp_path, text):
    (tmp_path / "a.csv").write_text(text)
    try:
        found = len(read_trajectory(tmp_path / "a.csv"))
    except InputError as error:
        found = str(error).count("\n") == 0
    assert found
