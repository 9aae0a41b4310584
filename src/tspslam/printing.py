"""The one place that prints: results on stdout, remarks on stderr, and nothing in them that a terminal would obey."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import select
import sys
import threading
import traceback
from collections.abc import Iterator
from types import TracebackType
from typing import TextIO

from .errors import OutputError

_LOCK = threading.RLock()  # of what follows, and of stderr: whoever says how far one is does so from its own thread
_line = ""  # what stands on the terminal's last line, and will be replaced
_is_json = False  # whether remarks are JSON


def escaped(text: str) -> str:
    r"""Return text with each character that is not printable as its escape; JSON stays JSON.

    Such are line breaks, tabs, the terminal's control characters (C0, C1), marks that turn the direction of writing,
    characters without a width, and bytes of a name that are no text.

    Parameters
    ----------
    text : str
        Of any characters.

    Returns
    -------
    str

    Examples
    --------
    >>> print(escaped("a\x1b[2Jb\u202etxt.exe"))
    a\u001b[2Jb\u202etxt.exe
    """
    return "".join(each if each.isprintable() else _escape(ord(each)) for each in text)


def _escape(code: int) -> str:
    return f"\\u{code:04x}" if code <= 0xFFFF else f"\\U{code:08x}"


def say(*lines: str) -> None:
    """Print lines of a result on stdout; a closed pipe ends the output silently.

    Parameters
    ----------
    lines : str
        Each is a line.

    Raises
    ------
    OutputError
        If stdout is closed, full, or not to be written to.
    """
    if sys.stdout is None:
        raise OutputError("standard output: is closed; expected an open one, such as >/dev/null")
    try:
        _write(sys.stdout, lines)
    except BrokenPipeError:
        _let_go(sys.stdout)
    except OSError as error:
        _let_go(sys.stdout)
        raise OutputError(f"standard output: cannot be written ({error.strerror}); expected an open one") from error


def note(*lines: str) -> None:
    """Print lines on stderr, if anybody listens; above the line that is renewed, if there is one.

    Parameters
    ----------
    lines : str
        Each is a line.
    """
    if sys.stderr is None:
        return
    with _LOCK:
        shown = _line
        renew("")
        try:
            _write(sys.stderr, tuple(map(_remark, lines)) if _is_json else lines)
        except OSError:  # full, or closed: what is in its buffer would be an error at the end of the process
            with contextlib.suppress(OSError):
                _let_go(sys.stderr)
        renew(shown)


def _remark(line: str) -> str:
    """A line as JSON: what it calls itself is the key."""
    kind, _, said = line.partition(": ")
    return json.dumps({kind: said} if kind in ("note", "warning") else {"note": line})


def note_json(values: dict[str, object]) -> None:
    """Print an object as one line of JSON on stderr, if anybody listens; none waits for a reader who does not read.

    Parameters
    ----------
    values : dict
        Plain values; numbers are finite.
    """
    if sys.stderr is not None and _has_room(sys.stderr):
        with _LOCK, contextlib.suppress(OSError):
            _write(sys.stderr, (json.dumps(values, allow_nan=False),))


def _has_room(stream: TextIO) -> bool:
    """Whether a line can be written now: a pipe that nobody empties would hold the writer up, and the run with it."""
    try:
        return bool(select.select([], [stream], [], 0)[1])
    except (OSError, ValueError):  # it has no number, or it is Windows, which cannot tell
        return True


@contextlib.contextmanager
def remarks_as_json() -> Iterator[None]:
    """Let each line of `note` be a JSON object, ``{"note": ...}`` or ``{"warning": ...}``, for programs.

    Yields
    ------
    None
    """
    global _is_json
    before, _is_json = _is_json, True
    try:
        yield
    finally:
        _is_json = before


def is_renewable() -> bool:
    """Tell whether stderr is a terminal on which a line can be written over.

    Returns
    -------
    bool
    """
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


def columns() -> int:
    """Tell how many characters of a line fit on stderr.

    Returns
    -------
    int
        80 where it is no terminal, or does not say.
    """
    try:
        found = os.get_terminal_size(sys.stderr.fileno()).columns
    except (OSError, ValueError, AttributeError):
        found = 0
    return found or 80


def renew(text: str) -> None:
    """Put text in the place of the last line of a terminal, without an end of line; no text takes the line away.

    It takes a carriage return and spaces, which every terminal obeys, and leaves nothing to be put back if the process
    is killed.

    Parameters
    ----------
    text : str
        Of one line; what is beyond the terminal's last column but one is cut.
    """
    global _line
    if not (text or _line):
        return
    with _LOCK, contextlib.suppress(OSError):
        room = columns() - 1  # in the last column some terminals begin the next line
        text = escaped(text)[:room]
        sys.stderr.write(f"\r{text}{' ' * (min(len(_line), room) - len(text))}")
        if not text:
            sys.stderr.write("\r")
        sys.stderr.flush()
        _line = text


def leave(text: str) -> None:
    """Let text, or with none what stands there, be the last on the line that was renewed, and begin the next one.

    Parameters
    ----------
    text : str
        As `renew` takes it.
    """
    global _line
    with _LOCK, contextlib.suppress(OSError):
        if text:
            renew(text)
        if _line:
            _line = ""
            sys.stderr.write("\n")
            sys.stderr.flush()


def _write(stream: TextIO, lines: tuple[str, ...]) -> None:
    encoding = stream.encoding or "utf-8"
    for line in lines:
        stream.write(escaped(line).encode(encoding, "backslashreplace").decode(encoding) + "\n")
    stream.flush()


def _let_go(stream: TextIO) -> None:
    """What is still in the stream's buffer goes nowhere, and not into an error at the end of the process."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def hold_streams() -> None:
    """Open standard streams that are closed on nothing, or the next files would get their numbers and their text."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stderr is None:  # libraries write there without asking: NumPy's did at its import
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115 - it stays open


def listen() -> None:
    """Let logs, Python's warnings and tracebacks go the same way as all else."""
    logging.basicConfig(handlers=[_Remarks()], level=logging.WARNING)
    logging.captureWarnings(True)
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it reports each home that it cannot write
    sys.excepthook = _note_traceback


class _Remarks(logging.Handler):
    """A line on stderr for each record."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print its message."""
        note(" ".join(record.getMessage().split()))


def _note_traceback(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    note(*"".join(traceback.format_exception(kind, error, trace)).splitlines())
