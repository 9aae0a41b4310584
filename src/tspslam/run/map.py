"""Frames of one path laid into one world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace

import numpy as np

from ..frame import Frame
from ..topology.complex import build_complex
from ..types import Cloud, FloatArray, Response, Signals, Surface


def merge_frames(frames: Iterable[Frame], T_world_camera: FloatArray) -> Frame:
    """One frame of all the vertices, edges and faces of several: a disjoint union, in the world's axes.

    Parameters
    ----------
    frames : iterable of Frame
        At least one, read from files; index, stamp, name and rig are those of the first.
    T_world_camera : (K, 4, 4) float64
        Their poses.

    Returns
    -------
    Frame
        Its edges and faces stand in the order of the frames.
    """
    parts = [_moved(frame, T) for frame, T in zip(frames, T_world_camera, strict=True)]
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.cloud) for part in parts)])
    faces = np.concatenate([part.surface.faces + start for part, start in zip(parts, starts, strict=False)])
    complex_ = build_complex(faces.astype(np.int32), int(starts[-1]))
    columns = {
        each.name: np.concatenate([getattr(part.signals, each.name) for part in parts]) for each in fields(Signals)
    }
    response = Response(
        np.concatenate([part.response.z for part in parts]),
        parts[0].response.order,
        np.concatenate([part.response.defined for part in parts]),
    )
    first, cloud = parts[0], _joined([part.cloud for part in parts])
    known = [part.landmark for part in parts if part.landmark is not None]
    return Frame(
        first.index, first.stamp, first.name, first.rig, cloud, Surface(faces.astype(np.int32)), complex_,
        Signals(**columns), response, landmark=np.concatenate(known) if len(known) == len(parts) else None,
    )  # fmt: skip


def _moved(frame: Frame, T: FloatArray) -> Frame:
    """A frame whose points are in the world."""
    cloud, R = frame.cloud, T[:3, :3]
    covariance = None if cloud.covariance is None else R @ cloud.covariance @ R.T
    moved = replace(cloud, xyz=cloud.xyz @ R.T + T[:3, 3], covariance=covariance)
    return replace(frame, cloud=moved, T_world_camera=np.eye(4))


def _joined(clouds: list[Cloud]) -> Cloud:
    covariances = [cloud.covariance for cloud in clouds if cloud.covariance is not None]
    return Cloud(
        np.concatenate([cloud.xyz for cloud in clouds]),
        np.concatenate([cloud.uv for cloud in clouds]),
        np.concatenate([cloud.disparity for cloud in clouds]),
        np.concatenate(covariances) if len(covariances) == len(clouds) else None,
    )
