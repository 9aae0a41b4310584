"""The one place that prints: results on stdout, remarks on stderr, and nothing in them that a terminal would obey."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
import traceback
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import TextIO

from .errors import OutputError


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
    """Print lines on stderr, if anybody listens.

    Parameters
    ----------
    lines : str
        Each is a line.
    """
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            _write(sys.stderr, lines)


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


@contextlib.contextmanager
def progress(total: int) -> Iterator[Callable[[int, int, str], None]]:
    """Show how far one is: a bar on stderr if it is a terminal, else a line every tenth of the frames.

    Parameters
    ----------
    total : int
        Number of frames.

    Yields
    ------
    callable, (done, total, name)
        To call after each frame.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        every = max(1, total // 10)
        yield (lambda done, of, name: note(f"{done}/{of} {name}") if of > 1 and done % every == 0 else None)
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("frames", total=total)
        yield lambda done, of, name: bar.update(task, completed=done, description=escape(escaped(name)))
