"""How far a run is, on stderr: one line that is renewed, lines of JSON, or a sign of life now and then."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from ..printing import columns, is_renewable, leave, note, note_json, remarks_as_json, renew

if TYPE_CHECKING:
    from ..run.pipeline import Step

TERMINAL, JSON, LOG = 0.2, 1.0, 60.0  # s between two lines: for eyes, for programs, for a file that somebody may open
_LAST = 30  # frames whose pace is taken for that of the next ones
_BAR = 20  # characters, where there is room


class Pace:
    """The steps of a run, and the times at which they were told.

    Parameters
    ----------
    clock : callable
        Gives seconds that only grow.

    Attributes
    ----------
    step : Step or None
        The last one.
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.step: Step | None = None
        self._clock, self._began, self._stage_began = clock, clock(), 0.0
        self._seen: deque[tuple[float, int]] = deque(maxlen=_LAST + 1)

    def note(self, step: Step) -> None:
        """Take the next step."""
        now = self._clock()
        if self.step is None or self.step.stage != step.stage:
            self._stage_began = now
            self._seen.clear()
        elif step.done > self.step.done:  # not where it began: the first frame may wait for kernels
            self._seen.append((now, step.done))
        self.step = step

    @property
    def rate(self) -> float | None:
        """Frames a second, of the last ones; None before two are done."""
        if len(self._seen) < 2:
            return None
        (start, before), (end, done) = self._seen[0], self._seen[-1]
        return (done - before) / (end - start) if end > start else None

    @property
    def left(self) -> float | None:
        """Time that the rest of the frames will take, s, if nothing changes."""
        rate = self.rate
        return None if rate is None or self.step is None else (self.step.total - self.step.done) / rate

    @property
    def stage_seconds(self) -> float:
        """How long the stage has taken so far, s."""
        return self._clock() - self._stage_began

    @property
    def seconds(self) -> float:
        """How long all has taken so far, s."""
        return self._clock() - self._began


def describe(pace: Pace) -> dict[str, object]:
    """Numbers of where a run is, finite or None, for programs."""
    step, rate, left = pace.step, pace.rate, pace.left
    assert step is not None
    return {
        "stage": step.stage, "done": step.done, "total": step.total,
        "frames_per_s": None if rate is None else round(rate, 2), "left_s": None if left is None else round(left, 1),
        "keyframes": step.keyframes, "lost": step.lost, "loops": step.loops,
    }  # fmt: skip


def line_of(pace: Pace, width: int) -> str:
    """Words for where a run is, in at most `width` characters, fewer words where room is short."""
    step = pace.step
    assert step is not None
    parts = [step.stage, *_pace_of(pace), *_counts(step)]
    short = " ".join(parts).replace(" frames/s", "/s").replace(" keyframe", " kf").replace(" kfs", " kf")
    line = "  ".join(parts)
    line = line if len(line) <= width else short[:width]
    is_counted = step.total > 1 and len(line) + _BAR + 4 <= width
    return f"{step.stage}  {_bar(step)}{line.removeprefix(step.stage)}" if is_counted else line


def closing_line(pace: Pace) -> str:
    """Words for a run that has ended."""
    step = pace.step
    assert step is not None
    return "  ".join([f"done in {span(pace.seconds)}", *_counts(step)])


def _pace_of(pace: Pace) -> list[str]:
    """How far, how fast, how long: of a stage without a count, how long it has taken."""
    step, rate, left = pace.step, pace.rate, pace.left
    if step is None or step.stage not in ("indexing", "tracking", "corners"):
        return [span(pace.stage_seconds)]
    said = [f"{step.done}/{step.total}"]
    if rate is not None and left is not None:
        said += [f"{rate:.3g} frames/s" if rate < 100 else f"{rate:.0f} frames/s", f"{span(left)} left"]
    return said


def _counts(step: Step) -> list[str]:
    if not step.keyframes:  # there is nothing to count yet
        return []
    words = (step.keyframes, "keyframe", "s"), (step.lost, "lost", ""), (step.loops, "loop", "s")
    return [f"{count} {word}{'' if count == 1 else more}" for count, word, more in words]


def _bar(step: Step) -> str:
    full = _BAR * step.done // step.total
    return f"[{'#' * full}{'.' * (_BAR - full)}]"


def span(seconds: float) -> str:
    """Words for a time: minutes and seconds, from an hour on hours too."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def show_line(pace: Pace, event: str) -> None:
    """Renew the line of a terminal."""
    if event == "done":
        leave(closing_line(pace))
    elif event == "stopped":
        leave("")
    elif event != "end":
        renew(line_of(pace, columns() - 1))


def write_json(pace: Pace, event: str) -> None:
    """Write a line for programs now and then, and the last of each stage."""
    if event in ("tick", "end"):
        note_json(describe(pace))


def write_sign(pace: Pace, event: str) -> None:
    """Write a line into a log now and then, so that a long run is not taken for a dead one."""
    if event == "tick":
        note(line_of(pace, columns()))


class Teller:
    """Tells where a run is every so many seconds, from a thread of its own, so that long stages are seen to go on.

    Parameters
    ----------
    tell : callable
        Called with a `Pace` and "begin" (of a stage), "tick", "end" (of a stage), "done" or "stopped".
    every : float
        Between two ticks, s.
    """

    def __init__(self, tell: Callable[[Pace, str], None], every: float) -> None:
        self._tell, self._every, self._pace = tell, every, Pace()
        self._lock, self._end = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._tick, name="progress", daemon=True)

    def __call__(self, step: Step) -> None:
        """Take the next step."""
        with self._lock:
            last = self._pace.step
            is_new = last is None or last.stage != step.stage
            if is_new:
                self._end_stage()
            self._pace.note(step)
            if is_new:
                self._tell(self._pace, "begin")

    def __enter__(self) -> Teller:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self._end.set()
            self._thread.join()
        finally:
            if kind is None:
                self._end_stage()
            if self._pace.step is not None:
                self._tell(self._pace, "done" if kind is None else "stopped")

    def _end_stage(self) -> None:
        step = self._pace.step
        if step is not None:
            self._pace.note(replace(step, done=step.total))
            self._tell(self._pace, "end")

    def _tick(self) -> None:
        while not self._end.wait(self._every):
            with self._lock:
                if self._pace.step is not None:
                    self._tell(self._pace, "tick")


@contextlib.contextmanager
def progress(as_json: bool) -> Iterator[Teller]:
    """Show on stderr how far a run is.

    Parameters
    ----------
    as_json : bool
        Whether programs read stderr: all on it is lines of JSON then. Otherwise a line is renewed on a terminal, and
        elsewhere nothing is said but a line a minute.

    Yields
    ------
    callable
        To be called with each `Step`.
    """
    if as_json:
        tell, every = write_json, JSON
    else:
        tell, every = (show_line, TERMINAL) if is_renewable() else (write_sign, LOG)
    with remarks_as_json() if as_json else contextlib.nullcontext(), Teller(tell, every) as teller:
        yield teller
