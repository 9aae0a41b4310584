"""``tspslam filter`` of a store."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from ..printing import note, say
from ._progress import progress
from ._shared import DEGRADED, INTERRUPTED

if TYPE_CHECKING:
    from ..scale.stores.store import Store
    from ..scale.stores.stored_response import StoredResponse


@dataclass(frozen=True)
class Options:
    """How a store is filtered, as it was typed.

    Attributes
    ----------
    order : int
        Angular order m.
    centering : str or None
        What is taken out of the sums.
    occlusion : float or None
        Share of its depth by which a seen vertex may lie behind the nearest face.
    workers : int
        Processes of Dask; 0 is this one alone.
    scheduler : str or None
        Address of one that runs already.
    memory : str
        What a process may take, with its unit.
    """

    order: int
    centering: str | None
    occlusion: float | None
    workers: int
    scheduler: str | None
    memory: str


def filter_a_store(
    path: Path, options: Options, *, images: Path | None, out: Path | None, to: str | None, is_forced: bool,
    as_json: bool,
) -> None:  # fmt: skip
    """Filter a store, tile by tile, and write a file a tile if that is asked for."""
    from ..scale.stores.store import open_store
    from ..scale.stores.tile_files import INDEX, write_tiles

    _check_export(path, out, to, is_forced)
    store = open_store(path, images=images)
    try:
        response = _filtered(store, options, as_json)
    except KeyboardInterrupt as stop:
        note("interrupted; the same command goes on where this one stopped")
        raise typer.Exit(INTERRUPTED) from stop
    found = response.summary
    if found["missing"]:
        first = store.mesh.image_paths[found["missing"][0]]
        said = f"{len(found['missing'])} of {len(store.images)} images are not there, such as {first}"
        note(f"warning: {said}: vertices that are seen in them have no response")
    written = [str(path / "responses" / response.name)]
    words = [f"response at {found['defined']} of {store.n} vertices, filtered in {_count(found['tiles'], 'tile')}"]
    if out is not None and to is not None:
        files = write_tiles(response, out, to, is_forced=is_forced)
        written.append(str(out / INDEX.get(to, "")))
        words.append(f"{_count(files, 'file')} of {to}, one a chunk")
    if found["split"]:
        words.append(f"{_count(found['split'], 'tile')} killed their worker and were split")
    tell({"vertices": store.n, "faces": store.n_faces} | found, words, written, as_json)
    if found["missing"] or not found["defined"]:
        raise typer.Exit(DEGRADED)


def _check_export(path: Path, out: Path | None, to: str | None, is_forced: bool) -> None:
    """Refuse a folder that cannot be written, before the store is filtered."""
    from .._files import bad_input
    from ..run.guard import check_new_folder, is_inside
    from ..scale.stores.tile_files import EXPORT, KINDS

    if (out is None) != (to is None) or (to is not None and to not in KINDS):
        raise typer.BadParameter(f"goes with --out, expected one of {', '.join(KINDS)}", param_hint="--to")
    if is_forced and out is None:
        raise typer.BadParameter("goes with --out", param_hint="--force")
    if out is not None and is_inside(out, path):
        raise bad_input(out, f"lies in the store {path}", "a folder outside (--out)")
    if out is not None and to is not None:
        check_new_folder(out, EXPORT[to], [path], is_forced=is_forced)


def _count(number: int, word: str) -> str:
    return f"{number} {word}{'' if number == 1 else 's'}"


def _filtered(store: Store, options: Options, as_json: bool) -> StoredResponse:
    """Filter, and tell how far it is."""
    from ..run.sequence import Step
    from ..scale.stores.cluster import connected

    centering: Any = options.centering
    with progress(as_json) as on_step, connected(options.scheduler, store.path) as client:
        on_step(Step("filter", 0, store.n))
        return store.filter(
            order=options.order, centering=centering, occlusion=options.occlusion, memory=options.memory,
            workers=options.workers, client=client, on_tile=lambda done, total: on_step(Step("filter", done, total)),
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
