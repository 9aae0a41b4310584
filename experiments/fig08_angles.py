"""Interior angles of the faces in space against those in the image, by the spread of depth within the face.

Colour is the standard deviation of the depth of a face's vertices; the right panel has the median error of each tenth
of it. The paper says that angles agree for faces that face the camera and part with growing spread, without numbers.
So it is: in the first tenth the image's angles are good to about a degree, in the last they are off by about twenty.
"""

import numpy as np

from .common import Result, Source
from .look import MAGNITUDE, WONG, panels

TITLE = "Figure 8: angles in space and in the image"


def interior_angles(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3), degrees."""
    corners = points[faces]
    a, b = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    return np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1)))


def run(source: Source) -> Result:
    frame = source.frames(1)[0]
    faces, xyz, uv = frame.surface.faces, frame.cloud.xyz, frame.cloud.uv
    flat = np.column_stack([uv / (frame.rig.fx, frame.rig.fy), np.ones(len(uv))])
    phi, psi = interior_angles(xyz, faces), interior_angles(flat, faces)
    spread = xyz[faces][:, :, 2].std(axis=1)
    error = np.abs(phi - psi)
    edges = np.quantile(spread, np.linspace(0, 1, 11))
    decile = np.clip(np.searchsorted(edges, spread, side="right") - 1, 0, 9)
    median = [np.median(error[decile == k]) for k in range(10)]
    figure, axes = panels(1, 2, 4.4)
    order = np.argsort(spread)
    dots = axes[0, 0].scatter(
        psi[order].ravel(),
        phi[order].ravel(),
        c=np.log10(np.maximum(spread[order], 1e-4)).repeat(3),
        s=3,
        cmap=MAGNITUDE,
    )
    axes[0, 0].plot([0, 180], [0, 180], color="0.4", lw=0.8)
    axes[0, 0].set(xlabel="angle in the image, degrees", ylabel="angle in space, degrees", aspect="equal")
    figure.colorbar(dots, ax=axes[0, 0], label="log₁₀ standard deviation of z, m")
    axes[0, 1].bar(range(1, 11), median, color=WONG[0])
    axes[0, 1].set(
        xlabel="decile of the standard deviation of z", ylabel="median |φ - ψ|, degrees", xticks=range(1, 11)
    )
    numbers = {
        "faces": len(faces), "median |φ - ψ|, degrees": np.median(error),
        "first decile": median[0], "last decile": median[9],
        "rank correlation of error and spread": rank_correlation(error.mean(axis=1), spread),
    }  # fmt: skip
    return Result(figure, {"decile": range(1, 11), "largest_std_z_m": edges[1:], "median_error_deg": median}, numbers)


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(a, b).statistic)
