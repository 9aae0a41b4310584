"""Whether the loops that a run takes longest to compile are on disk."""

from __future__ import annotations

from .._jit import is_cached
from ..mapping._carving import carve
from ..topology._harmonics import filter_one_ring
from ..vision.slam._patch_tracking import track_level


def are_compiled(*, is_sequence: bool) -> bool:
    """Tell whether an earlier process left them: of a sequence those of its path and map too."""
    wanted = [filter_one_ring, track_level, carve] if is_sequence else [filter_one_ring]
    return all(is_cached(each) for each in wanted)
