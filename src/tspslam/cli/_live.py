"""A camera as a source: opened, and ended by ctrl-C."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..printing import note
from ._shared import check_folder

if TYPE_CHECKING:
    from ..datasets import LiveSequence


def open_cameras(
    cameras: list[str], layout: str | None, calib: Path | None, out: Path | None, others: dict[str, Any]
) -> LiveSequence:
    """Open cameras and the folder that they are recorded to, beside the run folder."""
    from .._files import bad_input
    from ..datasets import LiveSequence

    for option, value in others.items():
        if value:
            raise typer.BadParameter("does not go with --camera", param_hint=option)
    if calib is None:
        raise typer.BadParameter("a camera needs a calibration file", param_hint="--calib")
    if len(cameras) > 2 or (layout is None and len(cameras) == 1):
        wanted = "one with --layout side-by-side or over-under, or two"
        raise typer.BadParameter(f"{len(cameras)} given, expected {wanted}", param_hint="--camera")
    target = out or Path("runs") / f"camera-{'-'.join(Path(each).name for each in cameras)}"
    recording = target.with_name(f"{target.name}-recording")
    check_folder(target, calib)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise bad_input(target, "is there already", "a new folder for the run of a camera")
    source = LiveSequence(cameras, layout, calib=calib, recording=recording)
    note(f"recording into {recording}; ctrl-C ends it")
    return source


@contextlib.contextmanager
def until_interrupt(source: object) -> Iterator[None]:
    """Let the first ctrl-C end a live source, so that the run ends with all that it has; a second one interrupts."""
    if not hasattr(source, "wait_for"):
        yield
        return

    def stop(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        source.stop()  # type: ignore[attr-defined]
        note("no more images are taken; ctrl-C again interrupts")

    before = signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        source.close()  # type: ignore[attr-defined]
