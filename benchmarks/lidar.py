"""A scan of 120 000 points to complex, signals and response, beside a Delaunay triangulation of its range image."""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

import tspslam
from tspslam.datasets import synthetic
from tspslam.datasets.synthetic.scanner import AXES
from tspslam.interop.meshes import from_arrays

from .measure import median_seconds, paired

Figures = dict[str, float]
RIG = tspslam.Rig(fx=707.09, fy=707.09, cx=601.9, cy=183.1, baseline=0.537, width=1226, height=370)


def scan_figures() -> Figures:
    """The surface against scipy's triangulation of the same range image, in turn; and the whole walk."""
    scene = synthetic.street(60.0)
    T_camera_scan = AXES.copy()
    T_camera_scan[:3, 3] = 0, -0.08, -0.27  # as KITTI's
    echoes = synthetic.scan(scene, scene.path[5] @ T_camera_scan, synthetic.Scanner(noise=0.02))
    image = synthetic.SyntheticSequence(scene, RIG)[5].left
    xyz = echoes.xyz
    image_of_range = np.column_stack(
        [np.arctan2(xyz[:, 1], xyz[:, 0]), np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1))]
    )
    points = xyz @ T_camera_scan[:3, :3].T + T_camera_scan[:3, 3]

    def walk() -> tspslam.Response:
        faces = tspslam.scan_surface(xyz).faces
        return from_arrays(points, faces, image, RIG).response

    surface, triangulation, ratio = paired(
        lambda: tspslam.scan_surface(xyz), lambda: Delaunay(image_of_range), rounds=5
    )
    return {
        "points": float(len(xyz)),
        "surface_s": surface,
        "delaunay_s": triangulation,
        "ratio": ratio,
        "walk_s": median_seconds(walk, 5),
    }


if __name__ == "__main__":
    for name, value in scan_figures().items():
        print(f"{name:<12} {value:.4g}")
