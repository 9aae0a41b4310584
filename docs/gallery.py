"""The pictures of the gallery: each is drawn from the objects that an example has when it ends.

python docs/gallery.py [FOLDER]
"""

import ast
import contextlib
import io
import runpy
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from PIL import Image

from tspslam.view import phase_colours

EXAMPLES = Path(__file__).parents[1] / "examples"
IMAGES = Path(__file__).parent / "images"
WIDTH, COLOURS = 900, 255  # px of a picture, and colours: small files that still look right
Names = dict[str, Any]


def main(folder: Path = IMAGES) -> None:
    for example in sorted(EXAMPLES.glob("*.py")):
        draw_example(example.stem, folder)


def draw_example(name: str, folder: Path) -> Path:
    """Run an example and draw what it made."""
    path = folder / f"gallery_{name}.png"
    with tempfile.TemporaryDirectory() as written:
        drawn = DRAWN[name](run_example(EXAMPLES / f"{name}.py", Path(written)))
        picture = picture_of(drawn) if isinstance(drawn, Figure) else Image.open(drawn).convert("RGB")
    picture = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    few = picture.quantize(COLOURS)
    picture.quantize(palette=few, dither=Image.Dither.FLOYDSTEINBERG).save(path, optimize=True)
    return path


def run_example(path: Path, written: Path) -> Names:
    """What is named when an example has ended; of the one with a network, what it makes before it needs PyTorch."""
    given, sys.argv = sys.argv, [str(path), str(written)]
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            if not path.stem.startswith("04"):
                return runpy.run_path(str(path), run_name="__main__") | {"written": written}
            names: Names = {}
            exec(compile(without_torch(ast.parse(path.read_text("utf-8"))), path.name, "exec"), names)
            return names
    finally:
        sys.argv = given


def without_torch(tree: ast.Module) -> ast.Module:
    """The constants, functions and images at the head of an example, without what mentions PyTorch."""
    head = tree.body[: next(k for k, node in enumerate(tree.body) if isinstance(node, ast.ClassDef))]
    tree.body = [node for node in head if not any(getattr(each, "id", "") == "torch" for each in ast.walk(node))]
    tree.body = [node for node in tree.body if not isinstance(node, ast.Try)]
    return tree


def picture_of(figure: Figure) -> Image.Image:
    written = io.BytesIO()
    figure.get_layout_engine().set(h_pad=0.1)
    figure.savefig(written, dpi=140)
    plt.close(figure)
    return Image.open(written).convert("RGB")


def panels(count: int, height: float, **more: Any) -> tuple[Figure, Any]:
    figure, axes = plt.subplots(1, count, figsize=(9, height), layout="constrained", **more)
    for ax in np.ravel(axes):
        ax.set(xticks=[], yticks=[])
    return figure, axes


def cells_on(ax: Any, corners: list[np.ndarray], image: np.ndarray, **look: Any) -> PolyCollection:
    """Faces at their pixels, each in its colour."""
    shapes = PolyCollection(corners, **look)
    ax.add_collection(shapes)
    ax.set(xlim=(0, image.shape[1]), ylim=(image.shape[0], 0), aspect="equal")
    return shapes


def phase_over_the_image(names: Names) -> Figure:
    frame, image = names["frame"], names["pair"].left
    figure, (left, right) = panels(2, 3.4)
    left.imshow(image)
    left.triplot(*frame.cloud.uv.T, frame.complex_.faces, color="white", lw=0.35)
    left.set(title="points and complex over the left image")
    defined, z = frame.response.defined, frame.response.z
    turn = np.angle(z[defined]) % (2 * np.pi) / (2 * np.pi)
    strong = np.log10(frame.response.magnitude[defined] + 1e-6)
    shown = np.argsort(strong)  # the strongest on top
    size = 2 + 16 * np.clip((strong - np.percentile(strong, 20)) / 1.5, 0, 1)
    colours = phase_colours(256)[((turn + 0.5) % 1 * 256).astype(int) % 256]
    right.imshow(image, alpha=0.3)
    right.scatter(*frame.cloud.uv[defined][shown].T, c=colours[shown], s=size[shown], lw=0)
    right.set(title="response: hue its phase, size its magnitude")
    return figure


def responses_of_one_and_two_rings(names: Names) -> Figure:
    figure, axes = panels(2, 3.4)
    image, uv = names["pair"].left, names["cloud"].uv
    both = {"one ring": names["response"], "two rings, the second with half the weight": names["wide"]}
    for ax, (title, response) in zip(axes, both.items(), strict=True):
        defined = response.defined & (response.magnitude > 0)
        strong = np.log10(response.magnitude[defined])
        order = np.argsort(strong)
        ax.imshow(image, alpha=0.25)
        low, high = np.percentile(strong, [5, 98])
        ax.scatter(*uv[defined][order].T, c=strong[order], s=8, cmap="viridis", vmin=low, vmax=high, lw=0)
        ax.set(title=f"log |r|, {title}")
    return figure


