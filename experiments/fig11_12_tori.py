"""Two tori seen by the paper's rig: signal, magnitude and phase of the published filter on what the left camera sees.

The pair is ray cast; hidden vertices and their faces are taken away by a depth buffer. Before that, Crust is run on
the whole torus and gives exactly 2N faces with Euler characteristic 0. The texture is ours (the paper does not
describe its own), so levels cannot be compared. With the regular grid the published phase is smooth along the
silhouette, where neighbours lie on one side only: there it sees the shape of the neighbourhood, not the luminance.
"""

import numpy as np

import tspslam
from tspslam.datasets import synthetic

from .common import Result, Source
from .look import panels, show_response

TITLE = "Figures 11 and 12: tori of 1 000 and 20 000 points"
SIZES, SMALL = {1000: (25, 40), 20_000: (100, 200)}, {400: (16, 25), 1000: (25, 40)}
TURN = (np.pi / 4, 0, 0)


def run(source: Source) -> Result:
    figure, axes = panels(4, 3, 11.6)
    table = {key: [] for key in ("N", "crust_faces", "crust_euler", "visible", "with_response", "median_magnitude")}
    for rows, (n, shape) in zip((axes[:2], axes[2:]), (SMALL if source.small else SIZES).items(), strict=True):
        ring = synthetic.torus(1.0, 0.4, rows=shape[0], columns=shape[1]).at(0, 0, 4, turn=TURN)
        fine = synthetic.torus(1.0, 0.4, rows=200, columns=500).at(0, 0, 4, turn=TURN)
        pair = synthetic.SyntheticSequence(synthetic.Scene((fine,), background=0.0, name=f"torus_{n}"))[0]
        xyz = ring.world_vertices()
        found = tspslam.diagnose_surface(tspslam.crust_surface(xyz).faces, xyz)
        uv = tspslam.visible_uv(pair.rig, xyz, ring.faces)
        seen = np.isfinite(uv).all(axis=1)
        complex_ = tspslam.build_complex(ring.faces[seen[ring.faces].all(axis=1)], n)
        signals = tspslam.sample_signals(pair.left, uv, complex_)
        response = tspslam.tmahf(complex_, uv, signals, centering="none")
        draw(figure, rows.ravel(), pair, uv, signals, response, 6 if n > 5000 else 22)
        row = (
            n,
            len(found.face_area),
            found.euler,
            seen.sum(),
            response.defined.sum(),
            np.median(response.magnitude[response.defined]),
        )
        for key, value in zip(table, row, strict=True):
            table[key].append(value)
    numbers = {f"N = {n}: {key}": table[key][k] for k, n in enumerate(table["N"]) for key in list(table)[1:]}
    return Result(figure, table, numbers, {f"N = {n}: crust_faces": 2 * n for n in table["N"]})


def draw(figure, axes, pair, uv: np.ndarray, signals, response, size: float) -> None:
    for ax, image, title in ((axes[0], pair.left, f"{pair.name}: left view"), (axes[1], pair.right, "right view")):
        ax.imshow(image, cmap="gray", vmin=0, vmax=255)
        ax.set(title=title, xlabel="u, px", ylabel="v, px")
    for ax, title in zip(axes[2:5], ("signal", "magnitude", "phase"), strict=True):
        ax.set(
            title=title,
            xlabel="u, px",
            ylabel="v, px",
            aspect="equal",
            xlim=(100, 415),
            ylim=(340, 50),
            facecolor="0.85",
        )
    ok = signals.vertex_ok
    dots = axes[2].scatter(*uv[ok].T, c=signals.vertex[ok], s=size, cmap="gray", vmin=0, vmax=1)
    figure.colorbar(dots, ax=axes[2], shrink=0.85, label="luminance")
    show_response(figure, axes[3:5], uv, response, size)
    strength = np.log10(np.maximum(response.magnitude[response.defined], 1e-6))
    axes[5].hist(strength, bins=40, color="#0072b2")
    axes[5].set(xlabel="log₁₀ |r|, luminance", ylabel="vertices", title="magnitudes")
