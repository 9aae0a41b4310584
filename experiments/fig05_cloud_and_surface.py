"""The cloud, and two surfaces on it: the paper's Crust, and a Delaunay triangulation of the image with depth cuts.

A face bridges a depth step where the true depths of two of its corners differ by more than 10 %. Crust is made for
points all over a closed body; on the open, noisy sheets that stereo gives it falls to pieces, with edges of more than
two faces, though ours ends with a flood fill from outside. The cuts take away most of the bridges; what is left hangs
on points that were matched with the wrong side of an edge (:doc:`cameras_and_clouds`). So the walk uses the second;
the first is for closed clouds (below, the tori). The paper shows Crust and gives no measure of it.
"""

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

import tspslam

from .common import Result, Source
from .look import plt

TITLE = "Figure 5: cloud and surface"


def run(source: Source) -> Result:
    frame = source.frames(1)[0]
    xyz, truth = frame.cloud.xyz, source.true_disparity(frame)
    faces = {"Delaunay, with cuts": frame.surface.faces, "Delaunay, without": uncut(frame.cloud)}
    faces["Crust"] = tspslam.crust_surface(xyz).faces
    rows = {name: measure(f, frame.cloud, truth, frame.rig) for name, f in faces.items()}
    figure = plt.figure(figsize=(11, 4.2), layout="constrained")
    near = xyz[:, 2] < np.percentile(xyz[:, 2], 95)
    shown = {"cloud": np.empty((0, 3), int), **{k: faces[k] for k in ("Crust", "Delaunay, with cuts")}}
    for k, (name, f) in enumerate(shown.items()):
        ax = figure.add_subplot(1, 3, k + 1, projection="3d", azim=-78, elev=22)
        ax.set_box_aspect((1.2, 1, 0.9), zoom=0.95)
        f = f[near[f].all(axis=1)]
        across, ahead, up = xyz[:, 0], xyz[:, 2], -xyz[:, 1]
        if len(f):
            sheet = Poly3DCollection(np.stack([across, ahead, up], axis=1)[f], cmap="viridis", lw=0.1, edgecolors="0.3")
            sheet.set_array(ahead[f].mean(axis=1))
            ax.add_collection(sheet)
        dots = ax.scatter(across[near], ahead[near], up[near], c=ahead[near], s=2 if not k else 0, cmap="viridis")
        ax.set(title=name, xlabel="x, m", ylabel="z, m", zlabel="-y, m")
    figure.colorbar(dots, ax=figure.axes, shrink=0.6, label="z, m")
    columns = {"surface": list(rows), **{key: [row[key] for row in rows.values()] for key in rows["Crust"]}}
    numbers = {f"{name}: {key}": value for name, row in rows.items() for key, value in row.items()}
    return Result(figure, columns, numbers)


def uncut(cloud: tspslam.Cloud) -> np.ndarray:
    return tspslam.delaunay_surface(cloud, max_depth_ratio=1e9).faces


def measure(faces: np.ndarray, cloud: tspslam.Cloud, truth: np.ndarray | None, rig: tspslam.Rig) -> dict:
    found = tspslam.diagnose_surface(faces, cloud.xyz)
    row = {
        "faces": len(faces), "boundary loops": len(found.boundary_loops),
        "edges of more than two faces": found.nonmanifold_edges,
        "parts": found.components, "points without a face": len(found.unused),
    }  # fmt: skip
    if truth is not None:
        row["faces over a true depth step, %"] = 100 * bridges(faces, cloud.uv, truth + rig.doffs).mean()
    return row


def bridges(faces: np.ndarray, uv: np.ndarray, inverse_depth: np.ndarray) -> np.ndarray:
    """Of the faces whose corners have a known depth: whether two of them differ by more than 10 %."""
    column, row = np.floor(uv + 0.5).astype(int).T
    corners = 1 / inverse_depth[row, column][faces]
    corners = corners[np.isfinite(corners).all(axis=1)]
    return corners.max(axis=1) > 1.1 * corners.min(axis=1)