def torus_under_an_image(names: Names) -> Figure:
    figure = plt.figure(figsize=(9, 3.3), layout="constrained")
    above, turned, plane = (
        figure.add_subplot(1, 3, k, projection="3d" if k == 2 else None, title=title)
        for k, title in enumerate(("the image and the torus in it", "signals of its faces", "responses, per px"), 1)
    )
    above.imshow(names["image"], extent=(0, 512, 512, 0))
    above.triplot(*names["uv"].T, names["faces"], color="white", lw=0.05)
    above.set(xticks=[], yticks=[])
    show_surface(turned, names["xyz"], names["faces"], names["colour"].face)
    z = names["response"].z[names["response"].defined]
    looks = {"red": ("#c00000", "o"), "green": ("#009040", "s"), "blue": ("#0040c0", "^")}
    for values, (name, (colour, marker)) in zip(z.T, looks.items(), strict=True):
        plane.scatter(values.real, values.imag, s=25, c=colour, marker=marker, label=name)
    plane.axhline(0, color="0.7", lw=0.8, zorder=0)
    plane.axvline(0, color="0.7", lw=0.8, zorder=0)
    reach = 1.4 / 512
    ticks = {"ticks": (0, 1 / 512), "labels": ("0", "1/512")}
    plane.set_xticks(**ticks)
    plane.set_yticks(**ticks)
    plane.set(xlim=(-reach / 2, reach), ylim=(-reach / 2, reach), aspect="equal", xlabel="real", ylabel="imaginary")
    plane.legend(loc="upper right", fontsize=8)
    return figure


def show_surface(ax: Any, xyz: np.ndarray, faces: np.ndarray, rgb: np.ndarray) -> None:
    """A surface in three dimensions, in the colours of its faces."""
    ax.plot_trisurf(*xyz.T, triangles=faces, lw=0, antialiased=False).set_facecolors(np.clip(rgb, 0, 1))
    ax.set(xlim=(-1.4, 1.4), ylim=(-1.4, 1.4), zlim=(-0.7, 0.7))
    ax.set_box_aspect((2, 2, 1), zoom=1.25)
    ax.view_init(50, -60)
    ax.set_axis_off()


def stripes_to_tell_apart(names: Names) -> Figure:
    rng, wave = np.random.default_rng(3), names["wave"]
    is_fine = wave(rng, names["REGION"]) > 0
    image = names["grey"] + names["CONTRAST"] * np.where(is_fine, wave(rng, names["FINE"]), wave(rng, names["COARSE"]))
    uv, complex_ = names["half_complexes"](0, names["middle"] - 5)[0]
    column, row = np.floor(uv + 0.5).astype(int).T
    figure, (left, right) = panels(2, 3.4)
    left.imshow(image, cmap="gray", vmin=0, vmax=1)
    left.set(title="stripes, finer or coarser than the mesh")
    right.imshow(image, cmap="gray", vmin=0, vmax=1, alpha=0.35)
    right.triplot(*uv.T, complex_.faces, color="0.5", lw=0.3)
    for fine, colour, marker in ((True, "#0072b2", "o"), (False, "#d55e00", "s")):
        right.scatter(*uv[is_fine[row, column] == fine].T, s=9, c=colour, marker=marker, lw=0)
    right.set(title="training half: fine (round) or coarse (square)?")
    return figure


def flows_on_a_torus(names: Names) -> Figure:
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", subplot_kw={"projection": "3d"})
    xyz, complex_, b = names["xyz"], names["complex_"], names["b"]
    middle, along = xyz[complex_.edges].mean(axis=1), np.diff(xyz[complex_.edges], axis=1)[:, 0]
    seen = np.flatnonzero(np.sin(b)[complex_.edges].min(axis=1) > -0.2)  # the upper side
    some = np.random.default_rng(0).permutation(seen)[:900]
    for ax, (name, title) in zip(axes, {"along": "along the ring", "around": "around its tube"}.items(), strict=True):
        flow = names["harmonic"][name]
        step = (along * (flow / (along**2).sum(axis=1))[:, None])[some]
        step *= 0.1 / np.median(np.linalg.norm(step, axis=1))
        show_surface(ax, xyz, complex_.faces, np.full((len(complex_.faces), 3), 0.9))
        ax.quiver(*(middle[some] * (1, 1, 1.05)).T, *step.T, color="#0072b2", lw=0.9, arrow_length_ratio=0.4)
        ax.set(title=f"harmonic flow {title}")
    return figure


def map_of_a_room(names: Names) -> Path:
    """The package's own picture of the map's response, which the example has written."""
    return names["written"] / "map_response.png"


def regions_of_a_frame(names: Names) -> Figure:
    image, uv, faces = names["pair"].left, names["cloud"].uv, names["complex_"].faces
    regions, cells = names["regions"], names["cells"]
    figure, axes = panels(3, 2.7)
    axes[0].imshow(image, cmap="gray", vmin=0, vmax=255)
    axes[0].set(title="a noisy image")
    low, high = np.percentile(names["clean"].face, [1, 99])
    shapes = cells_on(
        axes[1], list(uv[faces]), image, array=names["clean"].face, cmap="gray", edgecolors="face", lw=0.3
    )
    shapes.set_clim(low, high)
    axes[1].set(title="signals of faces, denoised")
    hue = plt.colormaps["tab20"](np.arange(regions.max() + 1) % 20)
    cells_on(axes[2], list(uv[faces]), image, facecolors=hue[regions], edgecolors="face", lw=0.3)
    cells_on(axes[2], [uv[cell] for cell in cells.faces], image, facecolors="none", edgecolors="white", lw=0.6)
    axes[2].set(title=f"{regions.max() + 1} regions, {len(cells.faces)} cells")
    return figure


def map_of_a_run(names: Names) -> Path:
    """One of the pictures that the run has left."""
    return next(path for path in names["pictures"] if path.stem == "map_path")


DRAWN: dict[str, Callable[[Names], Figure | Path]] = {
    "01_one_call": phase_over_the_image,
    "02_parts": responses_of_one_and_two_rings,
    "03_kernels": torus_under_an_image,
    "04_train_a_network": stripes_to_tell_apart,
    "05_flows_on_a_torus": flows_on_a_torus,
    "06_one_map": map_of_a_room,
    "07_uses": regions_of_a_frame,
    "08_look": map_of_a_run,
}

if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
