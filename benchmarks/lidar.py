"""Scans of 120 000 points to complex, signals and response, and to one map, beside a Delaunay triangulation."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

import tspslam
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.scanner import AXES
from tspslam.interop.meshes import from_arrays
from tspslam.mapping.scans import PlacedScan, join_scans
from tspslam.run.scans import VOXEL
from tspslam.types import FloatArray

from .measure import paired

Figures = dict[str, float]
RIG = tspslam.Rig(fx=707.09, fy=707.09, cx=601.9, cy=183.1, baseline=0.537, width=1226, height=370)


PLACES = (5, 8, 11)  # frames with a scan
T_CAMERA_SCAN = AXES.copy()
T_CAMERA_SCAN[:3, 3] = 0, -0.08, -0.27  # as KITTI's


def scan_figures() -> Figures:
    """The surface, the walk of one scan, and the last of three scans of a run, each in turn with the triangulation."""
    scene = synthetic.street(60.0)
    poses = [scene.path[k] @ T_CAMERA_SCAN for k in PLACES]
    scans = [synthetic.scan(scene, pose, synthetic.Scanner(noise=0.02)).xyz for pose in poses]
    image = synthetic.SyntheticSequence(scene, RIG)[PLACES[0]].left
    xyz = scans[0]
    image_of_range = np.column_stack(
        [np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1))]
    )
    points = xyz @ T_CAMERA_SCAN[:3, :3].T + T_CAMERA_SCAN[:3, 3]

    def walk() -> tspslam.Response:
        faces = tspslam.scan_surface(xyz).faces
        return from_arrays(points, faces, image, RIG).response

    def triangulate() -> Delaunay:
        return Delaunay(image_of_range)

    placed = [placed_scan(*each) for each in zip(scans, poses, strict=True)]

    def merge_all() -> PlacedScan:
        return join_scans([placed_scan(*each) for each in zip(scans, poses, strict=True)], VOXEL)

    surface, triangulation, ratio = paired(lambda: tspslam.scan_surface(xyz), triangulate, rounds=5)
    walk_s, _, walk_ratio = paired(walk, triangulate, rounds=5)
    merged_s, _, merged_ratio = paired(merge_all, triangulate, rounds=5)
    return {
        "points": float(len(xyz)),
        "surface_s": surface,
        "delaunay_s": triangulation,
        "ratio": ratio,
        "walk_s": walk_s,
        "walk_ratio": walk_ratio,
        "scans": float(len(scans)),
        "merged_points": float(len(join_scans(placed, VOXEL).xyz)),
        "merge_s_a_scan": merged_s / len(scans),
        "merge_ratio_a_scan": merged_ratio / len(scans),
    }


def placed_scan(xyz: FloatArray, T_world_scan: FloatArray) -> PlacedScan:
    """A scan with its own surface, in the world."""
    return PlacedScan(xyz @ T_world_scan[:3, :3].T + T_world_scan[:3, 3], tspslam.scan_surface(xyz).faces)


if __name__ == "__main__":
    for name, value in scan_figures().items():
        print(f"{name:<12} {value:.4g}")
