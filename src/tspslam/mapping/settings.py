"""Settings of the map: which keyframes see what, how the surface is cut, which views count."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from .._checks import require
from .._settings import Checked, setting

Tangent = Literal["projection", "gradient"]


@dataclass(frozen=True)
class ObservationSettings(Checked, what="mapping.observe"):
    """How landmarks are looked for in the keyframes that did not track them.

    Parameters
    ----------
    neighbours : int
        Keyframes before, and after, in whose images a landmark's patch is taken from.
    misses : int
        Keyframes in a row that do not show a landmark, after which it is not followed on.
    revisits : int
        Keyframes of other passes near by that are looked at.
    reach : float
        Largest distance from where the landmark's place has it.
    min_correlation : float
        Of a patch that is found.
    radius : int
        Half width of a patch.
    same_place : float
        Largest distance of two observations of one landmark.
    same_disparity : float
        Largest difference of their disparities.
    sigma_uv : float
        Standard deviation of a place.
    sigma_disparity : float
        Standard deviation of a disparity.
    outlier : float
        Length of a residual from which an observation is dropped.
    min_agreement : float
        Least share of a keyframe's observations that are no outliers; one with fewer is somewhere else, and not used.
    max_sigma : float
        Largest standard deviation of a landmark in any direction; less certain ones are no vertices.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> ObservationSettings(misses=1).reach
    2.0
    """

    neighbours: int = setting(5, 1, 100, unit="keyframes", source="KITTI 05 2: 2899, 10: 2803 vertices (2804)")
    misses: int = setting(
        2,
        1,
        100,
        unit="keyframes",
        source="KITTI 05 1: 2654, 4: 2903 vertices (2804), the search at two thirds and 1.4 times the time",
    )
    revisits: int = setting(4, 0, 100, unit="keyframes", source="room 2: 7661, 8: 7671 vertices (7671)")
    reach: float = setting(
        2.0,
        0.1,
        20,
        unit="px",
        source="room 1: 7565, 4: 7701 vertices (7671); twice as far, chance finds four times as much",
    )
    min_correlation: float = setting(
        0.85,
        0,
        1,
        unit="",
        source="KITTI 05, shifted 12 px: 2 to 4 % of what is found in place; 0.9: 4104, 0.8: 4855 found in all",
    )
    radius: int = setting(4, 2, 20, unit="px", source="corridor 2: 7121, 8: 6685 vertices (7367)")
    same_place: float = setting(1.5, 0.1, 20, unit="px", source="room 0.75: 7704, 3: 7598 vertices (7671)")
    same_disparity: float = setting(1.0, 0.1, 20, unit="px", source="KITTI 05 0.5: 2820, 2: 2801 vertices (2804)")
    sigma_uv: float = setting(
        1.0, 0.01, 10, unit="px", source="as in tracking; room 0.5: 7674, 2: 7664 vertices (7671)"
    )
    sigma_disparity: float = setting(
        0.3, 0.01, 10, unit="px", source="as in tracking; room 0.15: 7773, 0.6: 5920 vertices (7671)"
    )
    outlier: float = setting(
        5.0, 1, 100, unit="sigmas", source="as in tracking; KITTI 05 2.5: 2777, 10: 2813 vertices (2804)"
    )
    min_agreement: float = setting(
        0.3, 0, 1, unit="", source="by hand: of seven recordings and worlds the least has 0.99"
    )
    max_sigma: float = setting(
        0.3, 0.001, 10, unit="m per m of depth", source="by hand; half, twice: two vertices more or less"
    )


@dataclass(frozen=True)
class SurfaceSettings(Checked, what="mapping.surface"):
    """How one surface is cut from the tetrahedra of the landmarks.

    Parameters
    ----------
    quality : float
        Weight of a triangle's shape against rays that cross it.
    behind : float
        How far behind a landmark it is full, in standard deviations of its depth.
    longest : float
        Longest side of a triangle, over its depth.
    longest_apart : float
        Longest side of a triangle that no keyframe sees whole, or only all too slanted: there the depth steps.
    max_slant : float
        Largest angle between the normal of a longer triangle and the way to a keyframe that sees it whole.
    seen_through : int
        Landmarks clearly behind a triangle, by the keyframes that see them, from which it goes.
    max_bytes : float
        Memory that the tetrahedra may take; maps of more landmarks are refused.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> SurfaceSettings(longest=0.3).behind
    1.0
    """

    quality: float = setting(0.25, 0, 100, unit="rays", source="KITTI 05 0.125: 2812, 0.5: 2771 vertices (2804)")
    behind: float = setting(1.0, 0, 100, unit="sigmas", source="room 0.5: 7775, 2: 5724 vertices (7671)")
    longest: float = setting(
        0.4,
        0.01,
        100,
        unit="m per m of depth",
        source="corridor covered 0.2: 73, 0.8: 94 % (91), faces off 0.19, 0.21 % (0.20)",
    )
    longest_apart: float = setting(
        0.2, 0, 100, unit="m per m of depth", source="corridor covered 0.1: 89.4, 0.4: 91.6 % (90.6)"
    )
    max_slant: float = setting(
        84.0,
        0,
        90,
        unit="degrees",
        source="corridor covered 42: 73.0, 90: 90.8 % (90.6); samples of faces before the truth 90: 9 % (6)",
    )
    max_bytes: float = setting(4e9, 1e6, 1e15, unit="bytes", source="12 kB a landmark, as measured: 330 000 of them")
    seen_through: int = setting(
        1,
        1,
        1000,
        unit="landmarks",
        source="nothing that a camera saw through; KITTI 05, rays that meet another face 1: 0.05, 2: 0.69 %",
    )


@dataclass(frozen=True)
class ViewSettings(Checked, what="mapping.views"):
    """Which keyframes count for an element's luminance and response.

    Parameters
    ----------
    max_angle : float
        Largest angle between an element's normal and the way to the camera.
    hidden : float
        How far behind a face a vertex is hidden, in standard deviations of its depth.
    min_shared : int
        Faces in common, from which two keyframes' exposures are compared.
    tangent : {"projection", "gradient"}
        Which tangent a phase becomes: the one that projects along it, or the one along which the luminance grows most
        if the phase is that of its gradient in the image.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> ViewSettings().max_angle
    75.0
    """

    max_angle: float = setting(
        75.0, 0, 90, unit="degrees", source="beyond it a pixel covers four times the length or more"
    )
    hidden: float = setting(
        3.0,
        0,
        100,
        unit="sigmas",
        source="three standard deviations; KITTI 05 1.5: 2794, 6: 2830 vertices (2804)",
    )
    min_shared: int = setting(20, 1, 10_000, unit="faces", source="half, twice: same maps")
    tangent: Tangent = setting(
        "projection", unit="", source="what stands in a plane may be seen from anywhere: docs/mapping tells them apart"
    )

    @property
    def least_cosine(self) -> float:
        """Cosine of `max_angle`."""
        return float(np.cos(np.radians(self.max_angle)))


@dataclass(frozen=True)
class MappingSettings(Checked, what="mapping"):
    """How keyframes and landmarks become one topological map.

    Parameters
    ----------
    observe : ObservationSettings
        How landmarks are looked for in further keyframes.
    surface : SurfaceSettings
        How the surface is cut.
    views : ViewSettings
        Which keyframes count for an element.
    fix_offset : bool
        Whether a run takes the offset of the disparities off its frames too, once the whole path has told it.

    Raises
    ------
    InputError
        If a parameter is of another kind.

    Examples
    --------
    >>> MappingSettings(surface=SurfaceSettings(longest=0.3)).views.hidden
    3.0
    """

    observe: ObservationSettings = field(default_factory=ObservationSettings)
    surface: SurfaceSettings = field(default_factory=SurfaceSettings)
    views: ViewSettings = field(default_factory=ViewSettings)
    fix_offset: bool = setting(False, unit="", source="a frame is what its pair and the calibration say; docs/path")

    def __post_init__(self) -> None:
        """Check the kinds."""
        super().__post_init__()
        kinds = {"observe": ObservationSettings, "surface": SurfaceSettings, "views": ViewSettings}
        for name, kind in kinds.items():
            require(getattr(self, name), kind, f"mapping: {name}")
