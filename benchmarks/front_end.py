"""Quality of clouds and surfaces against truth, where there is any; the table of the documentation."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml

import tspslam
from tspslam import StereoPair
from tspslam.io import read_image
from tspslam.topology.surface import DelaunaySurface
from tspslam.vision.features.orb import OrbDetector
from tspslam.vision.features.sift_brisk import BriskDetector, SiftDetector
from tspslam.vision.images import grey_levels, smooth_plane
from tspslam.vision.stereo.patches import Patches, search
from tspslam.vision.stereo.reconstruct import reconstruct_with_quality
from tspslam.vision.stereo.sgbm import SgbmMatcher

from .measure import median_seconds

Figures = dict[str, float]

TABLE = Path(__file__).parents[1] / "docs" / "cloud_quality.csv"
DATA = Path(os.environ.get("TSPSLAM_DATA", Path(__file__).parents[2] / "shared" / "data"))
DETECTORS = {"ORB": OrbDetector(), "SIFT": SiftDetector(), "BRISK": BriskDetector()}
COLUMNS = (
    "pair,detector,keypoints,points,within 1 px,back search agrees,block matching agrees,cells covered,ms,"
    "OpenCV's ORB alone ms"
)


def pairs() -> Iterator[tuple[str, StereoPair]]:
    """Motorcycle, and what the data folder has: indoor pairs, and the first pair of each sequence."""
    yield "Motorcycle", tspslam.datasets.motorcycle()
    for left in sorted((DATA / "oakd_pairs").glob("*_left.png")):
        yield f"indoor {left.stem.removesuffix('_left')}", _rectified(left, str(left).replace("_left", "_right"))
    folder = DATA / "kitti_seq1"
    if folder.is_dir():
        yield "street", _rectified(*(sorted((folder / f"image_{side}").glob("*.png"))[0] for side in "lr"))
    folder = DATA / "kitti_raw_0926"
    if folder.is_dir():
        files = [sorted((folder / f"image_0{k}").glob("*.png"))[0] for k in (0, 1)]
        yield "street, raw", _raw(*files, folder / "calib_cam_to_cam.txt")
    folder = DATA / "euroc_v101_keyframes"
    if folder.is_dir():
        left = sorted((folder / "images").glob("*_0.jpg"))[0]
        yield "room, raw", _raw(left, str(left).replace("_0.jpg", "_1.jpg"), folder)


def _rectified(left: Path, right: Path | str) -> StereoPair:
    folder = left.parent if (left.parent / "calib.yaml").exists() else left.parents[1]
    values = yaml.safe_load((folder / "calib.yaml").read_text())
    lens = {key: values[key] for key in ("fx", "fy", "cx", "cy", "width", "height")}
    return StereoPair(read_image(left), read_image(right), tspslam.Rig(**lens, baseline=values["baseline_m"]))


def _raw(left: Path, right: Path | str, calib: Path) -> StereoPair:
    images = read_image(left), read_image(right)
    made = tspslam.rectification(tspslam.read_calibration(calib, images[0].shape[1::-1]).cameras)
    return StereoPair(*made(*images), made.rig)


def quality_row(pair: StereoPair, detector: Callable, truth: np.ndarray | None) -> list[float]:
    """Figures of one pair and detector, in the order of `COLUMNS`."""
    cloud, quality = reconstruct_with_quality(pair, detector=detector)
    within = np.nan
    if truth is not None:
        error = np.abs(cloud.disparity - at_pixels(truth, cloud.uv))
        within = float((error[np.isfinite(error)] < 1).mean())
    rig, height = pair.rig, pair.left.shape[0]
    cells = np.histogram2d(*cloud.uv.T, bins=(15, 10), range=((0, rig.width), (0, height)))[0]
    ms = 1e3 * median_seconds(lambda: reconstruct_with_quality(pair, detector=detector), 5)
    both = [grey_levels(image) for image in (pair.left, pair.right)]
    orb = cv2.ORB.create(2000)
    reference = 1e3 * median_seconds(lambda: [orb.detectAndCompute(image, None) for image in both], 5)
    shares = [within, _back_search(pair, cloud), _block_matching(pair, cloud), float((cells > 0).mean())]
    return [quality.keypoints_left, len(cloud), *shares, ms, reference]


def at_pixels(values: np.ndarray, uv: np.ndarray) -> np.ndarray:
    column, row = np.rint(uv).astype(int).T
    return values[row, column]


def _back_search(pair: StereoPair, cloud: tspslam.Cloud) -> float:
    """Share of points whose place in the right image, searched for over the whole range, leads back within 1 px."""
    planes = smooth_plane(pair.right), smooth_plane(pair.left)
    uv = cloud.uv - np.column_stack([cloud.disparity, np.zeros(len(cloud))])
    low, high = cloud.disparity.min() - 5, cloud.disparity.max() + 5
    found = -search(*planes, uv, np.tile([[-high], [-low]], len(cloud)), Patches())[0]
    return float((np.abs(found - cloud.disparity) <= 1).mean())


def _block_matching(pair: StereoPair, cloud: tspslam.Cloud) -> float:
    """Share of points within 1 px of OpenCV's semi-global matching, where that knows a disparity."""
    dense = SgbmMatcher().disparity_map(pair, cloud.disparity.min() - 5, cloud.disparity.max() + 5)
    error = np.abs(cloud.disparity - at_pixels(dense, cloud.uv))
    return float((error[np.isfinite(error)] < 1).mean())


