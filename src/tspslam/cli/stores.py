"""Clouds larger than the memory: ``tspslam store``; ``tspslam filter`` takes what it makes."""

from __future__ import annotations

from pathlib import Path
from shlex import quote
from typing import Annotated

import typer

from ._filter_store import tell
from ._shared import JsonOption, app


@app.command("store")
def store_command(
    source: Annotated[Path, typer.Argument(help="Mesh or cloud (.ply, .las, .laz, ...), or a run folder with a map.")],
    out: Annotated[Path, typer.Option(help="The store: a new folder.")],
    images: Annotated[
        Path | None, typer.Option(help="List: IMAGE U V, or IMAGE CALIBRATION and a pose of 12 numbers, a line.")
    ] = None,
    faces: Annotated[Path | None, typer.Option(help="Faces of a LAS cloud: (F, 3) integers in a .npy file.")] = None,
    chunk: Annotated[int, typer.Option(help="Vertices of a chunk.")] = 1 << 16,
    as_json: JsonOption = False,
) -> None:
    """Make a store of a mesh that may be larger than the memory: chunks of vertices by place, with their faces."""
    from ..scale.stores.image_lists import read_images
    from ..scale.stores.sources import of_file
    from ..scale.stores.writing import write_store

    references = read_images(images) if images is not None else []
    made = write_store(out, of_file(source, faces=faces, images=references), chunk=chunk)
    counts = {"vertices": made.n, "faces": made.n_faces, "images": len(made.images)}
    words = [f"{made.n} vertices, {made.n_faces} faces, {len(made.images)} images"]
    missing = [] if made.n_faces else ["faces (--faces)"]
    missing += [] if made.images or "luminance" in made.mesh.arrays else ["images (--images) or luminance"]
    says = (
        f"to filter it, make it with {' and '.join(missing)}"
        if missing
        else f"filter:   tspslam filter {quote(str(out))}"
    )
    tell(counts, [*words, says], [str(out)], as_json)
