"""The command line: every error becomes one line and its exit code. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import _thread
import contextlib
import io
import os
import re
import signal
import sys
import threading
from collections.abc import Callable
from typing import Annotated

import typer

from .. import __version__
from ..errors import InputError, OutputError, TspSlamError
from ..printing import hold_streams, listen, note, say
from . import board, jobs, join, look, runs, scale, show, stores, uses  # noqa: F401  (each hangs its commands on the parser)
from ._shared import BAD_INPUT, COMPLETE, INTERNAL, INTERRUPTED, NOT_WRITTEN, USAGE, app

_AGAIN = 0.05  # s after which an interrupt that was lost in a callback is given again
_LAST = 10.0  # s that threads have to end after an interrupt: a step of a run takes less
_is_lost = threading.Event()  # an interrupt came in a callback of C, which cannot pass it on
_UsageError = typer.BadParameter.__mro__[1]  # click's, wherever this version of typer keeps it


@app.callback(invoke_without_command=True)
def root(
    version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Print the version, if asked; `main` reads --debug itself."""
    if version:
        say(__version__)
        raise typer.Exit


def main() -> None:
    """Run the command line; every error becomes one line and its exit code."""
    hold_streams()
    listen()
    signal.signal(signal.SIGTERM, _interrupt)  # what was begun is taken away, as at ctrl-C
    sys.unraisablehook = _heed
    os.environ["MPLBACKEND"] = "agg"  # no window is opened; a name that Matplotlib no longer knows would end the run
    code = exit_code(sys.argv[1:])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # all is said and written
    _is_lost.clear()
    if code == INTERRUPTED:
        _call_later(_LAST, lambda: os._exit(code))
    sys.exit(code)


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _heed(lost: sys.UnraisableHookArgs) -> None:
    """Give an interrupt again that came while a compiler called back: there it is dropped, and the command goes on."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    _is_lost.set()
    _call_later(_AGAIN, _interrupt_again)


def _interrupt_again() -> None:
    if not _is_lost.is_set():  # the command has ended meanwhile
        return
    if sys.platform == "win32":
        _thread.interrupt_main(signal.SIGTERM)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)  # which ends its wait, if it waits


def _call_later(seconds: float, function: Callable[[], object]) -> None:
    timer = threading.Timer(seconds, function)
    timer.daemon = True
    timer.start()


def exit_code(arguments: list[str]) -> int:
    """Run one command line; its exit code.

    Parameters
    ----------
    arguments : list of str
        What follows ``tspslam``.

    Returns
    -------
    int
        0 complete, 2 usage, 3 bad input, 4 degraded, 5 not written, 1 internal, 130 interrupted.
    """
    try:
        code = _run(arguments)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except Exception as error:
        if not _is_interrupt(error) and not _is_lost.is_set():
            if "--debug" in arguments:
                raise
            return _complain(_line(error), _code_of(error))
        code = INTERRUPTED
    if code == INTERRUPTED:
        if "--camera" in arguments:
            return _complain("interrupted; tspslam run takes what was recorded, as any folder", INTERRUPTED)
        what = "goes on where this one stopped" if {"run", "batch", "join"} & {*arguments[:2]} else "begins anew"
        return _complain(f"interrupted; the same command {what}", INTERRUPTED)
    return code


def _run(arguments: list[str]) -> int:
    words = [word for word in arguments if word != "--debug"]
    _refuse_empty(words)
    say()  # nothing, but a closed stdout is seen before the work
    page = io.StringIO()  # help, which click prints: as all else, it goes through `_say`
    is_page = "--help" in words or set(words) <= {"config", "calib"}
    try:
        with contextlib.redirect_stdout(page) if is_page else contextlib.nullcontext():
            outcome = typer.main.get_command(app).main(words, prog_name="tspslam", standalone_mode=False)
    except typer.Exit as stop:
        outcome = stop.exit_code
    say(*page.getvalue().splitlines())
    return outcome if isinstance(outcome, int) else COMPLETE


def _refuse_empty(words: list[str]) -> None:
    """Refuse empty words, as a shell's unset variables give: as paths they would be the folder one is in."""
    for before, word in zip(["tspslam", *words], words, strict=False):
        if not word or re.fullmatch("--[a-z-]+=", word):
            raise typer.BadParameter(f"nothing follows {word or before}; is a variable of the shell unset?")


def _code_of(error: Exception) -> int:
    from .._atomic import NO_ROOM

    if isinstance(error, _UsageError):
        return USAGE
    if isinstance(error, OutputError) or (isinstance(error, OSError) and error.errno in NO_ROOM):
        return NOT_WRITTEN
    return BAD_INPUT if isinstance(error, InputError) else INTERNAL


def _line(error: Exception) -> str:
    if isinstance(error, _UsageError):
        said: str = error.format_message()  # type: ignore[attr-defined]
        return said if said.startswith("Usage:") else f"{' '.join(said.split())} (see tspslam --help)"
    text = " ".join(str(error).split())
    if isinstance(error, TspSlamError):
        return text
    if isinstance(error, OSError) and _code_of(error) == NOT_WRITTEN:
        return f"{error.filename or 'output'}: cannot be written ({error.strerror}); expected a place with space"
    return f"internal error: {type(error).__name__}: {text} (--debug shows where)"


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether an interrupt came while a compiled loop was entered or left: Python then calls it an error of its own."""
    while isinstance(error, SystemError):
        error = error.__cause__ or error.__context__
    return isinstance(error, KeyboardInterrupt)


def _complain(line: str, code: int) -> int:
    note(*f"tspslam: {line}".split("\n"))
    return code
