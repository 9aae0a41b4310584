"""The pictures of the pages on spectra, filters, cells and worlds, drawn from synthetic data and Motorcycle."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm
from scipy.spatial import Delaunay

import tspslam
from tspslam.topology.mahf import tangent_axes

NAMES = ("hodge.png", "filters.png", "logmap.png", "cells.png", "worlds.png", "lenses.png", "lidar.png")


def draw(folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    frame = tspslam.Session(tspslam.datasets.motorcycle().rig).process(tspslam.datasets.motorcycle())
    figures = (hodge(), filters(frame), logmap(), cells(frame), worlds(), lenses(), lidar())
    for name, figure in zip(NAMES, figures, strict=True):
        figure.savefig(folder / name, dpi=110, bbox_inches="tight")
        plt.close(figure)


def ring_mesh() -> tuple[np.ndarray, tspslam.Complex]:
    """A square with a round hole."""
    u, v = np.meshgrid(np.arange(15.0), np.arange(15.0))
    jitter = np.random.default_rng(0).uniform(-0.25, 0.25, (2, 225))
    points = np.column_stack([u.ravel() + jitter[0], v.ravel() + jitter[1]])
    points = points[np.hypot(*(points - 7).T) > 2.6]
    faces = Delaunay(points).simplices
    centres = points[faces].mean(axis=1)
    return points, tspslam.build_complex(faces[np.hypot(*(centres - 7).T) > 2.4], len(points))


def hodge() -> plt.Figure:
    """A flow that streams out, swirls and runs around the hole, and its three parts."""
    points, complex_ = ring_mesh()
    middle = points[complex_.edges].mean(axis=1)
    along = points[complex_.edges[:, 1]] - points[complex_.edges[:, 0]]
    away, swirl = middle - (3, 11), middle - (11, 4)
    around = (middle - 7) / (np.hypot(*(middle - 7).T) ** 2)[:, None]
    field = away * np.exp(-((away**2).sum(1) / 12))[:, None]
    field += 1.5 * np.column_stack([-swirl[:, 1], swirl[:, 0]]) * np.exp(-((swirl**2).sum(1) / 8))[:, None]
    field += 3 * np.column_stack([-around[:, 1], around[:, 0]])
    flow = (field * along).sum(axis=1)
    figure, axes = plt.subplots(1, 4, figsize=(13, 3.6), layout="constrained")
    for ax, values, title in zip(
        axes, (flow, *tspslam.hodge_decompose(complex_, flow)), ("flow", "gradient", "curl", "harmonic"), strict=True
    ):
        ax.triplot(*points.T, complex_.faces, color="0.88", lw=0.6)
        arrows = along * (values / (along**2).sum(axis=1))[:, None]
        ax.quiver(*middle.T, *arrows.T, np.abs(values), cmap="viridis", angles="xy", scale=22, width=0.006, clim=(0, 2))
        ax.set(title=title, aspect="equal", xticks=[], yticks=[])
    return figure


def filters(frame) -> plt.Figure:
    """Magnitudes of the three filters of order 1 over the image."""
    pair, uv = tspslam.datasets.motorcycle(), frame.cloud.uv
    image = chf_at(tspslam.chf(pair.left, scale=6.0).z, uv)
    mahf = tspslam.mahf(frame.surface, frame.cloud.xyz, frame.signals.vertex, laplacian="graph")
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.4), layout="constrained")
    panels = (("CHF, σ = 6 px", image), ("MAHF, graph, t = 1", mahf.magnitude), ("T-MAHF", frame.response.magnitude))
    for ax, (title, values) in zip(axes, panels, strict=True):
        shown = frame.response.defined & (values > 0)
        ax.imshow(pair.left, alpha=0.35)
        low, high = np.percentile(np.log10(values[shown]), [5, 98])
        dots = ax.scatter(*uv[shown].T, c=np.log10(values[shown]), s=7, cmap="viridis", vmin=low, vmax=high)
        ax.set(title=title, xticks=[], yticks=[])
        figure.colorbar(dots, ax=ax, shrink=0.8, label="log₁₀ |r|")
    return figure


def chf_at(z: np.ndarray, uv: np.ndarray) -> np.ndarray:
    column, row = np.floor(uv + 0.5).astype(int).T
    return np.abs(z[row, column])


def logmap() -> plt.Figure:
    """How far the angle in the tangent plane is from that of the logarithmic map, by distance."""
    import potpourri3d

    figure, ax = plt.subplots(figsize=(6.4, 3.4), layout="constrained")
    for name, (faces, xyz) in {"torus, 1 000 vertices": torus(25, 40), "sphere, 1 002 vertices": sphere(1002)}.items():
        solver, axes = potpourri3d.MeshVectorHeatSolver(xyz, faces), tangent_axes(xyz, np.asarray(faces, np.int32))
        edge = np.linalg.norm(xyz[faces[:, 0]] - xyz[faces[:, 1]], axis=1).mean()
        near, off = [], []
        for i in range(0, len(xyz), 17):
            ours = _angles(axes[i], xyz - xyz[i])
            there = solver.compute_log_map(i)
            distance = np.linalg.norm(there, axis=1) / edge
            ring = (distance > 0.5) & (distance < 1.6)
            error = min(_errors(ours, there, ring, sign) for sign in (1, -1))[1]
            use = (distance > 0.5) & (distance < 8)
            near.append(distance[use])
            off.append(np.array(error)[use])
        near, off = np.concatenate(near), np.concatenate(off)
        steps = np.arange(1, 8)
        for share, style in ((50, "o-"), (95, "^--")):
            values = [np.percentile(off[np.abs(near - s) < 0.5], share) for s in steps]
            ax.plot(steps, values, style, ms=4, label=f"{name}, {'median' if share == 50 else '95th percentile'}")
    ax.set(xlabel="geodesic distance / mean edge length", ylabel="difference of angle, degrees", ylim=(0, None))
    ax.legend(fontsize=8)
    return figure


def _errors(ours: np.ndarray, there: np.ndarray, ring: np.ndarray, sign: int) -> tuple[float, list[float]]:
    """Differences of angle, degrees, after the solver's axes are turned, and perhaps mirrored, to ours on the ring."""
    turn = np.exp(1j * (ours - sign * np.arctan2(there[:, 1], there[:, 0])))
    error = np.degrees(np.abs(np.angle(turn * turn[ring].sum().conj())))
    return float(np.median(error[ring])), error.tolist()


