"""Keyframes by their looks: an index over binary descriptors that learns as it goes and forgets what is dropped."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import InputError
from ....types import FloatArray
from ...features.binary import Descriptors

_TABLES, _KEY_BITS = 4, 18
_FARTHEST = 40  # bits in 256; longer descriptors in proportion
_BIT_OF_WEIGHT = 64  # a weight of one bit: whole numbers, so that their sum does not depend on the order
_RARE = 1 << 10  # keyframes of one word whose weights are told apart; more of them weigh as little
_SMALLEST = 1 << 10  # rows of an array that grows
_MOST_WORDS = 1 << 24  # as many as an entry can name


class PlaceIndex:
    """Which keyframes show what a view shows, by words found in hash tables that are keyed by some bits each (LSH).

    Each descriptor of a keyframe is a word; keyframes that show the same landmark share it. Two descriptors of one
    point differ in few bits, so that one of several keys of 18 bits is often the same (Indyk & Motwani 1998). Words
    found so are compared bit by bit, and those within 40 bits vote for their keyframes, the more the fewer these are:
    ``log2((K + 1) / count)``. There is no vocabulary to load. What is in the index, not how it came there, decides
    what is found.

    Attributes
    ----------
    numbers : (K,) int64
        Of the keyframes, ascending.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> views = [rng.integers(0, 2**63, (50, 4), dtype=np.uint64) for _ in range(20)]
    >>> index = PlaceIndex()
    >>> for number, view in enumerate(views):
    ...     index.add(number, view)
    >>> index.query(views[7] ^ np.uint64(1 << 5), 1)[0].tolist()
    [7]
    """

    def __init__(self) -> None:
        from . import _kernels

        lists = _TABLES << _kernels.LIST_BITS
        self._start, self._used = np.full(lists, -1, np.int64), np.zeros(lists, np.uint32)
        self._size, self._room = np.zeros(lists, np.uint8), np.zeros(0, np.uint32)
        self._free = np.full(_kernels.SIZES + 1, -1, np.int64)
        self._free[-1] = 0
        self._words, self._head = np.zeros((0, 0), np.uint64), np.zeros(0, np.int32)
        self._view, self._after = np.zeros(0, np.int32), np.zeros(0, np.int32)
        self._word_places, self._view_places, self._slots = _Places(), _Places(), _Places()
        self._shown: dict[int, tuple[int, NDArray[np.int32]]] = {}  # slot and words of each keyframe
        self._number = np.zeros(0, np.int64)  # by slot
        self._bits: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self._shown)

    def __contains__(self, number: int) -> bool:
        return number in self._shown

    def __repr__(self) -> str:
        return f"PlaceIndex({len(self)} keyframes, {self.nbytes / 1e6:.1f} MB)"

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Numbers of the keyframes, ascending, (K,)."""
        return np.array(sorted(self._shown), np.int64)

    @property
    def nbytes(self) -> int:
        """Memory that its arrays take, bytes."""
        arrays = (
            self._start, self._used, self._size, self._room, self._words, self._head, self._view, self._after,
            self._number,
        )  # fmt: skip
        return sum(one.nbytes for one in arrays) + sum(words.nbytes for _, words in self._shown.values())

    def add(self, number: int, descriptors: Descriptors) -> None:
        """Enter a keyframe.

        Parameters
        ----------
        number : int
            Its number, from 0; none that the index holds.
        descriptors : (N, P) uint64
            What it shows; the same one twice counts once.

        Raises
        ------
        InputError
            If the number is held, or P is another than before.
        """
        from ._kernels import add_views

        if number in self._shown or number < 0:
            raise InputError(f"place index: keyframe {number} is added, expected a number from 0 that it does not hold")
        word = self._words_of(descriptors)
        slot, place = int(self._slots.take(1)[0]), self._view_places.take(len(word))
        self._number = grown(self._number, slot + 1)
        self._number[slot] = number
        end = self._view_places.end
        self._view, self._after = grown(self._view, end), grown(self._after, end)
        add_views(word, slot, place, self._head, self._view, self._after)
        self._shown[number] = slot, word.astype(np.int32)

    def drop(self, number: int) -> None:
        """Forget a keyframe.

        Parameters
        ----------
        number : int
            Its number.

        Raises
        ------
        InputError
            If the index does not hold it.
        """
        from ._kernels import drop_entries, drop_views

        if number not in self._shown:
            raise InputError(f"place index: keyframe {number} is dropped, expected one that it holds")
        slot, shown = self._shown.pop(number)
        word, place = shown.astype(np.int64), np.empty(len(shown), np.int64)
        drop_views(word, slot, self._head, self._view, self._after, place)
        gone = word[self._head[word] < 0]
        drop_entries(self._keys_of(self._words[gone]), gone, self._start, self._used, self._room)
        self._view_places.give(place)
        self._word_places.give(gone)
        self._slots.give(np.array([slot]))

    def query(self, descriptors: Descriptors, most: int) -> tuple[NDArray[np.int64], FloatArray]:
        """Find the keyframes that share most with a view.

        Parameters
        ----------
        descriptors : (N, P) uint64
            What it shows.
        most : int
            How many to return.

        Returns
        -------
        numbers : (R,) int64
            Of keyframes that share something with it, the most similar first; of equals, the lower number.
        words : (R,) float64
            How many they share: a word that only one keyframe shows counts 1, one that all show nothing.

        Raises
        ------
        InputError
            If P is another than that of the keyframes.
        """
        from ._kernels import count_votes

        keys = self._keys_of(descriptors)
        if not len(self) or not descriptors.size:
            return np.empty(0, np.int64), np.empty(0)
        votes, shared = np.zeros(len(self._number), np.int64), np.maximum(1, np.arange(_RARE))
        weight = np.rint(_BIT_OF_WEIGHT * np.log2((len(self) + 1) / shared)).clip(0).astype(np.int64)
        count_votes(
            descriptors, keys, self._start, self._used, self._room, self._words, self._head, self._view, self._after,
            _FARTHEST * descriptors.shape[1] // 4, weight, votes,
        )  # fmt: skip
        found = np.flatnonzero(votes)
        best = found[np.lexsort((self._number[found], -votes[found]))[:most]]
        return self._number[best], votes[best] / weight[1]

    def _keys_of(self, descriptors: Descriptors) -> NDArray[np.uint32]:
        """Keys of descriptors in each table, (N, T); none of descriptors without bits."""
        from ._kernels import make_keys

        width = descriptors.shape[1]
        if self._bits is None:
            self._bits, self._words = _choose_bits(64 * width), np.zeros((0, width), np.uint64)
        if width != self._words.shape[1]:
            raise InputError(f"place index: descriptors have {width} x 64 bits, expected {self._words.shape[1]} x 64")
        keys = np.empty((len(descriptors), _TABLES), np.uint32)
        make_keys(descriptors, self._bits, keys)
        return keys

    def _words_of(self, descriptors: Descriptors) -> NDArray[np.int64]:
        """Words that descriptors are, each once; new ones are entered."""
        from ._kernels import find_words

        descriptors = _distinct(descriptors)
        keys, word = self._keys_of(descriptors), np.empty(len(descriptors), np.int64)
        find_words(descriptors, keys, self._start, self._used, self._room, self._words, word)
        new = np.flatnonzero(word < 0)
        word[new] = self._word_places.take(len(new))
        if self._word_places.end > _MOST_WORDS:
            raise InputError(f"place index: it holds {_MOST_WORDS} words, expected fewer")
        end = self._word_places.end
        self._words, self._head = grown(self._words, end), grown(self._head, end)
        self._words[word[new]], self._head[word[new]] = descriptors[new], -1
        self._enter(keys[new], word[new])
        return word

    def _enter(self, keys: NDArray[np.uint32], word: NDArray[np.int64]) -> None:
        """Enter words under their keys; the room of the lists grows where it is too small."""
        from ._kernels import add_entries

        done = 0
        while done < keys.size:
            lists = self._start, self._used, self._size, self._room, self._free
            done = add_entries(keys, word, done, *lists)
            if done < keys.size:
                self._room = grown(self._room, len(self._room) + 1)