def write_table() -> None:
    """Write the table of detectors and pairs that the documentation shows."""
    lines = [COLUMNS]
    for name, pair in pairs():
        truth = tspslam.datasets.motorcycle_truth() if name == "Motorcycle" else None
        for kind, detector in DETECTORS.items():
            row = quality_row(pair, detector, truth)
            shares = ["" if np.isnan(x) else f"{100 * x:.1f} %" for x in row[2:6]]
            lines.append(
                ",".join([name, kind, *(f"{x:.0f}" for x in row[:2]), *shares, *(f"{x:.0f}" for x in row[6:])])
            )
            print(lines[-1])
    TABLE.write_text("\n".join(lines) + "\n")


def detector_figures(kind: str) -> Figures:
    row = quality_row(tspslam.datasets.motorcycle(), DETECTORS[kind], tspslam.datasets.motorcycle_truth())
    return {"points": row[1], "within_1px": row[2], "ms": row[6], "of_opencv_orb": row[6] / row[7]}


def cut_figures() -> Figures:
    """Faces of Motorcycle that bridge a true depth step of over 10 % along a side, and good faces lost, per cent.

    Also of those whose three points are right to 5 % of depth: what the cuts can do.
    """
    pair, truth = tspslam.datasets.motorcycle(), tspslam.datasets.motorcycle_truth()
    cloud = tspslam.reconstruct(pair)
    depth = pair.rig.fx * pair.rig.baseline / (at_pixels(truth, cloud.uv) + pair.rig.doffs)
    whole = DelaunaySurface(max_depth_ratio=1e9, min_angle=0)(cloud).faces
    bridging, good = _judge(whole, depth)
    cut = tspslam.delaunay_surface(cloud).faces
    cut_bridging, cut_good = _judge(cut, depth)
    right = np.abs(cloud.xyz[:, 2] / depth - 1) < 0.05
    return {
        "bridging_without_cuts": 100 * bridging / (bridging + good),
        "bridging": 100 * cut_bridging / (cut_bridging + cut_good),
        "bridging_of_right_points": 100 * _judge(cut[right[cut].all(axis=1)], depth)[0] / (cut_bridging + cut_good),
        "good_faces_lost": 100 * (1 - cut_good / good),
    }


def _judge(faces: np.ndarray, depth: np.ndarray) -> tuple[int, int]:
    """How many faces with known depths bridge a step, and how many do not."""
    corners = depth[faces]
    corners = corners[np.isfinite(corners).all(axis=1)]
    step = np.abs(corners - np.roll(corners, -1, 1)) / np.minimum(corners, np.roll(corners, -1, 1))
    return int((step.max(axis=1) > 0.1).sum()), int((step.max(axis=1) <= 0.1).sum())


def variant_figures(width: int) -> Figures:
    """The Motorcycle pair at another width: points and share within 1 px."""
    pair, truth = tspslam.datasets.motorcycle(), tspslam.datasets.motorcycle_truth()
    scale = width / pair.rig.width
    size = width, round(pair.rig.height * scale)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
    left, right = (cv2.resize(image, size, interpolation=how) for image in (pair.left, pair.right))
    lens = {key: getattr(pair.rig, key) * scale for key in ("fx", "fy", "cx", "cy", "doffs")}
    rig = replace(pair.rig, **lens, width=size[0], height=size[1])
    cloud = tspslam.reconstruct(StereoPair(left, right, rig))
    known = at_pixels(truth, np.minimum(cloud.uv / scale, (pair.rig.width - 1, pair.rig.height - 1)))
    error = np.abs(cloud.disparity - known * scale)
    return {"points": len(cloud), "within_1px": float((error[np.isfinite(error)] < 1).mean())}


def crust_figures(n: int = 20_000) -> Figures:
    """The Crust around a random torus, beside a Delaunay triangulation of its points."""
    from scipy.spatial import Delaunay

    around, along = 2 * np.pi * np.random.default_rng(0).random((2, n))
    ring = 1 + 0.4 * np.cos(along)
    xyz = np.column_stack([ring * np.cos(around), ring * np.sin(around), 0.4 * np.sin(along) + 4])
    surface = tspslam.crust_surface(xyz)
    seconds = median_seconds(lambda: tspslam.crust_surface(xyz), 3)
    return {
        "faces": len(surface.faces),
        "euler": surface.report.euler,
        "boundary_edges": surface.report.boundary_edges,
        "seconds": seconds,
        "of_one_delaunay": seconds / median_seconds(lambda: Delaunay(xyz), 3),
    }


def lidar_figures(n: int = 1_000_000) -> Figures:
    """A cloud like a LiDAR's into an image with a depth buffer, beside its bare projection."""
    from tspslam.vision.rig import project

    rig = tspslam.Rig(721.5, 721.5, 609.6, 172.9, 0.54, 1242, 375)
    xyz = np.random.default_rng(0).uniform((-40, -3, -10), (40, 1.7, 80), (n, 3))
    seconds = median_seconds(lambda: tspslam.visible_uv(rig, xyz), 7)
    return {"seconds": seconds, "of_projection": seconds / median_seconds(lambda: project(rig, xyz), 7)}
