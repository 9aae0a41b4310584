"""Several recordings of one rig as one sequence of pairs: what one map is made of."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import accumulate
from typing import Any, Protocol

import numpy as np

from .._brief import Brief
from ..errors import InputError
from ..types import FloatArray, Rig, StereoPair
from ._pairing import checked_index

_PAUSE = 10  # s at least between two recordings whose own stamps do not rise from one to the next
_LONGEST = 60  # characters of a name, which names a file too
_OTHERS = re.compile(r"[^\w-]+")


class Source(Protocol):
    """Pairs of one rig, by index, with rising stamps."""

    @property
    def name(self) -> str:
        """What to call it."""

    @property
    def rig(self) -> Rig:
        """The cameras of all pairs."""

    def __len__(self) -> int:
        """How many pairs there are."""

    def __getitem__(self, index: int) -> StereoPair:
        """Read one pair."""


@dataclass(frozen=True, repr=False)
class StoredRecording(Brief):
    """A recording whose pairs are not at hand: a run has what it made of them.

    Attributes
    ----------
    name : str
        What it is called there.
    rig : Rig
        Its cameras.
    count : int
        How many pairs it has.
    stamps : (2,) float64
        Of the first and the last of them that were tracked, s.
    offset : float
        What the run has added to its stamps, s.
    warnings, unpaired : tuple
        What the run was told of it.
    """

    name: str
    rig: Rig
    count: int
    stamps: FloatArray
    offset: float = 0.0
    warnings: tuple[dict[str, str], ...] = ()
    unpaired: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> StereoPair:
        """Say that pair `index` is not at hand; IndexError past the end."""
        index = checked_index(index, self.count)
        raise InputError(f"{self.name}: its pair {index} is not at hand, expected frames of a run alone")


@dataclass(frozen=True)
class Excerpt:
    """Some of the pairs of a recording.

    Attributes
    ----------
    whole : Source
        All of them.
    places : range
        Which.
    """

    whole: Source
    places: range

    @property
    def name(self) -> str:
        """That of the whole."""
        return self.whole.name

    @property
    def rig(self) -> Rig:
        """The cameras of all pairs."""
        return self.whole.rig

    @property
    def stamps(self) -> FloatArray | None:
        """Their times, s, where the whole knows them beforehand."""
        return self._some("stamps")

    @property
    def truth(self) -> FloatArray | None:
        """Their true poses (n, 4, 4), where they are known."""
        return self._some("truth")

    @property
    def warnings(self) -> Sequence[dict[str, str]]:
        """What is to be doubted of the whole."""
        return getattr(self.whole, "warnings", ())

    @property
    def remarks(self) -> Sequence[str]:
        """Where the stamps of the whole are from, and how images were paired."""
        return getattr(self.whole, "remarks", ())

    def __len__(self) -> int:
        return len(self.places)

    def __getitem__(self, index: int) -> StereoPair:
        """Read one of these pairs; IndexError past the end."""
        return self.whole[self.places[checked_index(index, len(self))]]

    def _some(self, what: str) -> FloatArray | None:
        values: FloatArray | None = getattr(self.whole, what, None)
        return None if values is None else values[self.places.start : self.places.stop : self.places.step]


class JoinedSequence:
    """Pairs of several recordings, one recording after another, with rising stamps.

    Stamps stay as they are where a recording begins after the end of the one before; else a whole number of seconds is
    added to all of its own, so that it begins 10 to 11 s after that. Pairs of all but the first recording are called
    ``RECORDING/PAIR``.

    Parameters
    ----------
    recordings : sequence of sequences of pairs
        One or more, as `tspslam.datasets.open_sequence` gives them, of the same rig.

    Attributes
    ----------
    recordings : tuple
        As given.
    names : tuple of str
        What each is called: its own name, with a number behind it where two have the same; letters, digits, - and _.
    rig : Rig
        The cameras of all pairs.
    starts : tuple of int
        Index of the first pair of each.
    offsets : (R,) float64
        What is added to the stamps of each, s.
    joined_from : tuple of str
        Hashes of the states of finished runs that the recordings are from, where their maps are joined.

    Raises
    ------
    InputError
        If there is none, one is empty, or the rigs differ: the first value that does is named.

    Examples
    --------
    >>> from tspslam.datasets import synthetic
    >>> one = synthetic.SyntheticSequence(synthetic.corridor(1.5))
    >>> both = JoinedSequence([one, one])
    >>> both.names, both.starts, [round(both[k].stamp, 9) for k in (3, 4, 5)]
    (('corridor', 'corridor-2'), (0, 4), [0.3, 11.0, 11.1])
    """

    joined_from: tuple[str, ...] = ()

    def __init__(self, recordings: Sequence[Source]) -> None:
        self.recordings = tuple(recordings)
        if not self.recordings:
            raise InputError("recordings: there is none, expected one or more")
        empty = next((each for each in self.recordings if not len(each)), None)
        if empty is not None:
            raise InputError(f"{empty.name}: has no pairs, expected one or more")
        self.names = _names(self.recordings)
        self.rig = self.recordings[0].rig
        for recording, name in zip(self.recordings[1:], self.names[1:], strict=True):
            check_same_rig(self.rig, self.names[0], recording.rig, name)
        self._ends = tuple(accumulate(map(len, self.recordings)))
        self.starts = (0, *self._ends[:-1])
        self.offsets = _offsets(self.recordings)

    @property
    def name(self) -> str:
        """The names of all, with a + between."""
        return "+".join(self.names)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.name!r}, {len(self)} pairs)"

    def __len__(self) -> int:
        return self._ends[-1]

    def __getitem__(self, index: int) -> StereoPair:
        """Read pair `index`; IndexError past the end, InputError if a file is bad."""
        index = checked_index(index, len(self))
        k = bisect_right(self.starts, index) - 1
        pair = self.recordings[k][index - self.starts[k]]
        name = f"{self.names[k]}/{pair.name}" if k else pair.name
        return replace(pair, index=index, stamp=pair.stamp + float(self.offsets[k]), name=name)

    def __iter__(self) -> Iterator[StereoPair]:
        """Read one pair after another."""
        return (self[index] for index in range(len(self)))

    def own_stamp(self, index: int, stamp: float) -> float | None:
        """Tell the stamp that a pair has in its own recording.

        Parameters
        ----------
        index : int
            Of the pair.
        stamp : float
            Its stamp here, s.

        Returns
        -------
        float or None
            s; None where it is the same.
        """
        k = bisect_right(self.starts, index) - 1
        if not self.offsets[k]:
            return None
        stamps: FloatArray | None = getattr(self.recordings[k], "stamps", None)
        return stamp - float(self.offsets[k]) if stamps is None else float(stamps[index - self.starts[k]])

    @property
    def stored(self) -> int:
        """How many pairs, the first ones, are to be had from a run alone, as frames."""
        count = sum(isinstance(each, StoredRecording) for each in self.recordings)
        return self._ends[count - 1] if count else 0

    @property
    def unpaired(self) -> list[str]:
        """Images without a partner, of all recordings."""
        return self._told("unpaired")

    @property
    def remarks(self) -> list[str]:
        """Where stamps are from, and how images were paired, of all recordings; what is so of several is told once."""
        return list(dict.fromkeys(self._told("remarks")))

    @property
    def warnings(self) -> list[dict[str, str]]:
        """What is to be doubted of the recordings, each a ``code`` and a ``message``."""
        return self._told("warnings")

    def doubts(self) -> list[dict[str, str]]:
        """Say what is to be doubted of their depths, likewise.

        Returns
        -------
        list of dict
        """
        return [doubt for each in self.recordings for doubt in getattr(each, "doubts", list)()]

    def _told(self, what: str) -> list[Any]:
        return [said for each in self.recordings for said in getattr(each, what, ())]


def check_same_rig(one: Rig, name: str, other: Rig, other_name: str) -> None:
    """Refuse a recording of other cameras: one map has one rig.

    Parameters
    ----------
    one, other : Rig
        The two.
    name, other_name : str
        Of their recordings.

    Raises
    ------
    InputError
        With the first value that differs.
    """
    for field in fields(Rig):
        values = getattr(one, field.name), getattr(other, field.name)
        if values[0] != values[1]:
            raise InputError(
                f"{other_name}: its {field.name} is {values[1]:.9g}, that of {name} is {values[0]:.9g}; expected "
                "recordings of one rig: one map has one calibration"
            )


def _names(recordings: Sequence[Source]) -> tuple[str, ...]:
    """Names that are one word each, no two the same."""
    names: list[str] = []
    for recording in recordings:
        name = stem = _OTHERS.sub("_", recording.name)[:_LONGEST] or "recording"
        number = 2
        while name.lower() in (each.lower() for each in names):  # some disks take both for one
            name, number = f"{stem}-{number}", number + 1
        names.append(name)
    return tuple(names)


def _offsets(recordings: Sequence[Source]) -> FloatArray:
    """What makes stamps rise from each recording to the next, s."""
    offsets, end = np.zeros(len(recordings)), -np.inf
    for k, recording in enumerate(recordings):
        first, last = _ends_of(recording)
        needed = 0 if first > end else np.floor(end - first) + 1 + _PAUSE
        offsets[k] = recording.offset if isinstance(recording, StoredRecording) else needed
        end = last + offsets[k]
    return offsets


def _ends_of(recording: Source) -> tuple[float, float]:
    """Stamps of the first and the last pair, s."""
    stamps: FloatArray | None = getattr(recording, "stamps", None)
    if stamps is not None:
        return float(stamps[0]), float(stamps[-1])
    count = len(recording)
    return _stamp(recording, range(count)), _stamp(recording, range(count - 1, -1, -1))


def _stamp(recording: Source, places: range) -> float:
    """Stamp of the first of some pairs that can be read, s."""
    for place in places:
        try:
            return recording[place].stamp
        except InputError as error:
            last = error
    raise last