class _Places:
    """Which rows of an array are free: those given back first, the last one first, then those beyond its end."""

    def __init__(self) -> None:
        self.end = 0
        self._free = np.zeros(0, np.int64)

    def take(self, count: int) -> NDArray[np.int64]:
        split = max(0, len(self._free) - count)
        old, self._free = self._free[split:], self._free[:split]
        new = self.end + np.arange(count - len(old))
        self.end += len(new)
        return np.concatenate([old, new])

    def give(self, rows: NDArray[np.int64]) -> None:
        self._free = np.concatenate([self._free, rows])


def grown(array: Any, least: int) -> Any:
    """Make an array long enough: itself, or a copy half as long again, zeros at its end.

    Parameters
    ----------
    array : (N, ...) of any kind
        What is there.
    least : int
        Rows wanted.

    Returns
    -------
    Any
        At least `least` rows.
    """
    if len(array) >= least:
        return array
    larger = np.zeros((max(least, len(array) * 3 // 2, _SMALLEST), *array.shape[1:]), array.dtype)
    larger[: len(array)] = array
    return larger


def _distinct(descriptors: Descriptors) -> Descriptors:
    """Descriptors, each once; none of those without bits."""
    if not descriptors.size:
        return descriptors[:0]
    rows = descriptors[np.lexsort(descriptors.T)]
    return rows[np.append(True, (rows[1:] != rows[:-1]).any(axis=1))]


def _choose_bits(count: int) -> NDArray[np.int64]:
    """Places of the bits that make the keys, (T, B), each used once where there are enough; none of nothing."""
    if not count:
        return np.empty((_TABLES, 0), np.int64)
    rng = np.random.default_rng(0)
    rounds = -(-_TABLES * _KEY_BITS // count)
    places = np.concatenate([rng.permutation(count) for _ in range(rounds)])
    return places[: _TABLES * _KEY_BITS].reshape(_TABLES, _KEY_BITS)
