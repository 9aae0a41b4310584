"""Options for where work goes on, which the commands on Dask share."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..scale.cluster import Workers

SchedulerOption = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="A Dask scheduler that is there, such as tcp://host:8786.")
]
MemoryOption = Annotated[
    str | None, typer.Option(metavar="SIZE", help="For each process, such as 4GB [default: an equal share].")
]
_UNITS = {"": 1, "MB": 10**6, "GB": 10**9, "MIB": 1 << 20, "GIB": 1 << 30}


def find_workers(count: int | None, scheduler: str | None, threads: int | None, memory: str | None) -> Workers:
    """Tell where work goes on.

    Parameters
    ----------
    count : int or None
        Processes on this machine.
    scheduler : str or None
        Address of one that is there.
    threads : int or None
        Of all processes on this machine together, or of each worker of the scheduler.
    memory : str or None
        For each process, as people write it.

    Returns
    -------
    Workers
    """
    from ..scale.cluster import Workers

    if scheduler is not None and (count, memory) != (None, None):
        raise typer.BadParameter(
            "a scheduler has workers of its own: no --workers, no --memory", param_hint="--scheduler"
        )
    return Workers(count, scheduler, threads, _bytes(memory))


def _bytes(text: str | None) -> int | None:
    """A size in bytes, as people write it."""
    from ..scale.cluster import LEAST_MEMORY

    if text is None:
        return None
    found = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]{1,9})?) ?([A-Z]*)", text.strip().upper(), re.ASCII)
    size = int(float(found[1]) * _UNITS[found[2]]) if found and found[2] in _UNITS else 0
    if size < LEAST_MEMORY:
        least = f"{LEAST_MEMORY / (1 << 20):.0f}MiB"
        raise typer.BadParameter(f"{text!r}, expected a size of {least} or more, such as 4GB", param_hint="--memory")
    return size
