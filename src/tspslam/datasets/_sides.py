"""Which folders or files of a folder are the left images and which the right ones, and which belong together."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .._files import bad_input, one_line
from ..errors import InputError
from ._kinds import SUFFIXES, only_images
from ._pairing import NANOSECONDS, natural, pair_by_stamp
from ._times import nanoseconds_of

PLAIN = ("left", "right")
_APART = 0.49  # of the interval between frames: at half of it, the next frame's partner is as near
_UNSTEADY = 0.25  # of the interval: how much the lateness of one side may vary where it is over a quarter
_FAR = ", over a quarter of a frame: where the camera moves, a pair is not of one moment"
_CHOSEN = ("", "image", "images", "img", "rgb")  # of several pairs of folders: of images, not of depths or labels


def _word(word: str) -> str:
    """Pattern of a word on its own: no letter beside it, but for a capital in camelCase."""
    return f"(?:(?<![A-Za-z])(?:{word}|{word.upper()})|(?<![A-Z]){word.capitalize()})(?![a-z])"


_MARKS = tuple(
    (re.compile(left), re.compile(right))
    for left, right in (
        (_word("left"), _word("right")),
        ("(?<![A-Za-z])[lL](?![A-Za-z])", "(?<![A-Za-z])[rR](?![A-Za-z])"),
        *(
            (f"(?i:(?<![a-z]){word}){first}(?![0-9])", f"(?i:(?<![a-z]){word}){second}(?![0-9])")
            for word, first, second in (("cam(?:era)?[_-]?", 0, 1), ("infra[_-]?", 1, 2), ("im", 0, 1), ("view", 0, 1))
        ),
    )
)
"""What names a side, in the order in which it is looked for: first that of the left, then that of the right."""


@dataclass(frozen=True)
class Sides:
    """Left and right images by what both of a pair are called, and how a file is named in a list."""

    left: Mapping[str, Path]
    right: Mapping[str, Path]
    labels: tuple[str, str] = ("left/", "right/")
    remarks: list[str] = field(default_factory=list)


def _marked(name: str) -> Iterator[tuple[int, int, str]]:
    """For each mark that a name has of one side only: which mark, which side, and the name without it."""
    for k, marks in enumerate(_MARKS):
        found = [mark.search(name) for mark in marks]
        for side, (here, there) in enumerate((found, found[::-1])):
            if here and not there:
                yield k, side, f"{name[: here.start()]}*{name[here.end() :]}"


def _both(names: Iterable[str]) -> Iterator[dict[str, tuple[str, str]]]:
    """For each mark, names that differ in nothing but the side, by what they have in common."""
    found: dict[int, tuple[dict[str, str], dict[str, str]]] = {}
    for name in names:
        for mark, side, rest in _marked(name):
            found.setdefault(mark, ({}, {}))[side].setdefault(rest, name)
    for _, (left, right) in sorted(found.items()):
        yield {rest: (left[rest], right[rest]) for rest in left if rest in right}


def find_sides(folder: Path) -> Sides | None:
    """Return the sides that a folder has, in two folders or beside each other; None if it has none that are known."""
    if all((folder / name).is_dir() for name in PLAIN):
        return sides_of(folder / PLAIN[0], folder / PLAIN[1])
    try:
        inside = sorted(folder.iterdir())
    except OSError:
        return None
    named = {file.name: file for file in inside if not file.name.startswith(".")}
    chosen = _chosen(folder, [name for name, file in named.items() if file.is_dir() and _holds_images(file)])
    if chosen:
        return sides_of(folder / chosen[0], folder / chosen[1])
    return _beside(folder, [file for file in named.values() if file.suffix.lower() in SUFFIXES and file.is_file()])


def _holds_images(folder: Path) -> bool:
    try:
        return any(os.path.splitext(name)[1].lower() in SUFFIXES for name in os.listdir(folder))
    except OSError:
        return False


def _chosen(folder: Path, names: list[str]) -> tuple[str, str] | None:
    """Names of the one pair of folders, or of that of images among several."""
    found = next((each for each in _both(names) if each), {})
    if len(found) > 1:
        best = [pair for rest, pair in found.items() if rest.strip("*_-. ").lower() in _CHOSEN]
        if len(best) != 1:
            listed = ", ".join(" and ".join(pair) for pair in found.values())
            raise bad_input(
                folder, f"holds {len(found)} pairs of folders with images: {listed[:200]}", "two to be given"
            )
        return best[0]
    return next(iter(found.values()), None)


def _beside(folder: Path, files: list[Path]) -> Sides | None:
    """Sides of images in one folder, by the mark that makes the most pairs."""
    most = max(_both(file.stem for file in files), key=len, default={})
    if not most:
        return None
    by_stem = _by(folder, files, lambda file: file.stem)
    left = {one: by_stem[one] for one, _ in most.values()}
    right = {one: by_stem[other] for one, other in most.values()}
    used = {name for pair in most.values() for name in pair}
    for name in by_stem.keys() - used:
        for _, side, _ in _marked(name):
            (left, right)[side].setdefault(name, by_stem[name])
            break
    return Sides(left, right, ("", ""))


def sides_of(left: Path, right: Path) -> Sides:
    """Return the images of two folders, paired by name, else by stamps in the names, else by what else these have."""
    labels = (f"{left.name}/", f"{right.name}/") if left.name != right.name else (f"{left}/", f"{right}/")
    one, other = images_of(left), images_of(right)
    enough = max(1, min(len(one), len(other)) / 2)
    first = Sides(_by(left, one, lambda file: file.stem), _by(right, other, lambda file: file.stem), labels)
    if len(first.left.keys() & first.right.keys()) >= enough:
        return first
    near = _by_stamp(one, other, labels)
    if near is not None:
        return near
    for key, said in ((_unmarked, "names without the side"), (_number, "last numbers in the names")):
        mine, its = _keyed(one, key), _keyed(other, key)
        if len(mine.keys() & its.keys()) >= enough:
            stems = {rest: file.stem for rest, file in mine.items()}
            renamed = ({stems.get(rest, rest): each[rest] for rest in each} for each in (mine, its))
            return Sides(next(renamed), next(renamed), labels, [f"paired by the {said}"])
    return first


def images_of(folder: Path) -> list[Path]:
    """Image files of a folder; hidden ones and others beside them are passed over."""
    try:
        files = sorted(folder.iterdir())
    except OSError as error:
        wanted = "left/, right/ and calib.yaml"
        raise InputError(one_line(f"{folder.parent}: lacks the folder {folder.name}, expected {wanted}")) from error
    return sorted(only_images(folder, files), key=lambda file: natural(file.name))


def _by(folder: Path, files: Iterable[Path], key: Callable[[Path], str]) -> dict[str, Path]:
    """Files by what they are called; a name that two share is an error."""
    found: dict[str, Path] = {}
    for file in sorted(files):
        name = key(file)
        if name in found:
            where = f"{folder.parent}: {found[name].name} and {file.name} in {folder.name}/"
            raise InputError(one_line(f"{where} share a name, expected one"))
        found[name] = file
    return found


def _keyed(files: Iterable[Path], key: Callable[[str], str | None]) -> dict[str, Path]:
    """Files by a key of their names; none if two share one, or a name has none."""
    keys = {file: key(file.stem) for file in files}
    found = {name: file for file, name in keys.items() if name is not None}
    return found if len(found) == len(keys) else {}


def _unmarked(stem: str) -> str | None:
    """What is left of a name without its side."""
    return next((rest for _, _, rest in _marked(stem)), None)


def _number(stem: str) -> str | None:
    """The last number in a name, without its zeros in front."""
    found = re.findall("[0-9]+", stem)
    return str(found[-1]).lstrip("0") or "0" if found else None


def _by_stamp(left: list[Path], right: list[Path], labels: tuple[str, str]) -> Sides | None:
    """Images whose names are stamps, each with the one of the other side that is nearest; None if they are none."""
    one, other = nanoseconds_of([file.stem for file in left]), nanoseconds_of([file.stem for file in right])
    if one is None or other is None:
        return None
    by_time: tuple[dict[int, Path | None], dict[int, Path | None]] = (
        dict(zip(one.values, left, strict=True)),
        dict(zip(other.values, right, strict=True)),
    )
    of = {file: time for side in by_time for time, file in side.items()}
    paired, far = pair_by_stamp(*by_time, labels), ""
    wider = pair_by_stamp(*by_time, labels, apart=_APART)
    if len(wider.files) > len(paired.files) and _is_steady([of[b] - of[a] for a, b in wider.files], by_time):
        paired, far = wider, _FAR
    if not paired.files:
        return None
    apart = max(abs(of[first] - of[second]) for first, second in paired.files) / NANOSECONDS
    names = {second: first.stem for first, second in paired.files}
    taken = {file.stem for file in left}
    lone = {file: file.stem if file.stem not in taken else f"{file.stem} {labels[1]}" for file in right}
    said = f"paired by the nearest stamps in the names, up to {apart:.2g} s apart{far}"
    return Sides({file.stem: file for file in left}, {(lone | names)[file]: file for file in right}, labels, [said])


def _is_steady(late: list[int], by_time: Iterable[Iterable[int]]) -> bool:
    """Whether one side is later by about the same in all pairs: else partners may be those of the next frame."""
    steps = [float(np.median(np.diff(sorted(side)))) for side in by_time]
    return bool(np.ptp(late) <= _UNSTEADY * min(steps))
