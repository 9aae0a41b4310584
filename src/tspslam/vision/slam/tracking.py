"""The pose of a camera near a guess: patches of landmarks tracked into its image, and what is believed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..._settings import Checked, setting
from ...types import FloatArray, Rig
from ..images import PreparedPair, Pyramid, are_usable
from ..stereo.dense import checked_map, sample_map, sample_sigma
from ..stereo.matches import uv_right
from ..stereo.row_matcher import Planes, SearchNear, level_rows
from .patch_tracking import Patch, Sought, aim_patches, track_sought
from .pose import PoseEstimate, fit_robustly

_Stage = tuple[range, float, tuple[float, ...], int]  # levels, spread of a point in px, gates, points

_COARSEST = 3  # level of the pyramid
_DRIVES = "right poses on KITTI and EuRoC have 0.35 to 0.6 at camera rate, wrong ones near the guess up to 0.1"


@dataclass(frozen=True)
class TrackingSettings(Checked, what="tracking.pose"):
    """How landmarks are tracked into an image, and when a pose is believed.

    Parameters
    ----------
    patch_radius : int
        Half width of a patch, px.
    patch_contrast : float
        A pixel that differs from the centre by ``1 / contrast`` grey levels counts half.
    patch_reach : float
        Farthest that a patch moves at each level of the pyramid, px.
    min_correlation : float
        Least correlation of a patch that counts as found.
    sigma_uv : float
        Standard deviation of a tracked point, px.
    rough_sigma_uv : float
        The same at the coarse levels, px.
    rough_points : int
        Points tracked at the coarse levels, about.
    rough_gate : float
        Error beyond which an observation is dropped at the coarse levels.
    first_gate : float
        The same at the full size, in the first round of two.
    last_gate : float
        The same in the second round.
    min_matches : int
        Landmarks that a pose needs.
    min_agreement : float
        Least share of the tracked points that agree on a pose.
    max_zoom : float
        Largest ratio of a landmark's distances from the camera and from the keyframe, either way.
    min_depth : float
        Least depth of a landmark that is looked for.
    clear_share : float
        Share of the landmarks in view that agree with a pose, from which it needs no second opinion.
    steady_share : float
        The same share where the pose is that of a constant velocity, as behind an object that fills half of the view.
    lone_share : float
        Share that a tracked pose needs where relocalisation finds none.
    relocalized_share : float
        Share that a relocalised pose needs, or a tracked one that it confirms.
    overrule : float
        Ratio of landmarks, relocalised to tracked, from which the relocalised pose is taken.
    same_pose : float
        Largest distance of two poses that count as the same.

    Raises
    ------
    InputError
        If a parameter is out of its range.

    Examples
    --------
    >>> TrackingSettings(min_matches=30).clear_share
    0.25
    """

    patch_radius: int = setting(5, 1, 15, unit="px", source="by hand; KITTI 05 2: 55, 10: 44 mm (38)")
    patch_contrast: float = setting(
        0.03, 0, 10, unit="per grey level", source="by hand; KITTI 05 0.015: 39, 0.06: 34 mm (38)"
    )
    patch_reach: float = setting(4.0, 0.5, 50, unit="px", source="by hand; KITTI 05 2: 36, 8: 67 mm (38)")
    min_correlation: float = setting(
        0.8, 0, 0.999, unit="", source="by hand; KITTI 05 0.4: 37, 0.999: 6618 (59 lost) mm (38)"
    )
    sigma_uv: float = setting(0.3, 0.01, 10, unit="px", source="by hand; KITTI 05 0.15: 33, 0.6: 58 mm (38)")
    rough_sigma_uv: float = setting(2.0, 0.01, 50, unit="px", source="by hand; KITTI 05 1: 41, 4: 39 mm (38)")
    rough_points: int = setting(300, 15, 1_000_000, unit="points", source="by hand; KITTI 05 150: 37, 600: 38 mm (38)")
    rough_gate: float = setting(5.0, 1, 100, unit="sigmas", source="by hand; half, twice: same paths")
    first_gate: float = setting(6.0, 1, 100, unit="sigmas", source="by hand; KITTI 05 3: 39, 12: 40 mm (38)")
    last_gate: float = setting(
        3.5,
        1,
        100,
        unit="sigmas",
        source="drops 2 in 1 000 inliers; KITTI 05 1.75: 30, 7: 55 mm (38)",
    )
    min_matches: int = setting(15, 4, 10_000, unit="landmarks", source="by hand; half, twice: same paths")
    min_agreement: float = setting(0.3, 0, 1, unit="", source="by hand; KITTI 05 0.15: 38, 0.6: 98 (4 lost) mm (38)")
    max_zoom: float = setting(2.5, 1, 100, unit="times", source="by hand; KITTI 05 1.25: 41, 5: 36 mm (38)")
    min_depth: float = setting(0.1, 1e-3, 1e3, unit="m", source="by hand; half, twice: same paths")
    clear_share: float = setting(0.25, 0, 1, unit="", source=f"{_DRIVES}; 0.27 and more at 5 m a frame")
    steady_share: float = setting(0.05, 0, 1, unit="", source="a synthetic object over a third of the view")
    lone_share: float = setting(0.12, 0, 1, unit="", source=_DRIVES)
    relocalized_share: float = setting(0.1, 0, 1, unit="", source=f"{_DRIVES}; 0.1 and more seconds apart")
    overrule: float = setting(3.0, 1, 100, unit="times", source="right poses had 4 times and more those of wrong ones")
    same_pose: float = setting(0.02, 0, 1, unit="m per m of depth", source="by hand; half, twice: same paths")

    @property
    def patch(self) -> Patch:
        """What a patch is."""
        return Patch(self.patch_radius, self.patch_contrast, self.patch_reach, self.min_correlation)

    def reach(self, image: Pyramid) -> float:
        """Tell how far from where it is expected a landmark is found at the coarsest level that is looked at.

        Parameters
        ----------
        image : Pyramid
            The image; a small one has fewer levels.

        Returns
        -------
        float
            px of the full size.
        """
        return self.patch_reach * 2 ** min(_COARSEST, len(image.levels) - 1)


@dataclass(frozen=True)
class Reference:
    """A keyframe's image, and the landmarks that it was the last to see.

    Attributes
    ----------
    image : Pyramid
        The left image.
    T_world_camera : (4, 4) float64
        Its pose.
    uv : (K, 2) float64
        Where it sees them, px.
    landmark : (K,) int64
        Their rows in the map.
    """

    image: Pyramid
    T_world_camera: FloatArray
    uv: FloatArray
    landmark: NDArray[np.int64]


def track_pose(
    rig: Rig, image: Pyramid, references: Sequence[Reference], xyz: FloatArray, T_guess: FloatArray,
    settings: TrackingSettings,
) -> PoseEstimate | None:  # fmt: skip
    """Find a camera's pose near a guess, from bearings; None where too few landmarks agree on one.

    Parameters
    ----------
    rig : Rig
        The camera.
    image : Pyramid
        What it shows.
    references : sequence of Reference
        Where the landmarks were seen before.
    xyz : (M, 3) float64
        All landmarks, m.
    T_guess : (4, 4) float64
        ``T_world_camera`` to start from.
    settings : TrackingSettings
        Patches and gates.

    Returns
    -------
    PoseEstimate or None
        Without disparities.
    """
    rough = range(_COARSEST, 0, -1), settings.rough_sigma_uv, (settings.rough_gate,), settings.rough_points
    fine = range(0, -1, -1), settings.sigma_uv, (settings.first_gate, settings.last_gate), max(1, len(xyz))
    return _track_stages(rig, image, references, xyz, T_guess, (rough, fine), settings)


def track_closely(
    rig: Rig, image: Pyramid, references: Sequence[Reference], xyz: FloatArray, T_guess: FloatArray,
    settings: TrackingSettings,
) -> PoseEstimate | None:  # fmt: skip
    """`track_pose` for a guess that is right to a few pixels: what moves otherwise is not within reach.

    Parameters, returns: as `track_pose`.
    """
    fine = range(1, -1, -1), settings.sigma_uv, (settings.first_gate, settings.last_gate), max(1, len(xyz))
    return _track_stages(rig, image, references, xyz, T_guess, (fine,), settings)


def _track_stages(
    rig: Rig, image: Pyramid, references: Sequence[Reference], xyz: FloatArray, T: FloatArray,
    stages: tuple[_Stage, ...], settings: TrackingSettings,
) -> PoseEstimate | None:  # fmt: skip
    """Track landmarks, and fit the pose, at finer and finer levels of the pyramid; None where few agree at one."""
    estimate = None
    for levels, sigma, gates, most in stages:
        tracked = _track(rig, image, references, xyz, T, levels, most, settings)
        estimate = fit_robustly(rig, xyz, tracked, (sigma, 1.0), gates, settings.min_matches)
        if estimate is None or len(estimate) < settings.min_agreement * len(tracked):
            return None
        T = estimate.T_world_camera
    return estimate


def measure_disparities(
    rig: Rig, images: PreparedPair, estimate: PoseEstimate, xyz: FloatArray, search: SearchNear, row_offset: float
) -> FloatArray:
    """Measure the disparities of landmarks near where a pose has them.

    Parameters
    ----------
    rig : Rig
        The cameras, with the offset of the disparities in their `doffs`.
    images : PreparedPair
        What they show.
    estimate : PoseEstimate
        The pose, and K landmarks.
    xyz : (M, 3) float64
        All landmarks, m.
    search : callable
        How (`search_near`).
    row_offset : float
        Rows of the right image less those of the left, px.

    Returns
    -------
    (K,) float64
        px; NaN where there is none.
    """
    if images.disparity is not None:
        return sample_map(checked_map("disparity", images.disparity, rig), estimate.uv)
    T = estimate.T_world_camera
    depth = (xyz[estimate.landmark] - T[:3, 3]) @ T[:3, 2]
    guess = rig.fx * rig.baseline / depth - rig.doffs
    found = search(level_planes(images, row_offset), estimate.uv, guess)
    return np.where(are_usable(images.usable, uv_right(estimate.uv, found)), found, np.nan)


def level_planes(images: PreparedPair, row_offset: float) -> Planes:
    """Make the smoothed planes of a pair whose rows agree, once for the same offset.

    Parameters
    ----------
    images : PreparedPair
        What the cameras show.
    row_offset : float
        Rows of the right image less those of the left, px.

    Returns
    -------
    (left, right), each (H, W) float32
    """
    planes = images.left_image.smooth, images.right_image.smooth
    return images.levelled.of(row_offset, lambda: level_rows(planes, row_offset))


def spread_of(sigma: FloatArray | None, uv: FloatArray, otherwise: float) -> FloatArray:
    """Standard deviations of the disparities at places of the left image.

    Parameters
    ----------
    sigma : (H, W) float or None
        Those of a pair's pixels, if it tells them, px.
    uv : (K, 2) float64
        Places inside the image, px.
    otherwise : float
        What it is where the pair does not tell, px.

    Returns
    -------
    (K,) float64
        px.
    """
    return np.full(len(uv), otherwise) if sigma is None else sample_sigma(sigma, uv, otherwise)


def refine_pose(
    rig: Rig, estimate: PoseEstimate, xyz: FloatArray, disparity: FloatArray, sigma_disparity: float | FloatArray,
    settings: TrackingSettings,
) -> PoseEstimate:  # fmt: skip
    """Refine a pose by disparities of its landmarks; it stays as it is if too few agree.

    Parameters
    ----------
    rig : Rig
        The cameras, with the offset of the disparities in their `doffs`.
    estimate : PoseEstimate
        The pose from bearings, K landmarks.
    xyz : (M, 3) float64
        All landmarks, m.
    disparity : (K,) float64
        As measured, px; NaN where not known.
    sigma_disparity : float or (K,) float64
        Standard deviation of a disparity, px.
    settings : TrackingSettings
        Gates.

    Returns
    -------
    PoseEstimate
        With these disparities.
    """
    measured = replace(estimate, disparity=disparity)
    sigma, gates = (settings.sigma_uv, sigma_disparity), (settings.first_gate, settings.last_gate)
    refined = fit_robustly(rig, xyz, measured, sigma, gates, settings.min_matches)
    return estimate if refined is None else replace(refined, rival=estimate.rival)


def _track(
    rig: Rig, image: Pyramid, references: Sequence[Reference], xyz: FloatArray, T: FloatArray, levels: range, most: int,
    settings: TrackingSettings,
) -> PoseEstimate:  # fmt: skip
    """Where about `most` of the landmarks that should be seen from a pose are found in the image."""
    aimed = [_aim(rig, image, reference, xyz, T, settings) for reference in references]
    in_view = sum(len(rows) for rows, _, _ in aimed)
    step = max(1, -(-in_view // most))
    known, landmarks = [], []
    for reference, (rows, warp, guess) in zip(references, aimed, strict=True):
        some = rows[::step]
        known.append(Sought(reference.image, reference.uv[some], warp[some], guess[some]))
        landmarks.append(reference.landmark[some])
    found = track_sought(known, image, levels, settings.patch)
    uv, good = (np.concatenate(parts) for parts in zip(*found, strict=True))
    landmark = np.concatenate(landmarks)
    good &= are_usable(image.usable, uv)
    uv, landmark = uv[good], landmark[good]
    return PoseEstimate(T, landmark, uv, np.full(len(uv), np.nan), np.full((6, 6), np.inf), in_view, len(uv))


def _aim(
    rig: Rig, image: Pyramid, reference: Reference, xyz: FloatArray, T: FloatArray, settings: TrackingSettings
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Rows of a reference's landmarks that a camera at T has in view; warps and guesses of all of them."""
    warp, guess, in_view = aim_patches(
        rig, xyz, reference.landmark, reference.T_world_camera, T, min_depth=settings.min_depth,
        max_zoom=settings.max_zoom,
    )  # fmt: skip
    rows = np.flatnonzero(in_view)
    if image.usable is not None:
        rows = rows[are_usable(image.usable, guess[rows])]
    return rows, warp, guess
