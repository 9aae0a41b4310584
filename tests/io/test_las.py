"""LAS and LAZ: laspy reads back what was written, within half of the stated step."""

import datetime
import sys

import numpy as np
import pytest

from tspslam import InputError
from tspslam.io.las import QUANTUM, write_las

laspy = pytest.importorskip("laspy", reason="laspy is not installed: pip install 'tspslam[las]'")
pytest.importorskip("lazrs", reason="lazrs is not installed: pip install 'tspslam[las]'")
rng = np.random.default_rng(5)
XYZ, GREY, RGB = (
    rng.normal(size=(50, 3)) * 80,
    rng.random(50) * 1.2 - 0.1,
    rng.integers(0, 256, (50, 3)).astype(np.uint8),
)
COLUMNS = {
    "magnitude": rng.random(50).astype(np.float32), "views": rng.integers(0, 9, 50).astype(np.int32),
    "landmark_id": rng.integers(-1, 1 << 40, 50), "defined": (rng.random(50) < 0.5).astype(np.uint8),
}  # fmt: skip


@pytest.mark.parametrize("suffix", ["las", "laz", "LAZ"])
@pytest.mark.parametrize("rgb", [None, RGB], ids=["grey", "colour"])
def test_a_cloud_reads_back_within_half_a_step(tmp_path, suffix, rgb):
    path = tmp_path / f"a.{suffix}"
    assert write_las(path, XYZ, GREY, rgb=rgb, columns=COLUMNS) == QUANTUM == 1e-4
    back = laspy.read(path)
    x, y, z = np.asarray(back.x), np.asarray(back.y), np.asarray(back.z)
    assert np.abs(np.stack([x, -z, y], axis=1) - XYZ).max() <= QUANTUM / 2 * (1 + 1e-9)
    assert np.array_equal(back.intensity, np.rint(65535 * np.clip(GREY, 0, 1)))
    for name, values in COLUMNS.items():
        assert np.array_equal(back[name], values)
        assert back[name].dtype == values.dtype
    if rgb is not None:
        assert np.array_equal(np.stack([back.red, back.green, back.blue], axis=1), rgb.astype(int) * 257)
    assert path.read_bytes()[:4] == b"LASF"
    assert back.header.are_points_compressed == (suffix != "las")


def test_what_is_above_and_ahead_is_above_and_ahead(tmp_path):
    write_las(tmp_path / "a.las", np.array([[1.0, -2, 3]]), np.ones(1))  # right, up, forward
    back = laspy.read(tmp_path / "a.las")
    assert [float(back.x[0]), float(back.y[0]), float(back.z[0])] == pytest.approx([1, 3, 2])


@pytest.mark.parametrize("suffix", ["las", "laz"])
def test_equal_clouds_give_equal_bytes_and_the_day_is_none(tmp_path, suffix):
    first, second = tmp_path / f"a.{suffix}", tmp_path / f"b.{suffix}"
    for path in (first, second):
        write_las(path, XYZ, GREY, columns=COLUMNS)
    assert first.read_bytes() == second.read_bytes()
    header = laspy.read(first).header
    assert (header.creation_date, header.uuid.int) == (datetime.date(1980, 1, 1), 0)
    assert (header.generating_software, str(header.version)) == ("tspslam", "1.4")


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize("count", [0, 1])
def test_a_cloud_of_no_point_or_one_reads_back(tmp_path, suffix, count):
    some = {name: values[:count] for name, values in COLUMNS.items()}
    write_las(tmp_path / f"a.{suffix}", XYZ[:count], GREY[:count], rgb=RGB[:count], columns=some)
    assert len(laspy.read(tmp_path / f"a.{suffix}")) == count


def test_a_far_point_makes_the_step_larger_and_that_is_said(tmp_path):
    xyz = np.vstack([XYZ, [[0, 0, 3e6]]])
    step = write_las(tmp_path / "a.las", xyz, np.ones(51))
    back = laspy.read(tmp_path / "a.las")
    assert step == 0.01 == back.header.scales[0]
    assert np.abs(np.asarray(back.y) - xyz[:, 2]).max() <= step / 2 * (1 + 1e-6)


@pytest.mark.parametrize(("changes", "said"), [
    ({"xyz": XYZ[:, :2]}, "xyz has shape"), ({"xyz": XYZ * np.nan}, "xyz holds a value that is not finite"),
    ({"intensity": GREY[1:]}, "intensity has shape"), ({"rgb": RGB[1:]}, "rgb has shape"),
    ({"columns": {"a": np.full(50, np.inf)}}, "a holds a value that is not finite"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_in_a_line(tmp_path, changes, said):
    given = {"xyz": XYZ, "intensity": GREY} | changes
    with pytest.raises(InputError, match=said):
        write_las(tmp_path / "a.las", given.pop("xyz"), given.pop("intensity"), **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("module", "suffix"), [("laspy", "las"), ("lazrs", "laz")])
def test_a_missing_package_is_a_line_that_says_what_to_install(tmp_path, monkeypatch, module, suffix):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=rf"^{module} is not installed.*pip install 'tspslam\[las\]'$"):
        write_las(tmp_path / f"a.{suffix}", XYZ, GREY)
