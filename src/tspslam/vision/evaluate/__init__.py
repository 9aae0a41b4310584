"""A camera path beside the true one: ATE, RPE over any length, KITTI's table, and the offset of two clocks."""

from .errors import Align, TrajectoryErrors, evaluate_trajectory
from .offset import Offset, find_offset
from .relative import DistanceErrors, KittiErrors, parse_delta

__all__ = [
    "Align",
    "DistanceErrors",
    "KittiErrors",
    "Offset",
    "TrajectoryErrors",
    "evaluate_trajectory",
    "find_offset",
    "parse_delta",
]