def _angles(axes: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    return np.arctan2(offsets @ axes[3:], offsets @ axes[:3])


def torus(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    i, j = np.divmod(np.arange(rows * columns), columns)
    right, down = i * columns + (j + 1) % columns, (i + 1) % rows * columns + j
    across, here = (i + 1) % rows * columns + (j + 1) % columns, i * columns + j
    faces = np.concatenate([np.stack([here, across, right], 1), np.stack([here, down, across], 1)])
    a, b = 2 * np.pi * i / rows, 2 * np.pi * j / columns
    ring = 1 + 0.4 * np.cos(a)
    return faces, np.column_stack([ring * np.cos(b), ring * np.sin(b), 0.4 * np.sin(a) + 4])


def sphere(n: int) -> tuple[np.ndarray, np.ndarray]:
    from scipy.spatial import ConvexHull

    k = np.arange(n) + 0.5
    polar, turn = np.arccos(1 - 2 * k / n), np.pi * (1 + 5**0.5) * k
    xyz = np.column_stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)])
    faces = ConvexHull(xyz).simplices
    normal = np.cross(xyz[faces[:, 1]] - xyz[faces[:, 0]], xyz[faces[:, 2]] - xyz[faces[:, 0]])
    inward = (normal * xyz[faces[:, 0]]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    xyz[:, 2] += 4
    return faces, xyz


def cells(frame) -> plt.Figure:
    """Mean luminance of triangles and of the cells that they are merged into."""
    complex_, uv, signals = frame.complex_, frame.cloud.uv, frame.signals
    labels = tspslam.grow_labels(complex_, 10)
    merged, mean = tspslam.merge_cells(complex_, labels), tspslam.merge_signals(complex_, labels, signals)
    figure, axes = plt.subplots(1, 2, figsize=(13, 4.6), layout="constrained")
    panels = ((complex_.faces, signals.face, "triangles"), (merged.faces, mean.face, "cells of up to 10 triangles"))
    for ax, (faces, values, title) in zip(axes, panels, strict=True):
        shapes = PolyCollection([uv[face] for face in faces], array=values, cmap="gray", edgecolors="0.45", lw=0.25)
        shapes.set_clim(0, 1)
        ax.add_collection(shapes)
        ax.set(title=f"{len(faces)} {title}", xticks=[], yticks=[], aspect="equal")
        ax.set(xlim=(0, frame.rig.width), ylim=(frame.rig.height, 0))
    figure.colorbar(shapes, ax=axes, shrink=0.8, label="luminance")
    return figure


def worlds() -> plt.Figure:
    """The ready worlds and their depth."""
    synthetic = tspslam.datasets.synthetic
    scenes = (synthetic.street(40), synthetic.corridor(20), synthetic.room(frames=40), synthetic.still(1))
    figure, axes = plt.subplots(2, 4, figsize=(13, 5.2), layout="constrained", sharex=True, sharey=True)
    for (above, below), scene in zip(axes.T, scenes, strict=True):
        sequence = synthetic.SyntheticSequence(scene)
        place = len(sequence) // 5
        above.imshow(sequence[place].left, cmap="gray", vmin=0, vmax=255)
        depth = below.imshow(sequence.geometry(place).depth, norm=LogNorm(1, 100), cmap="viridis")
        above.set(title=scene.name, xticks=[], yticks=[])
    figure.colorbar(depth, ax=axes[1], shrink=0.9, label="z, m")
    return figure


def lenses() -> plt.Figure:
    """A corridor through a fisheye lens, and rectified to two fields of view."""
    synthetic = tspslam.datasets.synthetic
    lens = tspslam.Camera(150, 150, 159.5, 119.5, 320, 240, (0.01, -0.005, 0.001, 0.0), lens="equidistant")
    T_right_left = ((1, 0, 0, -0.2), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))
    raw = tspslam.RawRig(lens, lens, T_right_left)
    images = list(synthetic.RawSequence(synthetic.corridor(10), raw).images(4))
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.4), layout="constrained")
    axes[0].imshow(images[0], cmap="gray", vmin=0, vmax=255)
    axes[0].set(title="through the lens", xticks=[], yticks=[])
    for ax, degrees in zip(axes[1:], (80, 130), strict=True):
        made = tspslam.rectification(tspslam.RawRig(lens, lens, T_right_left, degrees))
        ax.imshow(made(*images)[0], cmap="gray", vmin=0, vmax=255)
        ax.set(title=f"rectified to {degrees}°", xticks=[], yticks=[])
    return figure


