"""What the readers of data sets share: tables of text, stamps, pairs of image files, poses at times."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Integral
from pathlib import Path

import numpy as np

from .._brief import Brief
from .._files import PathLike, bad_input, one_line, reason_of
from .._text import read_text
from ..errors import InputError
from ..io.images import image_size
from ..types import FloatArray, IntArray, RawRig, Rig, StereoPair
from ._kinds import only_images
from ._reader import FileReader

NANOSECONDS = 10**9
_LARGEST_TEXT = 1 << 28  # bytes
_SHORTEST, _LONGEST = 1e-3, 60.0  # s between frames, in the median
_REACH = 0.1  # s from a frame to the poses on both sides of it
_ROTATION = 1e-3
_WHOLE = re.compile(r"[0-9]{1,19}")
_PLAIN = re.compile(r"[-+.0-9A-Za-z]+")  # of the words that `float` reads, those without underscores or other digits
_LARGEST_NUMBER = 1e10  # s or m
LAST_STAMP = 2**63 - 1  # ns, in the year 2262
Row = tuple[int, list[str]]
"""Number of a line, from 1, and its words."""


@dataclass(frozen=True, repr=False)
class Paired(Brief):
    """Image files of the frames in the order of time, their stamps (s), and the files that are in no frame."""

    files: list[tuple[Path, Path]]
    stamps: FloatArray
    unpaired: list[str]


class Frames:
    """Pairs read from files when they are asked for."""

    def __init__(self, paired: Paired, cameras: Rig | RawRig, bits: int | None = None) -> None:
        self.files, self.stamps = paired.files, paired.stamps
        self._reader = FileReader(cameras, paired.files, bits)
        self.rig: Rig = self._reader.rig

    @property
    def is_turned(self) -> bool:
        """Whether pairs are rectified as they are read."""
        return self._reader.rectify is not None

    @property
    def R_left(self) -> FloatArray:
        """Rotates a point of the left camera's frame, as it was calibrated, into its rectified frame, (3, 3)."""
        made = self._reader.rectify
        return np.eye(3) if made is None else made.R_left

    def read(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end."""
        index = checked_index(index, len(self.files))
        return replace(self._reader.read(index), stamp=float(self.stamps[index]))


class Recording:
    """A folder of pairs, each read when it is asked for."""

    path: Path
    rig: Rig
    stamps: FloatArray
    unpaired: list[str]

    def _open(self, paired: Paired, cameras: Rig | RawRig, bits: int | None) -> None:
        self._frames = Frames(paired, cameras, bits)
        self.rig, self.stamps, self.unpaired = self._frames.rig, paired.stamps, paired.unpaired

    @property
    def name(self) -> str:
        """The folder's own name."""
        return name_of(self.path)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return len(self._frames.files)

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is bad."""
        return self._frames.read(index)

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))


def path_of(path: PathLike) -> Path:
    """Return what a user names as a path."""
    try:
        return Path(path)
    except TypeError as error:
        raise bad_input(repr(path)[:60], f"is no path ({reason_of(error)})", "the name of a file or folder") from error


def checked_index(index: int, count: int) -> int:
    """Return the place from 0 of a sequence's pair; IndexError past the end, InputError for what is no number."""
    if isinstance(index, bool) or not isinstance(index, Integral):
        raise InputError(one_line(f"index is {repr(index)[:60]}, expected a whole number from {-count} to {count - 1}"))
    return range(count)[int(index)]


def name_of(folder: Path) -> str:
    """Return the folder's own name."""
    return one_line(folder.resolve().name)


def table(path: Path, expected: str, separator: str | None = None, counts: Sequence[int] = ()) -> list[Row]:
    """Return the lines of a text file as words; blank lines and those that begin with # are passed over.

    Each line has as many words as one of `counts`, if there are any.
    """
    return _rows(path, _lines(path, expected), expected, separator, counts)


def rows_by_number(
    path: Path, expected: str, separator: str | None = None, counts: Sequence[int] = ()
) -> dict[int, Row]:
    """Return the lines of a text file whose line k, from 0, is for number k, by number.

    The number of a blank line has no row: that of an image that was lost. Lines that begin with # may go before the
    first row and are not counted.
    """
    lines = _lines(path, expected)
    rows = _rows(path, lines, expected, separator, counts)
    remarks = [k for k, line in enumerate(lines[: rows[-1][0]], 1) if line.startswith("#")]
    if remarks and remarks[-1] > rows[0][0]:
        raise bad_input(path, f"line {remarks[-1]} begins with #", f"{expected}, or a blank line where there is none")
    first = remarks[-1] + 1 if remarks else 1
    return {row[0] - first: row for row in rows}


def _lines(path: Path, expected: str) -> list[str]:
    return [line.strip() for line in read_text(path, expected, _LARGEST_TEXT).split("\n")]


def _rows(path: Path, lines: Sequence[str], expected: str, separator: str | None, counts: Sequence[int]) -> list[Row]:
    rows = [
        (k, [word.strip() for word in line.split(separator)])
        for k, line in enumerate(lines, 1)
        if line and line[0] != "#"
    ]
    for number, words in rows:
        if counts and len(words) not in counts:
            raise bad_input(path, f"line {number} has {len(words)} values", expected)
    if not rows:
        raise bad_input(path, "has no line of values", expected)
    return rows


def numbers(path: Path, row: Row, words: Sequence[str], expected: str) -> list[float]:
    """Return words of a row as finite numbers."""
    try:
        values = [float(word) for word in words if _PLAIN.fullmatch(word)]
    except ValueError:
        values = []
    if len(values) < len(words):
        raise bad_input(path, f"line {row[0]} has {' '.join(words)[:60]!r}", expected)
    if not all(abs(value) <= _LARGEST_NUMBER for value in values):  # NaN too
        raise bad_input(path, f"line {row[0]} has a value that is not finite or above {_LARGEST_NUMBER:g}", expected)
    return values


def whole(path: Path, row: Row, word: str, expected: str) -> int:
    """Return a word of a row as a whole number, from 0 to the last nanosecond that 64 bits hold."""
    if not _WHOLE.fullmatch(word) or int(word) > LAST_STAMP:
        raise bad_input(path, f"line {row[0]} has {word[:40]!r}", expected)
    return int(word)


def seconds(nanoseconds: Sequence[int]) -> FloatArray:
    """Return whole nanoseconds as seconds, each rounded once."""
    return np.array([each / NANOSECONDS for each in nanoseconds], np.float64)


def check_stamps(path: Path, stamps: FloatArray, unit: str, lines: Sequence[int] = ()) -> None:
    """Refuse stamps (s) that do not increase, or whose distances no camera has: they are in another unit.

    `lines` are the numbers of their lines, if they are from a file of text.
    """
    steps = np.diff(stamps)
    if not len(steps):
        return
    if steps.min() <= 0:
        k = int(np.argmax(steps <= 0))
        which = f"stamp {k + 2}" + (f" (line {lines[k + 1]})" if lines else "")
        said = f"{which} is {stamps[k + 1]:.9f} s, that before it {stamps[k]:.9f} s"
        raise bad_input(path, said, f"stamps in {unit} that increase")
    middle = float(np.median(steps))
    if not _SHORTEST <= middle <= _LONGEST:
        said = f"stamps, read as {unit}, are {middle:.3g} s apart in the median"
        raise bad_input(path, said, f"{unit}, {_SHORTEST:g} to {_LONGEST:g} s apart")


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that compares runs of digits as numbers."""
    parts = re.findall(r"[0-9]+|[^0-9]+", name)
    return [(0, int(part), part) if part[0] in "0123456789" else (1, 0, part) for part in parts]


def images_in(folder: Path) -> dict[str, Path]:
    """Image files of a folder by name, in natural order; hidden files are passed over, and others beside them."""
    try:
        files = list(folder.iterdir())
    except (OSError, ValueError) as error:
        raise bad_input(folder, "is missing", "a folder of images") from error
    return {file.name: file for file in sorted(only_images(folder, files), key=lambda file: natural(file.name))}


def numbered(folder: Path) -> dict[int, Path]:
    """Image files of a folder whose names are whole numbers, by number, in ascending order."""
    found: dict[int, Path] = {}
    for file in images_in(folder).values():
        if not _WHOLE.fullmatch(file.stem):
            raise bad_input(file, "has a name that is no number", "one such as 000000.png")
        if int(file.stem) in found:
            raise bad_input(file, f"has the number of {found[int(file.stem)].name}", "a file for each number")
        found[int(file.stem)] = file
    return dict(sorted(found.items()))


def size_of_first(files: Sequence[tuple[Path, Path]]) -> tuple[int, int]:
    """Size of the first left image that has one; if none has, the `InputError` of the first."""
    for left, _ in files:
        try:
            return image_size(left)
        except InputError:
            continue
    return image_size(files[0][0])


def pair_by_number(
    left: Mapping[int, Path], right: Mapping[int, Path], stamps: Mapping[int, float], labels: tuple[str, str]
) -> Paired:
    """Pair images of one number that has a stamp. `labels` are the sides' names among the unpaired."""
    both = {number: None for number in left if number in right and number in stamps}
    sides = zip(labels, (left, right), strict=True)
    lone = [f"{label}/{file.name}" for label, side in sides for number, file in side.items() if number not in both]
    times = np.array([stamps[number] for number in both], np.float64)
    return Paired([(left[number], right[number]) for number in both], times, lone)


def pair_by_stamp(
    left: Mapping[int, Path | None], right: Mapping[int, Path | None], labels: tuple[str, str], *, apart: float = 0.25
) -> Paired:
    """Pair images by their stamps (ns): those that are nearest to each other and within a share of an interval.

    A stamp whose image is lost (None) takes part: its partner is left alone, and is not given to another image.
    A frame has the stamp of its left image. The interval is the median one of the side that has the shorter; a single
    image pairs with one of its very stamp.
    """
    times = [np.sort(np.array(list(side), np.int64)) for side in (left, right)]
    matched = [(int(times[0][i]), int(times[1][j])) for i, j in _mutually_nearest(times[0], times[1], apart)]
    files, stamps = [], []
    for one, other in matched:
        first, second = left[one], right[other]
        if first is not None and second is not None:
            files.append((first, second))
            stamps.append(one)
    used = [{pair[k] for pair in files} for k in (0, 1)]
    lone = [
        one_line(f"{label}/{file.name}")
        for label, side, own, taken in zip(labels, (left, right), times, used, strict=True)
        for file in (side[int(t)] for t in own)
        if file is not None and file not in taken
    ]
    return Paired(files, seconds(stamps), lone)


def _mutually_nearest(left: IntArray, right: IntArray, apart: float) -> list[tuple[int, int]]:
    if not (len(left) and len(right)):
        return []
    steps = [float(np.median(np.diff(side))) for side in (left, right) if len(side) > 1]
    tolerance = min(steps) * apart if len(left) > 1 else 0.0
    forth, back = _nearest(left, right), _nearest(right, left)
    near = (back[forth] == np.arange(len(left))) & (np.abs(right[forth] - left) <= tolerance)
    return [(int(i), int(forth[i])) for i in np.flatnonzero(near)]


def _nearest(of: IntArray, among: IntArray) -> IntArray:
    """Index of the nearest in a sorted array, the earlier one of two that are as near."""
    after = np.clip(np.searchsorted(among, of), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(np.abs(of - among[before]) <= np.abs(among[after] - of), before, after)


def some(paired: Paired, path: Path, expected: str) -> Paired:
    """Return the frames if there are any."""
    if not paired.files:
        raise bad_input(path, f"has no pair of images ({len(paired.unpaired)} without partner or stamp)", expected)
    return paired


def some_known(T: FloatArray, path: Path, expected: str) -> FloatArray:
    """Return poses, NaN where there is none, if there is one."""
    if np.isnan(T[:, 0, 0]).all():
        raise bad_input(path, f"has no pose of any of the {len(T)} images", expected)
    return T


def rigid(path: Path, T: FloatArray) -> FloatArray:
    """Return (n, 3, 4) or (n, 4, 4) motions as (n, 4, 4), with rotations made exact that are ones to 1e-3."""
    R = T[:, :3, :3]
    off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero((off > _ROTATION) | (np.linalg.det(R) < 0))
    if bad.size:
        raise bad_input(path, f"pose {bad[0] + 1} holds no rotation (R Rᵀ - I has {off[bad[0]]:.2g})", "one to 1e-3")
    U, _, Vt = np.linalg.svd(R)
    return motions(U @ Vt, T[:, :3, 3])


def motions(R: FloatArray, t: FloatArray) -> FloatArray:
    """Return the (n, 4, 4) matrices of ``x -> R x + t``."""
    T = np.tile(np.eye(4), (len(R), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = R, t
    return T


def motion(R: FloatArray, t: Sequence[float] | FloatArray = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return the (4, 4) matrix of ``x -> R x + t``."""
    return motions(R[None], np.asarray(t, np.float64)[None])[0]


def poses_at(stamps: FloatArray, known: FloatArray, T: FloatArray) -> FloatArray:
    """Poses (n, 4, 4) at stamps from those at known times: position linear, rotation along the shortest arc.

    NaN where there is no known pose at most 0.1 s before and none at most 0.1 s after.
    """
    from scipy.spatial.transform import Rotation

    after, before = np.searchsorted(known, stamps), np.searchsorted(known, stamps, side="right") - 1
    inside = np.flatnonzero((before >= 0) & (after < len(known)))
    gaps = np.stack([stamps[inside] - known[before[inside]], known[after[inside]] - stamps[inside]])
    inside = inside[(gaps <= _REACH).all(axis=0)]
    found = np.full((len(stamps), 4, 4), np.nan)
    if not inside.size:
        return found
    one, other = before[inside], after[inside]
    part = ((stamps[inside] - known[one]) / np.where(one == other, 1.0, known[other] - known[one]))[:, None]
    start = Rotation.from_matrix(T[one, :3, :3])
    turn = (start.inv() * Rotation.from_matrix(T[other, :3, :3])).as_rotvec()
    R = (start * Rotation.from_rotvec(part * turn)).as_matrix()
    found[inside] = motions(R, (1 - part) * T[one, :3, 3] + part * T[other, :3, 3])
    return found
