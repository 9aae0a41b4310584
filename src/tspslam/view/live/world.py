"""What the viewer is told of a run: where the cameras are, the map once there is one, and what cannot be shown."""

from __future__ import annotations

from dataclasses import dataclass

from ..._brief import Brief
from ...topological_map import TopologicalMap
from .._report_parts import State as State
from .._space import Station as Station


@dataclass(frozen=True, repr=False)
class World(Brief):
    """A run as it is now.

    Attributes
    ----------
    name : str
        What to call it.
    said : str
        How far it is, in words.
    is_live : bool
        Whether it goes on.
    stations : tuple of Station
        Frames with a pose, by number.
    stored : tuple of int
        Numbers of the frames that can be asked for, ascending.
    map_ : TopologicalMap or None
        Its map, once there is one of two keyframes or more.
    loops : tuple of (int, int)
        Frames between which a loop was closed.
    missing : tuple of str
        What cannot be shown, and why.
    """

    name: str
    said: str
    is_live: bool
    stations: tuple[Station, ...] = ()
    stored: tuple[int, ...] = ()
    map_: TopologicalMap | None = None
    loops: tuple[tuple[int, int], ...] = ()
    missing: tuple[str, ...] = ()
