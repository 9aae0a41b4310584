"""How a camera is tracked: settings of the odometry."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..._checks import require
from ..._settings import Checked, setting
from .keyframes.settings import MapSettings
from .places.settings import LoopSettings
from .tracking import TrackingSettings


@dataclass(frozen=True)
class Tracking(Checked, what="tracking"):
    """How a camera is tracked.

    Parameters
    ----------
    window : int
        Keyframes that are adjusted together.
    keyframe_share : float
        Share of the last keyframe's landmarks; a frame that tracks fewer becomes a keyframe.
    patience : int
        Frames lost in a row, but for those that show nothing, after which the map begins anew, at the pose that a
        constant velocity predicts.
    sigma_disparity : float
        Standard deviation of a disparity, where the pair does not tell it.
    sigma_offset : float
        Standard deviation of the calibration's disparity offset.
    every_frame : bool
        Whether points to response are computed ahead and stored for each frame, not only for keyframes.
    pose : TrackingSettings
        How landmarks are tracked into an image, and when a pose is believed.
    map : MapSettings
        What the map keeps, and what is adjusted.
    loops : LoopSettings
        How places seen before are found.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> Tracking(window=5).keyframe_share
    0.5
    """

    window: int = setting(7, 2, 50, unit="keyframes", source="by hand; KITTI 05 4: 41, 14: 45 mm (38)")
    keyframe_share: float = setting(0.5, 0, 1, unit="", source="by hand; KITTI 05 0.25: 110, 1: 31 mm (38)")
    patience: int = setting(3, 1, 1000, unit="frames", source="by hand; half, twice: same paths")
    sigma_disparity: float = setting(0.3, 0.01, 10, unit="px", source="by hand; KITTI 05 0.15: 43, 0.6: 47 mm (38)")
    sigma_offset: float = setting(
        0.3, 0.001, 10, unit="px", source="KITTI's, with care, have up to 0.4; KITTI 05 0.15: 43, 0.6: 36 mm (38)"
    )
    every_frame: bool = setting(False, unit="", source="keyframes are what the map rests on")
    pose: TrackingSettings = field(default_factory=TrackingSettings)
    map: MapSettings = field(default_factory=MapSettings)
    loops: LoopSettings = field(default_factory=LoopSettings)

    def __post_init__(self) -> None:
        """Check the ranges."""
        super().__post_init__()
        for name, kind in (("pose", TrackingSettings), ("map", MapSettings), ("loops", LoopSettings)):
            require(getattr(self, name), kind, f"tracking: {name}")
