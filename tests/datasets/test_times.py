"""Times of a folder's images are those in a file, of a rate, or in names, in the unit in which they make sense."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam.datasets import StereoFolder, open_sequence
from tspslam.datasets._times import nanoseconds_of, read_times
from tspslam.errors import InputError

from .test_sides import fill, value_or_line

START = 1_403_715_273_262_142_976  # ns


def drive(folder: Path, names: list[str]) -> Path:
    return fill(folder, [f"left/{name}.png" for name in names], [f"right/{name}.png" for name in names])


UNITS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("name", ["{}", "frame_{}", "{}_a", "cam0_{}"])
def test_times_since_1970_tell_their_unit(tmp_path: Path, unit: str, name: str) -> None:
    step = 2_000_000_000 if unit == "s" else 50_000_000
    times = [START + k * step for k in (0, 1, 3)]
    sequence = StereoFolder(drive(tmp_path, [name.format(t // UNITS[unit]) for t in times]))
    np.testing.assert_allclose(
        sequence.stamps, [t // UNITS[unit] * UNITS[unit] / 1e9 for t in times], rtol=0, atol=1e-6
    )
    assert sequence.remarks == [f"stamps are those in the names of the images, in {unit}; --fps gives others"]
    assert [pair.stamp for pair in sequence] == sequence.stamps.tolist()


def test_decimals_in_names_are_seconds(tmp_path: Path) -> None:
    sequence = StereoFolder(drive(tmp_path, ["1403715273.262142", "1403715273.312142", "1403715273.362143"]))
    assert sequence.stamps.tolist() == [1403715273.262142, 1403715273.312142, 1403715273.362143]


@pytest.mark.parametrize(("step", "unit"), [(33_333_333, "ns"), (33_333, "us"), (500_000_000, "ns"), (2_000_000, "us")])
def test_times_since_another_start_tell_their_unit_by_their_steps(step: int, unit: str) -> None:
    found = nanoseconds_of([str(7 * step + k * step) for k in range(5)])
    assert found is not None
    assert found.unit == unit
    assert np.diff(found.values).tolist() == [step * UNITS[unit]] * 4


NO_TIMES = {
    "numbers": ["000", "001", "002"],
    "every tenth": ["000000", "000010", "000020"],
    "from 100000": ["100000", "100001", "100002"],
    "letters": ["a", "b", "c"],
    "one without": ["1403715273262142976", "1403715273312142976", "x"],
    "too near": [str(START + k) for k in range(3)],
    "too far": [str(START + k * 10**12) for k in range(3)],
    "long numbers": [f"{k:019d}" for k in range(3)],
    "too large": [str(9 * 10**18 + k * 10**18) for k in range(3)],
}


@pytest.mark.parametrize("names", NO_TIMES)
def test_numbers_of_frames_are_no_times_and_that_is_said(tmp_path: Path, names: str) -> None:
    sequence = StereoFolder(drive(tmp_path, NO_TIMES[names]))
    assert sequence.stamps.tolist() == [0, 1, 2]
    (said,) = sequence.remarks
    assert said.startswith("stamps are numbers of frames, as neither names nor a file tell times; --fps F or a file")


def test_one_pair_needs_no_time(tmp_path: Path) -> None:
    assert StereoFolder(drive(tmp_path, ["a"])).remarks == []


def test_a_rate_gives_times_and_a_lost_partner_leaves_a_gap(tmp_path: Path) -> None:
    fill(tmp_path, [f"left/{k}.png" for k in range(5)], [f"right/{k}.png" for k in (0, 1, 3, 4)])
    sequence = open_sequence(tmp_path, fps=20)
    np.testing.assert_allclose(sequence.stamps, [0, 0.05, 0.15, 0.2])
    assert sequence.remarks == []
    for bad in (0, -1, float("nan"), float("inf"), True, "20"):
        with pytest.raises(InputError, match=r"fps is .*, expected frames a second"):
            open_sequence(tmp_path, fps=bad)  # type: ignore[arg-type]


def test_a_rate_goes_before_names_but_not_beside_a_file(tmp_path: Path) -> None:
    drive(tmp_path, [str(START + k * 50_000_000) for k in range(3)])
    assert StereoFolder(tmp_path, fps=10).stamps.tolist() == [0, 0.1, 0.2]
    (tmp_path / "times.txt").write_text("0.0\n0.5\n1.0\n")
    assert StereoFolder(tmp_path).stamps.tolist() == [0, 0.5, 1]
    with pytest.raises(InputError, match=r"times\.txt: has the times of the images; expected no frames a second"):
        StereoFolder(tmp_path, fps=10)


FILES = {
    "seconds": "0.0\n0.1\n0.25\n",
    "exponents": "0.000000e+00\n1.0e-01\n2.5e-1\n",
    "comments": "# time\n0.0\n\n0.1\n0.25\n",
    "milliseconds": "0\n100\n250\n",
    "microseconds": "0\n100000\n250000\n",
    "nanoseconds": "0\n100000000\n250000000\n",
    "numbers first": "0 0.0\n1 0.1\n2 0.25\n",
    "numbers last": "0.0 000000.png\n0.1 000001.png\n0.25 000002.png\n",
    "names": "left/000000.png, 0.0\nleft/000001.png, 0.1\nleft/000002.png, 0.25\nleft/000003.png, 0.5\n",
    "in another order": "000002 0.25\n000000 0.0\n000001 0.1\n",
}


@pytest.mark.parametrize("name", ["times.txt", "timestamps.txt", "stamps.txt", "left/times.txt"])
@pytest.mark.parametrize("kind", FILES)
def test_times_of_a_file_are_in_its_unit(tmp_path: Path, kind: str, name: str) -> None:
    drive(tmp_path, ["000000", "000001", "000002"])
    (tmp_path / name).write_text(FILES[kind])
    sequence = open_sequence(tmp_path)
    np.testing.assert_allclose(sequence.stamps, [0, 0.1, 0.25], atol=1e-12)
    unit = {"milliseconds": "ms", "microseconds": "us", "nanoseconds": "ns"}.get(kind, "s")
    assert sequence.remarks == [f"stamps are those of {Path(name).name}, in {unit}"]


def test_a_line_is_of_a_left_image_that_lost_its_partner_too(tmp_path: Path) -> None:
    fill(tmp_path, ["left/0.png", "left/1.png", "left/2.png"], ["right/0.png", "right/2.png"])
    (tmp_path / "times.txt").write_text(FILES["seconds"])
    assert StereoFolder(tmp_path).stamps.tolist() == [0, 0.25]


BAD = {
    "has 2 times of 3 left images": "0.0\n0.1\n",
    "line 2 has 'x'": "0.0\nx\n0.2\n",
    "line 1 has 'nan'": "nan\n0.1\n0.2\n",
    "has lines of 1 and 2 values": "0.0\n0.1 1\n0.2\n",
    "has lines of 3 values": "0 1 2\n1 1 2\n2 1 2\n",
    "has lines of no values": "# nothing\n",
    "is empty": "",
    "stamp 3 (line 3) is 0.100000000 s": "0.0\n0.2\n0.1\n",
    "which are no times in any unit": "0\n1\n2\n",
    "200 s apart in the median": "0.0\n200.0\n400.0\n",
    "has no time of 000002.png": "000000 0.0\n000001 0.1\n",
    "names none of the left images, such as 000000.png": "a 0.0\nb 0.1\nc 0.2\n",
    "has 3e+15 s": "1e15\n2e15\n3e15\n",
}


@pytest.mark.parametrize("said", BAD)
def test_a_file_of_times_that_does_not_fit_gets_one_line(tmp_path: Path, said: str) -> None:
    drive(tmp_path, ["000000", "000001", "000002"])
    (tmp_path / "times.txt").write_text(BAD[said])
    with pytest.raises(InputError) as error:
        open_sequence(tmp_path)
    assert str(error.value).startswith(f"{tmp_path / 'times.txt'}: ")
    assert said in str(error.value)
    assert "\n" not in str(error.value)


LINE = st.one_of(st.from_regex(r"[-+]?[0-9]{1,20}(\.[0-9]{1,9})?(e[0-9]{1,3})?", fullmatch=True), st.text(max_size=12))


@settings(max_examples=150, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(lines=st.lists(st.tuples(LINE, LINE, st.booleans()), min_size=1, max_size=6))
def test_any_file_of_times_gives_times_that_increase_or_one_line(
    tmp_path: Path, lines: list[tuple[str, str, bool]]
) -> None:
    path = tmp_path / "times.txt"
    text = "\n".join(f"{a} {b}" if both else a for a, b, both in lines)
    path.write_bytes(text.encode("utf-8", "replace"))
    files = [Path(f"{k:06d}.png") for k in range(len(lines))]
    found, line = value_or_line(lambda: read_times(path, files))
    assert "\n" not in line
    if found is None:
        return
    times, unit = found
    assert (len(times), unit in UNITS) == (len(lines), True)
    assert np.isfinite(times).all()
    assert (np.diff(times) > 0).all()


@settings(max_examples=200, deadline=2000)
@given(
    names=st.lists(
        st.one_of(st.from_regex(r"[0-9]{1,22}(\.[0-9]{1,12})?", fullmatch=True), st.text(max_size=8)), max_size=6
    )
)
def test_any_names_give_times_that_increase_or_none(names: list[str]) -> None:
    found = nanoseconds_of(names)
    assert found is None or (len(found.values) == len(names) and (np.diff(found.values) > 0).all())


def test_zeros_in_front_are_no_digits_and_longer_numbers_no_times() -> None:
    """A name of 20 digits was cut to 19, ten times too small."""
    stamps = [1403636579763555584 + k * 10**8 for k in range(3)]
    for width in (20, 24):
        found = nanoseconds_of([f"{stamp:0{width}d}" for stamp in stamps])
        assert found is not None
        assert found.values == stamps
    assert nanoseconds_of([f"{stamp}7" for stamp in stamps]) is None


def test_a_recording_that_ended_in_the_middle_of_a_line_can_be_read(tmp_path: Path) -> None:
    files = [tmp_path / f"{k:06d}.png" for k in range(3)]
    (tmp_path / "times.txt").write_text("000000.png 0.0\n000001.png 0.1\n000002.png 0.2\n000003.p")
    times, unit = read_times(tmp_path / "times.txt", files)
    assert (times.tolist(), unit) == ([0.0, 0.1, 0.2], "s")


def test_two_times_of_one_image_are_refused(tmp_path: Path) -> None:
    (tmp_path / "times.txt").write_text("0.png 0.0\n1.png 0.1\n1.png 0.15\n")
    with pytest.raises(InputError, match=r"lines 2 and 3 name 1\.png; expected one time an image"):
        read_times(tmp_path / "times.txt", [tmp_path / "0.png", tmp_path / "1.png"])
