"""Meshes denoised beside baselines whose parameters are picked on the truth: ``python -m benchmarks.uses.mesh``."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

import tspslam
from tspslam.apps.mesh import denoise_mesh

from ..measure import median_seconds
from . import bilateral_normals as bilateral
from .mesh_shapes import Mesh, development, mean_edge, normal_error, snr, sphere, torus, with_noise
from .mesh_shapes import bumpy as bumps

Score = Callable[[np.ndarray], float]
RECORDED = {"Fandisk": "Fandisk0.3", "Block": "Block0.4", "SharpSphere": "SharpSphere0.3"}
METHODS = ("noisy", "Laplacian", "Taubin", "heat", "implicit", "moving least squares", "bilateral normals", "ours")
TIMES = np.geomspace(0.05, 200, 24)  # of heat and of the implicit filter
RADII = (0.7, 1.0, 1.4, 2.0, 2.8, 4.0)  # of moving least squares, mean edges


def read_recorded(folder: Path, name: str) -> tuple[np.ndarray, Mesh]:
    """Noisy vertices, and the true mesh."""
    import trimesh

    noisy, truth = (trimesh.load(folder / f"{name}-{kind}.obj", process=False) for kind in ("Noisy", "Original"))
    return np.array(noisy.vertices, float), (np.array(truth.vertices, float), np.array(noisy.faces))


def smoothed(xyz: np.ndarray, faces: np.ndarray, taubin: bool) -> list[np.ndarray]:
    """Laplacian or Taubin smoothing of trimesh after 1, 2, 5, 10, 20, 50 and 100 rounds."""
    import trimesh
    from trimesh.smoothing import filter_laplacian, filter_taubin

    out = []
    for rounds in (1, 2, 5, 10, 20, 50, 100):
        mesh = trimesh.Trimesh(xyz, faces, process=False)
        apply = (lambda m, n: filter_taubin(m, 0.5, 0.52, n)) if taubin else (lambda m, n: filter_laplacian(m, 0.5, n))
        apply(mesh, rounds)
        out.append(np.array(mesh.vertices))
    return out


def moving_least_squares(xyz: np.ndarray, radius: float) -> np.ndarray:
    """Each point projected onto the plane of the 60 points around it, by a Gaussian of their distance."""
    distance, near = cKDTree(xyz).query(xyz, 60)
    weight = np.exp(-0.5 * (distance / radius) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    middle = np.einsum("nk,nkc->nc", weight, xyz[near])
    off = xyz[near] - middle[:, None]
    normal = np.linalg.eigh(np.einsum("nk,nki,nkj->nij", weight, off, off))[1][:, :, 0]
    return xyz - np.einsum("nc,nc->n", xyz - middle, normal)[:, None] * normal


def estimates(xyz: np.ndarray, faces: np.ndarray, score: Score) -> dict[str, np.ndarray]:
    """Each method's best estimate; lower scores are better."""
    L0 = tspslam.build_complex(faces, len(xyz)).L0
    edge = mean_edge(xyz, faces)
    best = lambda tries: min(tries, key=score)  # noqa: E731
    return {
        "noisy": xyz,
        "Laplacian": best(smoothed(xyz, faces, taubin=False)),
        "Taubin": best(smoothed(xyz, faces, taubin=True)),
        "heat": best(tspslam.heat_filter(L0, xyz, t, error=1e-6) for t in TIMES),
        "implicit": best(tspslam.tikhonov_filter(L0, xyz, t) for t in TIMES),
        "moving least squares": best(moving_least_squares(xyz, radius * edge) for radius in RADII),
        "bilateral normals": bilateral.best_of_grid(xyz, faces, score)[2],
        "ours": denoise_mesh(xyz, faces),
    }


