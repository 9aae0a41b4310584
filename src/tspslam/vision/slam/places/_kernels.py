"""Compiled loops of the place index: keys of words, lists of the words of each key, votes of words for keyframes.

A word is a descriptor that one keyframe or more show. Its views are a chain: ``head[word]`` is the first, ``view[v]``
says whose it is and ``after[v]`` which is next; -1 ends it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...._jit import inlined, kernel
from ...features._hamming import hamming

Words = NDArray[np.uint64]
UInt32 = NDArray[np.uint32]
Int32 = NDArray[np.int32]
Int64 = NDArray[np.int64]
UInt8 = NDArray[np.uint8]

LIST_BITS = 16  # of a key, say in which list of its table a word is
WORD_BITS = 24  # of an entry in a list, say which word; the other 8 are bits of the key that the list does not say
SMALLEST = 2  # log2 of the room of a new list: four entries
SIZES = 40  # log2 of the longest list, at most
NONE = np.uint32(0xFFFFFFFF)

_LOW, _WORD = (1 << LIST_BITS) - 1, (1 << WORD_BITS) - 1


@kernel
def make_keys(descriptors: Words, bits: Int64, keys: UInt32) -> None:
    """Gather, for each descriptor and table, the bits (T, B) that make its key (N, T)."""
    for i in range(descriptors.shape[0]):
        for t in range(bits.shape[0]):
            key = np.uint64(0)
            for b in range(bits.shape[1]):
                place = bits[t, b]
                bit = (descriptors[i, place >> 6] >> np.uint64(place & 63)) & np.uint64(1)
                key = (key << np.uint64(1)) | bit
            keys[i, t] = np.uint32(key)


@kernel
def find_words(descriptors: Words, keys: UInt32, start: Int64, used: UInt32, room: UInt32, words: Words,
               found: Int64) -> None:  # fmt: skip
    """Which word each descriptor is, bit for bit; -1 if it is none."""
    for i in range(descriptors.shape[0]):
        key = np.int64(keys[i, 0])
        at = key & _LOW
        found[i] = -1
        for k in range(start[at], start[at] + np.int64(used[at])):
            word = np.int64(room[k]) & _WORD
            if hamming(words[word], descriptors[i]) == 0:
                found[i] = word
                break


@kernel
def add_entries(keys: UInt32, word: Int64, done: int, start: Int64, used: UInt32, size: UInt8, room: UInt32,
                free: Int64) -> int:  # fmt: skip
    """Enter words (N,) under their keys (N, T), from entry `done` on; returns how far `room` sufficed.

    List l of ``start`` (T * 65536) begins at ``room[start[l]]``, holds ``used[l]`` entries and has room for
    ``2**size[l]``. ``free[s]`` is the first list of that size that nobody uses, and its first entry says which is the
    next; ``free[SIZES]`` is where the rest of `room` begins.
    """
    tables = keys.shape[1]
    for e in range(done, keys.shape[0] * tables):
        key = np.int64(keys[e // tables, e % tables])
        at = ((e % tables) << LIST_BITS) | (key & _LOW)
        count = np.int64(used[at])
        if start[at] < 0 or count == np.int64(1) << np.int64(size[at]):
            larger = SMALLEST if start[at] < 0 else np.int64(size[at]) + 1
            place = _take(larger, room, free)
            if place < 0:
                return e
            if start[at] >= 0:
                for k in range(count):  # a copy between slices would take seconds to compile
                    room[place + k] = room[start[at] + k]
                _give(start[at], np.int64(size[at]), room, free)
            start[at], size[at] = place, np.uint8(larger)
        room[start[at] + count] = _entry(key, word[e // tables])
        used[at] = np.uint32(count + 1)
    return keys.shape[0] * tables


@inlined
def _entry(key: int, word: int) -> np.uint32:
    return np.uint32(((key >> LIST_BITS) << WORD_BITS) | word)


@kernel
def _take(size: int, room: UInt32, free: Int64) -> int:
    """Find room for a list of ``2**size`` entries; -1 if there is none."""
    place = free[size]
    if place >= 0:
        following = room[place]
        free[size] = -1 if following == NONE else np.int64(following)
        return place
    place = free[SIZES]
    if place + (1 << size) > room.shape[0]:
        return -1
    free[SIZES] = place + (1 << size)
    return place


@kernel
def _give(place: int, size: int, room: UInt32, free: Int64) -> None:
    """Note that nobody uses a list any more."""
    room[place] = NONE if free[size] < 0 else np.uint32(free[size])
    free[size] = place


@kernel
def drop_entries(keys: UInt32, word: Int64, start: Int64, used: UInt32, room: UInt32) -> None:
    """Take words (N,) out from under their keys (N, T)."""
    tables = keys.shape[1]
    for e in range(keys.shape[0] * tables):
        key = np.int64(keys[e // tables, e % tables])
        at = ((e % tables) << LIST_BITS) | (key & _LOW)
        entry = _entry(key, word[e // tables])
        last = start[at] + np.int64(used[at]) - 1
        k = last
        while room[k] != entry:
            k -= 1
        room[k] = room[last]
        used[at] -= np.uint32(1)


@kernel
def add_views(word: Int64, slot: int, place: Int64, head: Int32, view: Int32, after: Int32) -> None:
    """Note that a keyframe shows words (N,), in free places (N,) of the views."""
    for i in range(word.shape[0]):
        view[place[i]], after[place[i]] = slot, head[word[i]]
        head[word[i]] = place[i]


@kernel
def drop_views(word: Int64, slot: int, head: Int32, view: Int32, after: Int32, place: Int64) -> None:
    """Forget that a keyframe shows words (N,); says which places of the views (N,) are free then."""
    for i in range(word.shape[0]):
        before, k = np.int64(-1), np.int64(head[word[i]])
        while view[k] != slot:
            before, k = k, np.int64(after[k])
        if before < 0:
            head[word[i]] = after[k]
        else:
            after[before] = after[k]
        place[i] = k


@kernel
def count_votes(descriptors: Words, keys: UInt32, start: Int64, used: UInt32, room: UInt32, words: Words, head: Int32,
                view: Int32, after: Int32, farthest: int, weight: Int64, votes: Int64) -> None:  # fmt: skip
    """Let each descriptor vote for the keyframes that show a word near it, by how many those are.

    Words are compared that share a key with it; those within `farthest` bits are near.
    """
    seen = np.full(votes.shape[0], -1, np.int32)
    chosen = np.empty(votes.shape[0], np.int32)
    for i in range(descriptors.shape[0]):
        count = 0
        for t in range(keys.shape[1]):
            key = np.int64(keys[i, t])
            at = (t << LIST_BITS) | (key & _LOW)
            for k in range(start[at], start[at] + np.int64(used[at])):
                entry = np.int64(room[k])
                word = entry & _WORD
                if entry >> WORD_BITS != key >> LIST_BITS or hamming(words[word], descriptors[i]) > farthest:
                    continue
                v = head[word]
                while v >= 0:
                    if seen[view[v]] != i:
                        seen[view[v]] = i
                        chosen[count] = view[v]
                        count += 1
                    v = after[v]
        for k in range(count):
            votes[chosen[k]] += weight[min(count, weight.shape[0] - 1)]
