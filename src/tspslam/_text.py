"""Text that other programs wrote: its encoding, lines, comments and separators, told the same way for every format."""

from __future__ import annotations

import codecs
import io
import json
import re
from collections.abc import Collection, Iterator, Sequence
from typing import Any

from . import _files
from ._files import LARGEST_FILE, PathLike, bad_input, reason_of

Line = tuple[int, str]
"""Number of a line of a file, from 1, and its text without the blanks around it."""

# UTF-32's mark begins with that of UTF-16, so it is looked for first.
_MARKS = (
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_HEAD = 1 << 12  # bytes that tell the encoding
_COMMENT = ("#", "%")
_NUMBER = re.compile(
    r"[-+]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|nan|inf(?:inity)?)", re.IGNORECASE | re.ASCII
)
_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?")


def encoding_of(data: bytes) -> str | None:
    """Return the encoding that the byte-order mark at the head of a file tells, if it has one.

    Examples
    --------
    >>> encoding_of("v 0 0 1".encode("utf-16")), encoding_of(b"v 0 0 1")
    ('utf-16', None)
    """
    return next((name for mark, name in _MARKS if data.startswith(mark)), None)


def unmarked(data: bytes) -> bytes:
    """Return the content of a file as UTF-8 without a byte-order mark; without one, as it is.

    Examples
    --------
    >>> unmarked("ply".encode("utf-16")), unmarked(codecs.BOM_UTF8 + b"ply")
    (b'ply', b'ply')
    """
    encoding = encoding_of(data)
    if encoding in (None, "utf-8-sig"):  # what follows may be binary
        return data.removeprefix(codecs.BOM_UTF8)
    return data.decode(str(encoding), "replace").encode("utf-8", "replace")


def read_lines(path: PathLike, expected: str, largest: int = LARGEST_FILE) -> Iterator[Line]:
    """Yield the lines of a text file, comments left out; blank ones stay, since a format may count them.

    UTF-8, and with a byte-order mark UTF-16 and UTF-32; lines end with LF, CR LF or CR. A comment is a line that begins
    with # or %, blanks before it or not. Bytes that are no UTF-8 may stand in comments and names: as a number, they
    are refused.

    Raises
    ------
    InputError
        If the file cannot be opened, or holds zero bytes, as no text does.
    """
    with _opened(path, expected, largest) as handle:
        try:
            for number, line in enumerate(handle, 1):
                text = line.strip()
                if "\0" in text:
                    raise bad_input(path, f"is no text: line {number} holds a zero byte", expected)
                if not text.startswith(_COMMENT):
                    yield number, text
        except (OSError, UnicodeError, MemoryError) as error:
            raise _unread(path, error, expected) from error


def read_text(path: PathLike, expected: str, largest: int = LARGEST_FILE) -> str:
    """Return the whole text of a file, as `read_lines` decodes it, with LF after each line; all must be UTF-8."""
    with _opened(path, expected, largest) as handle:
        try:
            text = handle.read()
        except (OSError, UnicodeError, MemoryError) as error:
            raise _unread(path, error, expected) from error
    wrong = re.search("[\udc80-\udcff]", text)
    if wrong:
        line, byte = text.count("\n", 0, wrong.start()) + 1, ord(wrong[0]) - 0xDC00
        raise bad_input(path, f"is no text in UTF-8: line {line} has the byte 0x{byte:02x}", expected)
    return text


def split(
    path: PathLike, line: Line, expected: str, counts: Collection[int] = (), separator: str | None = None
) -> list[str]:
    """Return the words of a line before a #; as many as one of `counts`, if there are any.

    Raises
    ------
    InputError
        If they are not; it names the separators that were found instead.
    """
    number, text = line[0], line[1].partition("#")[0].rstrip()
    words = [word.strip() for word in text.split(separator)]
    if counts and len(words) not in counts:
        values = "1 value" if len(words) == 1 else f"{len(words)} values"
        raise bad_input(path, f"line {number} has {values}{separators_of(text, separator)}", expected)
    return words


def numbers(path: PathLike, line: Line, words: Sequence[str], expected: str) -> list[float]:
    """Return words of a line as numbers, NaN and infinities too; plain ones: no underscores, no digits but 0 to 9.

    Raises
    ------
    InputError
        If a word is none; it names the word and, if that is why, the separators.
    """
    try:
        if is_plain("".join(words)):  # float takes 1_000 and other digits too
            return [float(word) for word in words]
    except ValueError:
        pass
    word = next(word for word in words if not _NUMBER.fullmatch(word))
    said = f"line {line[0]} holds a word that is no number: {word[:40]!r}{separators_of(line[1])}"
    raise bad_input(path, said, expected)


def separators_of(text: str, separator: str | None = None) -> str:
    """Say what separates the values of a line where that is not `separator` (None: blanks); else nothing.

    Examples
    --------
    >>> separators_of("1;2;3"), separators_of("0,5 1,5"), separators_of("1, 2, 3"), separators_of("1 2 3")
    (', separated by semicolons', ', with decimal commas', ', separated by commas', '')
    """
    words = text.split()
    if ";" in text and separator != ";":
        return ", separated by semicolons"
    if "," in text and separator != ",":
        is_decimal = len(words) > 1 and any(map(_DECIMAL_COMMA.fullmatch, words))
        return ", with decimal commas" if is_decimal else ", separated by commas"
    return ", separated by blanks" if separator and separator not in text and len(words) > 1 else ""


def parse_json(data: bytes) -> Any:
    """Return what JSON says; ValueError for what is none, NaN and infinities too, RecursionError for the deepest.

    Examples
    --------
    >>> parse_json(b'{"n": 3}')
    {'n': 3}
    """
    return json.loads(data, parse_constant=_refuse_constant)


def _refuse_constant(name: str) -> None:
    raise ValueError(f"it holds {name}")


def is_whole(text: str, most: int) -> bool:
    """Tell whether a text is a whole number without a sign, of at most so many digits, 0 to 9.

    Examples
    --------
    >>> is_whole("12", 20), is_whole("-1", 20), is_whole("\u00b2", 20)
    (True, False, False)
    """
    return text.isascii() and text.isdecimal() and len(text) <= most


def is_plain(text: str) -> bool:
    """Tell whether a text has neither underscores nor letters beyond ASCII, which Python takes within numbers."""
    return text.isascii() and "_" not in text


def is_comment(text: str) -> bool:
    """Tell whether a line says nothing: it begins with # or %, blanks before it or not."""
    return text.startswith(_COMMENT) or text.lstrip().startswith(_COMMENT)


def _opened(path: PathLike, expected: str, largest: int) -> io.TextIOWrapper:
    """Open a text file; ends of lines become LF."""
    handle = _files.open_input(path, expected, largest)
    try:
        head = handle.read(_HEAD)
        handle.seek(0)
    except OSError as error:
        handle.close()
        raise _unread(path, error, expected) from error
    encoding = encoding_of(head)
    if encoding is None and _is_wide(head):
        handle.close()
        raise bad_input(path, "is UTF-16 without a byte-order mark", f"{expected}, in UTF-8")
    bad = "surrogateescape" if encoding in (None, "utf-8-sig") else "strict"
    return io.TextIOWrapper(handle, encoding or "utf-8", bad, newline=None)


def _is_wide(head: bytes) -> bool:
    """Whether every second byte is zero, most of them, as in UTF-16."""
    half = len(head) // 2
    return half > 1 and max(head[: 2 * half : 2].count(0), head[1 : 2 * half : 2].count(0)) > 0.9 * half


def _unread(path: PathLike, error: Exception, expected: str) -> Exception:
    said = "is no text" if isinstance(error, UnicodeError) else "cannot be read"
    return bad_input(path, f"{said} ({reason_of(error)})", expected)
