"""The offset that the path found of all disparities, taken off the frames of a run once it is known."""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..frame import Frame, Once
from ..io import read_frame
from ..settings import Settings
from ..topology.complex import build_complex
from ..topology.texture import sample_signals
from ..types import BoolArray, Cloud, FloatArray, Rig
from ..vision.slam.odometry import StereoOdometry
from ..vision.stereo.reconstruct import StereoQuality
from .record import ComplexRecord
from .sequence import SequenceRun


def fix_offset(sequence: SequenceRun) -> None:
    """Triangulate the stored frames of a finished path anew, with the cameras that the path settled on.

    A frame that has them already stays as it is, so that a run that was stopped here goes on.

    Parameters
    ----------
    sequence : SequenceRun
        Its frames are written anew, and its checkpoint.
    """
    odometry = sequence.session.odometry
    if not isinstance(odometry, StereoOdometry):
        return
    rig, settings = odometry.map.rig, sequence.session.settings
    for row in sequence.stored:
        frame = read_frame(sequence.folder.frame_path(row.index))
        if frame.rig != rig and row.complex_ is not None:
            sequence.rewrite(refit_frame(frame, rig, settings, _quality(row.complex_)))
    sequence.save_rows()


def refit_frame(frame: Frame, rig: Rig, settings: Settings, quality: StereoQuality | None = None) -> Frame:
    """Make a frame anew from its points for cameras of another offset of the disparities.

    Parameters
    ----------
    frame : Frame
        With its image.
    rig : Rig
        Cameras that differ in `doffs` alone.
    settings : Settings
        The stages.
    quality : StereoQuality, optional
        How well the images matched.

    Returns
    -------
    Frame
        Without the points that are then not in front of the cameras; its parts are computed when they are asked for.

    Raises
    ------
    InputError
        If it has no image.
    """
    if frame.image is None:
        raise InputError(f"{frame.name}: has no image, expected one to sample signals from")
    kept = frame.cloud.disparity + rig.doffs > 0
    cloud = move_points(_kept(frame.cloud, kept), frame.rig, rig)
    image, valid = frame.image, frame.valid
    surface = Once(lambda: settings.surface(cloud))
    complex_ = Once(lambda: build_complex(surface().faces, len(cloud)))
    signals = Once(lambda: sample_signals(image, cloud.uv, complex_(), valid=valid))
    response = Once(lambda: settings.filter(complex_(), cloud.uv, signals()))
    return Frame(
        frame.index, frame.stamp, frame.name, rig, cloud, surface, complex_, signals, response,
        image=image, T_world_camera=frame.T_world_camera, is_keyframe=frame.is_keyframe, is_lost=frame.is_lost,
        valid=valid, quality=quality,
        landmark=None if frame.landmark is None else frame.landmark[kept],
    )  # fmt: skip


def move_points(cloud: Cloud, before: Rig, after: Rig) -> Cloud:
    """Move points to where cameras of another offset of the disparities see them.

    Depth is z = fx B / (disparity + doffs), so a point moves along its ray by the factor q, the ratio of both sums, and
    its covariance by the derivative of that.

    Parameters
    ----------
    cloud : Cloud
        N points of the cameras `before`, with disparity + doffs > 0 for both.
    before, after : Rig
        They differ in `doffs` alone.

    Returns
    -------
    Cloud

    Examples
    --------
    >>> from dataclasses import replace
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> cloud = Cloud(np.array([[0, 0, 5.0]]), np.array([[320.0, 240]]), np.array([10.0]))
    >>> move_points(cloud, rig, replace(rig, doffs=2.5)).xyz
    array([[0., 0., 4.]])
    """
    q = (cloud.disparity + before.doffs) / (cloud.disparity + after.doffs)
    xyz = cloud.xyz * q[:, None]
    covariance = None if cloud.covariance is None else _moved(cloud.covariance, cloud.xyz, q)
    return Cloud(xyz, cloud.uv, cloud.disparity, covariance)


def _moved(covariance: FloatArray, xyz: FloatArray, q: FloatArray) -> FloatArray:
    """Covariances of points after q(z) (x, y, z); along a ray dq/dz = -q (1 - q) / z."""
    A = q[:, None, None] * np.eye(3)
    A[:, :, 2] -= (q * (1 - q) / xyz[:, 2])[:, None] * xyz
    return np.asarray(A @ covariance @ A.transpose(0, 2, 1))


def _kept(cloud: Cloud, kept: BoolArray) -> Cloud:
    covariance = None if cloud.covariance is None else cloud.covariance[kept]
    return Cloud(cloud.xyz[kept], cloud.uv[kept], cloud.disparity[kept], covariance)


def _quality(row: ComplexRecord) -> StereoQuality:
    """What a frame's row says of how its images matched."""
    names = StereoQuality.__dataclass_fields__
    return StereoQuality(**{name: getattr(row, name) for name in names})