def lidar() -> plt.Figure:
    """A scan of a street: its range image all around, and its faces in a photo with their luminance."""
    synthetic = tspslam.datasets.synthetic
    scene, axes_of_scanner = synthetic.street(60.0), synthetic.scanner.AXES
    rig = tspslam.Rig(fx=707.09, fy=707.09, cx=601.9, cy=183.1, baseline=0.537, width=1226, height=370)
    echoes = synthetic.scan(scene, scene.path[5] @ axes_of_scanner, synthetic.Scanner(columns=900, noise=0.02))
    photo = synthetic.SyntheticSequence(scene, rig)[5].left
    points = echoes.xyz @ axes_of_scanner[:3, :3].T
    frame = tspslam.interop.meshes.from_arrays(points, tspslam.scan_surface(echoes.xyz).faces, photo, rig)
    figure, (above, below) = plt.subplots(2, 1, figsize=(13, 6), layout="constrained", height_ratios=(1, 2))
    distance = np.linalg.norm(echoes.xyz, axis=1)
    azimuth = np.degrees(np.arctan2(echoes.xyz[:, 1], echoes.xyz[:, 0]))
    elevation = np.degrees(np.arcsin(echoes.xyz[:, 2] / distance))
    dots = above.scatter(azimuth, elevation, c=distance, s=0.6, norm=LogNorm(2, 100), cmap="viridis")
    above.set(xlim=(180, -180), xlabel="azimuth, °", ylabel="elevation, °", title="the scan, all around")
    figure.colorbar(dots, ax=above, label="range, m")
    ok = frame.signals.face_ok
    corners = frame.cloud.uv[frame.complex_.faces[ok]]
    below.imshow(photo, cmap="gray", alpha=0.35, vmin=0, vmax=255)
    below.add_collection(PolyCollection(corners, array=frame.signals.face[ok], cmap="viridis", edgecolors="none"))
    below.set(xlim=(0, rig.width), ylim=(rig.height, 0), xticks=[], yticks=[])
    below.set(title=f"luminance of the {int(ok.sum())} faces that the camera sees, of {len(ok)}")
    return figure
