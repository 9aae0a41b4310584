"""The toy complex of Figure 2 and its incidence matrices.

The paper's text says 7 faces; its total of 15 signal values, its drawing and its B2 have 3. With faces stored
ascending and edges in lexicographic order, B1 B2 = 0.
"""

import numpy as np

import tspslam

from .common import Result, Source
from .look import panels

TITLE = "Figure 2: a toy complex"
FACES = np.array([[1, 3, 4], [1, 2, 3], [2, 3, 5]]) - 1
PLACES = np.array([[0, 0.4], [1, 1.2], [1.1, 0], [0.2, -0.8], [2.1, 0.5]])


def run(source: Source) -> Result:
    complex_ = tspslam.build_complex(FACES, 5)
    B1, B2 = complex_.B1.toarray().astype(int), complex_.B2.toarray().astype(int)
    figure, axes = panels(1, 3, 3.4)
    ax = axes[0, 0]
    ax.tripcolor(*PLACES.T, complex_.faces, facecolors=np.arange(3), cmap="Pastel2", edgecolors="0.3")
    for k, place in enumerate(PLACES):
        ax.annotate(f"p{k + 1}", place, weight="bold", ha="center", bbox={"boxstyle": "circle", "fc": "w"})
    for k, edge in enumerate(complex_.edges):
        ax.annotate(f"e{k + 1}", PLACES[edge].mean(axis=0), color="#0072b2", ha="center", va="center")
    for k, face in enumerate(complex_.faces):
        ax.annotate(f"f{k + 1}", PLACES[face].mean(axis=0), color="#d55e00", ha="center", va="center")
    ax.set(
        title="5 vertices, 7 edges, 3 faces", aspect="equal", xticks=[], yticks=[], xlim=(-0.4, 2.5), ylim=(-1.2, 1.6)
    )
    for ax, matrix, name, (row, column) in ((axes[0, 1], B1, "B1", "pe"), (axes[0, 2], B2, "B2", "ef")):
        ax.imshow(matrix, cmap="PuOr", vmin=-1.6, vmax=1.6)
        for (i, j), value in np.ndenumerate(matrix):
            ax.text(j, i, f"{value:+d}" if value else "0", ha="center", va="center", color="k" if value else "0.6")
        ax.set(title=name, xticks=range(matrix.shape[1]), yticks=range(matrix.shape[0]))
        ax.set_xticklabels([f"{column}{k + 1}" for k in range(matrix.shape[1])])
        ax.set_yticklabels([f"{row}{k + 1}" for k in range(matrix.shape[0])])
    i, j = complex_.edges.T + 1
    largest = int(np.abs(B1 @ B2).max())
    numbers = {"vertices": complex_.n, "edges": len(i), "faces": len(FACES), "largest entry of |B1 B2|": largest}
    paper = {"vertices": 5, "edges": 7, "faces": "7 (text), 3 (figure, B2)"}
    return Result(figure, {"edge": range(1, 8), "from": i.tolist(), "to": j.tolist()}, numbers, paper)