def surface_distance(points: np.ndarray, truth: np.ndarray, faces: np.ndarray) -> float:
    """Mean distance to the nearest of the 24 true triangles with the nearest centres, over the mean edge."""
    near = cKDTree(truth[faces].mean(axis=1)).query(points, 24)[1]
    a, b, c = (truth[faces[near, corner]] for corner in range(3))
    sides = [to_segment(points[:, None], *pair) for pair in ((a, b), (b, c), (c, a))]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    height = ((points[:, None] - a) * normal).sum(-1)
    foot = points[:, None] - height[..., None] * normal
    turns = [(np.cross(q - p, foot - p) * normal).sum(-1) >= 0 for p, q in ((a, b), (b, c), (c, a))]
    distance = np.where(np.logical_and.reduce(turns), abs(height), np.minimum.reduce(sides))
    return float(distance.min(axis=1).mean() / mean_edge(truth, faces))


def to_segment(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances from points to segments."""
    along = np.clip(((p - a) * (b - a)).sum(-1) / np.maximum(((b - a) ** 2).sum(-1), 1e-300), 0, 1)
    return np.linalg.norm(p - a - along[..., None] * (b - a), axis=-1)


def recorded_table(folder: Path) -> list[list[str]]:
    """Angle of normals and distance to the surface, every method, each recorded mesh."""
    columns = []
    for name, file in RECORDED.items():
        noisy, (truth, faces) = read_recorded(folder, file)
        found = estimates(noisy, faces, lambda x, t=truth, f=faces: normal_error(x, t, f))
        column = [(normal_error(x, truth, faces), surface_distance(x, truth, faces)) for x in found.values()]
        columns.append([f"{angle:.2f}; {distance:.3f}" for angle, distance in column])
        print(f"{name}:", "; ".join(f"{m} {c}" for m, c in zip(METHODS, columns[-1], strict=True)), flush=True)
    return [
        ["angle of normals, °; distance, edges", *RECORDED],
        *([m, *row] for m, *row in zip(METHODS, *columns, strict=True)),
    ]


def made_table() -> list[list[str]]:
    """Angle of normals on shapes of development; says how the constants were chosen, not how good they are."""
    rows = [["angle of normals, °", "noise", "noisy", "bilateral normals, oracle", "ours"]]
    shapes = development(100)
    for name, kind in (
        ("ring", "normal"),
        ("slot dome", "normal"),
        ("bumpy", "normal"),
        ("sphere", "normal"),
        ("ring", "axes"),
    ):
        truth, faces = shapes[name]
        noisy = with_noise(shapes[name], 0.3, kind, 101)
        score = lambda x, t=truth, f=faces: normal_error(x, t, f)  # noqa: E731
        values = (score(noisy), bilateral.best_of_grid(noisy, faces, score)[0], score(denoise_mesh(noisy, faces)))
        rows.append(
            [name, "along normals" if kind == "normal" else "on each axis", *(f"{value:.2f}" for value in values)]
        )
        print("; ".join(rows[-1]), flush=True)
    return rows


def torus_table() -> list[list[str]]:
    """Signal-to-noise ratio of the torus, dB: mean over three seeds, the worst beside it."""
    mesh = torus(100, 200)
    L0 = tspslam.build_complex(mesh[1], len(mesh[0])).L0
    rows = [["torus, dB", "noisy", "heat", "implicit", "Taubin", "ours", "ours, worst seed"]]
    for level in (0.25, 0.5, 1.0):
        found = []
        for seed in range(3):
            noisy = with_noise(mesh, level, "axes", seed)
            heat = max(snr(tspslam.heat_filter(L0, noisy, t, error=1e-6), mesh[0]) for t in np.geomspace(0.3, 60, 24))
            implicit = max(snr(tspslam.tikhonov_filter(L0, noisy, t), mesh[0]) for t in np.geomspace(0.3, 30, 12))
            taubin = max(snr(x, mesh[0]) for x in smoothed(noisy, mesh[1], taubin=True))
            found.append((snr(noisy, mesh[0]), heat, implicit, taubin, snr(denoise_mesh(noisy, mesh[1]), mesh[0])))
            print(f"torus, {level} edges, seed {seed}:", np.round(found[-1], 2), flush=True)
        values = [*np.mean(found, axis=0), min(row[-1] for row in found)]
        rows.append([f"{level} edges", *(f"{value:.1f}" for value in values)])
    return rows


def time_table() -> list[list[str]]:
    """Time of 20 000 vertices, one core, beside the bilateral reference at 20 and 20 rounds."""
    rows = [["20 000 vertices", "ours, ms", "bilateral normals, 20 and 20 rounds, ms"]]
    for name, mesh in (("torus", torus(100, 200)), ("bumpy sphere", sphere(20_000, bumps, 100))):
        noisy, faces = with_noise(mesh, 0.3, "normal", 0), mesh[1]

        def reference(noisy=noisy, faces=faces) -> None:
            normals, centres, areas = bilateral.geometry(noisy, faces)
            near = bilateral.around(faces, len(noisy))
            reach = bilateral.adjacent_distance(centres, faces)
            bilateral.move_vertices(
                noisy, faces, bilateral.filter_normals(normals, centres, areas, *near, 0.35, reach, 20), 20
            )

        ours = median_seconds(lambda noisy=noisy, faces=faces: denoise_mesh(noisy, faces), 5)
        rows.append([name, f"{ours * 1e3:.0f}", f"{median_seconds(reference, 5) * 1e3:.0f}"])
        print("; ".join(rows[-1]), flush=True)
    return rows


def as_rst(rows: list[list[str]]) -> str:
    """A list-table."""
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for row in rows:
        lines += [f"   {'* -' if i == 0 else '  -'} {cell}" for i, cell in enumerate(row)]
    return "\n".join(lines) + "\n"


def draw(path: Path) -> None:
    """Noisy, bilateral with its best parameters, ours and the truth, lit from one side."""
    import matplotlib.pyplot as plt
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    shapes = development(100)
    figure, axes = plt.subplots(2, 4, figsize=(11, 5.2), subplot_kw={"projection": "3d"})
    for row, (name, kind) in zip(axes, (("ring", "normal"), ("grooved", "axes")), strict=True):
        truth, faces = shapes[name]
        noisy = with_noise(shapes[name], 0.3, kind, 101)
        score = lambda x, t=truth, f=faces: normal_error(x, t, f)  # noqa: E731
        best = bilateral.best_of_grid(noisy, faces, score)[2]
        titles = ("noisy", "bilateral normals, oracle", "ours", "truth")
        for place, title, xyz in zip(row, titles, (noisy, best, denoise_mesh(noisy, faces), truth), strict=True):
            normals = bilateral.geometry(xyz, faces)[0]
            shade = np.clip(0.35 + 0.6 * (normals @ np.array([0.36, -0.48, 0.8])), 0.05, 1)
            place.add_collection3d(Poly3DCollection(xyz[faces], facecolors=plt.cm.gray(shade), linewidths=0))
            low, high = truth.min(0), truth.max(0)
            place.set(
                xlim=(low[0], high[0]),
                ylim=(low[1], high[1]),
                zlim=(low[2], high[2]),
                title=f"{title}, {score(xyz):.1f}°",
            )
            place.set_box_aspect(high - low, zoom=1.5)
            place.view_init(35, -60)
            place.axis("off")
    figure.subplots_adjust(0, 0, 1, 0.93, 0, 0.05)
    figure.savefig(path, dpi=80)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--docs", type=Path, help="folder of the pages: writes uses_mesh.inc and images/uses_mesh.png")
    docs = parser.parse_args().docs
    folder = Path(os.environ.get("TSPSLAM_DATA", "")) / "noisy_meshes"
    tables = [recorded_table(folder)] if folder.is_dir() else []
    tables += [torus_table(), made_table(), time_table()]
    if docs:
        (docs / "uses_mesh.inc").write_text("\n".join(map(as_rst, tables)))
        draw(docs / "images" / "uses_mesh.png")


if __name__ == "__main__":
    main()
