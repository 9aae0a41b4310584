"""How far a batch is, on stderr: all its runs on one line that is renewed, lines of JSON, or a line now and then."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from ..printing import columns, is_renewable, leave, note, note_json, remarks_as_json, renew
from ._progress import JSON, LOG, TERMINAL, span

if TYPE_CHECKING:
    from ..scale.batch import Event
    from ..scale.summary import Row

_BAR = 16  # characters


class Fleet:
    """What is known of a batch while it goes on.

    Attributes
    ----------
    total, done, failed : int
        Recordings; those that are through; those of them without a result.
    running : dict
        The last step of each that is being run, by its name.
    """

    def __init__(self) -> None:
        self.total = self.done = self.failed = 0
        self.running: dict[str, dict[str, Any]] = {}
        self._began = time.monotonic()

    def take(self, event: Event) -> None:
        """Take what has happened."""
        values = dict(event.values or {})
        if event.kind == "begin":
            self.total, self.done = values["total"], values["done"]
            self.done -= values["refused"]  # each of these is told by itself
        elif event.kind == "step":
            self.running[values.pop("name")] = values
        elif event.row is not None:
            self.running.pop(event.row.name, None)
            self.done += 1
            self.failed += not event.row.is_finished

    @property
    def seconds(self) -> float:
        """How long the batch has taken so far, s."""
        return time.monotonic() - self._began

    def describe(self) -> dict[str, object]:
        """Plain numbers, for programs."""
        running = [{"name": name, **step} for name, step in sorted(self.running.items())]
        return {"done": self.done, "total": self.total, "failed": self.failed, "running": running}

    def line(self, width: int) -> str:
        """Words for all of it in at most `width` characters; of the runs, as many as there is room for."""
        full = _BAR * self.done // self.total if self.total else 0
        failed = f", {self.failed} failed" if self.failed else ""
        head = f"[{'#' * full}{'.' * (_BAR - full)}] {self.done}/{self.total} done{failed}  {span(self.seconds)}"
        for name, step in sorted(self.running.items()):
            more = f"  {name} {_words(step)}"
            if len(head) + len(more) > width:
                break
            head += more
        return head[:width]


def _words(step: dict[str, Any]) -> str:
    return f"{step['done']}/{step['total']}" if step["total"] > 1 else str(step["stage"])


def line_of_row(row: Row, done: int, total: int) -> str:
    """Words for what has become of one recording."""
    said = row.error or f"{row.tracked} of {row.frames} frames"
    if not row.error and row.seconds is not None:
        said += f" in {row.seconds:.1f} s"
    more = f", begun {row.attempts} times" if row.attempts > 1 else ""
    return f"[{done}/{total}] {row.name}: {row.state}: {said}{more}"


class FleetTeller:
    """Tells how far a batch is: each recording that is through, and all of it every so many seconds.

    Parameters
    ----------
    as_json : bool
        Whether programs read it.
    """

    def __init__(self, as_json: bool) -> None:
        self._fleet, self._as_json, self._is_line = Fleet(), as_json, is_renewable() and not as_json
        self._every = JSON if as_json else TERMINAL if self._is_line else LOG
        self._lock, self._end = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._tick, name="progress", daemon=True)

    def __call__(self, event: Event) -> None:
        """Take what has happened, and say it if it is of a whole recording or a remark."""
        with self._lock:
            self._fleet.take(event)
            if event.row is not None:
                self._tell_row(event.row)
            elif event.text:
                note(event.text)

    def _tell_row(self, row: Row) -> None:
        if self._as_json:
            note_json({"recording": row.name, "state": row.state, "error": row.error, **self._fleet.describe()})
        else:
            note(line_of_row(row, self._fleet.done, self._fleet.total))

    def _tick(self) -> None:
        while not self._end.wait(self._every):
            with self._lock:
                if self._fleet.total:
                    self._tell()

    def _tell(self) -> None:
        if self._as_json:
            note_json(self._fleet.describe())
        elif self._is_line:
            renew(self._fleet.line(columns() - 1))
        else:
            note(self._fleet.line(columns()))

    def __enter__(self) -> FleetTeller:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()
        if self._is_line:
            leave("")


@contextlib.contextmanager
def fleet_progress(as_json: bool) -> Iterator[FleetTeller]:
    """Show on stderr how far a batch is.

    Parameters
    ----------
    as_json : bool
        Whether all on it is lines of JSON. Otherwise a line is renewed on a terminal, and elsewhere a line is written
        for each recording that is through, and one a minute.

    Yields
    ------
    callable
        To be called with each `tspslam.scale.batch.Event`.
    """
    with remarks_as_json() if as_json else contextlib.nullcontext(), FleetTeller(as_json) as teller:
        yield teller
