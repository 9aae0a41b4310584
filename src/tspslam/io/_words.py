"""Words of a long text, without a Python object for each of them at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import AnyStr

_PIECE = 1 << 18  # characters: some 10 MB of words at a time


def words_of(text: AnyStr) -> Iterator[list[AnyStr]]:
    """Words between blanks, as lists of those that begin within 256 Ki characters.

    Examples
    --------
    >>> list(words_of("1 2  3"))
    [['1', '2', '3']]
    """
    blank = re.compile(rb"[ \t\n\r\v\f]" if isinstance(text, bytes) else r"\s")
    start = 0
    while start < len(text):
        mark = blank.search(text, start + _PIECE)
        end = mark.start() if mark else len(text)
        yield text[start:end].split()
        start = end
