"""Maps of any size are adjusted piece by piece: some keyframes at a time, held by their neighbours."""

from __future__ import annotations

from ....errors import GeometryError
from ....types import Rig
from ..keyframes.map import Map
from .adjustment_problem import choose_piece, collect_problem

PIECE = 30  # keyframes of a piece: 10 000 sights in a street, 50 ms, less than the two frames that they have
_LARGE_PIECE = 60  # keyframes, where nobody waits
_ENOUGH = 1e-3  # relative decrease of the cost in a sweep below which no other follows
_MAX_SWEEPS = 5  # by hand: the third left less than _ENOUGH in all that were tried


def sweep_map(map_: Map, sigma_uv: float, rig: Rig, offset: float) -> int:
    """Adjust all keyframes but the first, one piece after another, until a sweep changes little; the cost never rises.

    Borders of the pieces of a sweep are within those of the next.

    Parameters
    ----------
    map_ : Map
        Changed.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    rig : Rig
        The cameras as calibrated.
    offset : float
        Offset of the disparities, which stays, px.

    Returns
    -------
    int
        Pieces that had no solution.
    """
    unsolved = 0
    for sweep in range(_MAX_SWEEPS):
        waiting = {frame.index for frame in map_.keyframes[1:]}
        before = after = 0.0
        size = _LARGE_PIECE if sweep % 2 == 0 else _LARGE_PIECE // 2
        while waiting:
            piece = choose_piece(map_, waiting, size, last=0)
            size = _LARGE_PIECE
            waiting -= {map_.keyframes[k].index for k in piece}
            costs = _adjust_piece(map_, piece, sigma_uv, rig, offset)
            unsolved += costs is None
            before, after = (total + cost for total, cost in zip((before, after), costs or (0.0, 0.0), strict=True))
        if before - after <= _ENOUGH * before:
            break
    return unsolved


def _adjust_piece(
    map_: Map, piece: list[int], sigma_uv: float, rig: Rig, offset: float
) -> tuple[float, float] | None:  # fmt: skip
    """Adjust one piece; its costs before and after, None if it has no solution."""
    problem = collect_problem(map_, piece, sigma_uv)
    if problem is None:
        return 0.0, 0.0
    try:
        found = problem.solve(rig, offset, None, map_.settings.max_steps)
    except GeometryError:
        return None
    problem.apply(map_, found)
    return found.cost_before, found.cost
