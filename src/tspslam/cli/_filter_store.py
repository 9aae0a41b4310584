"""``tspslam filter`` of a store."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..printing import note, say
from ._progress import progress
from ._shared import DEGRADED, INTERRUPTED

if TYPE_CHECKING:
    from ..scale.stores.store import Store
    from ..scale.stores.stored_response import StoredResponse


def filter_a_store(
    path: Path, mode: tuple[int, str | None, float | None], *, images: Path | None, out: Path | None, to: str | None,
    where: tuple[int, str | None, str], as_json: bool,
) -> None:  # fmt: skip
    """Filter a store, tile by tile, and write a file a tile if that is asked for."""
    from .._files import bad_input
    from ..run.guard import is_inside
    from ..scale.stores.store import open_store
    from ..scale.stores.tile_files import INDEX, KINDS, write_tiles

    if (out is None) != (to is None) or (to is not None and to not in KINDS):
        raise typer.BadParameter(f"goes with --out, expected one of {', '.join(KINDS)}", param_hint="--to")
    opened = open_store(path, images=images)
    if out is not None and is_inside(out, path):
        raise bad_input(out, f"lies in the store {path}", "a folder outside (--out)")
    try:
        response = _filtered(opened, mode, where, as_json)
    except KeyboardInterrupt as stop:
        note("interrupted; the same command goes on where this one stopped")
        raise typer.Exit(INTERRUPTED) from stop
    found = response.summary
    if found["missing"]:
        first = opened.mesh.image_paths[found["missing"][0]]
        said = f"{len(found['missing'])} of {len(opened.images)} images are not there, such as {first}"
        note(f"warning: {said}: vertices that are seen in them have no response")
    written = [str(path / "responses" / response.name)]
    words = [f"response at {found['defined']} of {opened.n} vertices, filtered in {_count(found['tiles'], 'tile')}"]
    if out is not None and to is not None:
        files = write_tiles(response, out, to)
        written.append(str(out / INDEX.get(to, "")))
        words.append(f"{_count(files, 'file')} of {to}, one a chunk")
    if found["split"]:
        words.append(f"{_count(found['split'], 'tile')} killed their worker and were split")
    tell({"vertices": opened.n, "faces": opened.n_faces} | found, words, written, as_json)
    if found["missing"] or not found["defined"]:
        raise typer.Exit(DEGRADED)


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _filtered(
    store: Store, mode: tuple[int, str | None, float | None], where: tuple[int, str | None, str], as_json: bool
) -> StoredResponse:
    """Filter, and tell how far it is."""
    from ..run.sequence import Step
    from ..scale.stores.cluster import connected

    (order, centering, occlusion), (workers, scheduler, memory) = mode, where
    chosen: Any = centering
    with progress(as_json) as on_step, connected(scheduler, store.path) as client:
        on_step(Step("filter", 0, store.n))
        return store.filter(
            order=order, centering=chosen, occlusion=occlusion, memory=memory, workers=workers, client=client,
            on_tile=lambda done, total: on_step(Step("filter", done, total)),
        )  # fmt: skip


def refuse_options(*, what: str = "a mesh or a scan", **given: object) -> None:
    """Refuse options that do not go with what is filtered."""
    for name, value in given.items():
        if value is not None:
            raise typer.BadParameter(f"goes with {what}", param_hint=f"--{name.replace('_', '-')}")


def tell(found: dict[str, Any], words: list[str], written: list[str], as_json: bool) -> None:
    """Say what was found and written."""
    if as_json:
        say(json.dumps({"written": written} | found))
    else:
        say(*(f"wrote {each}" for each in written), *words)
