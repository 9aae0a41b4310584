"""How good the one map of a sequence is: ``python -m benchmarks.mapping [WORLD]... [--data FOLDER] [--cache FOLDER]``.

Worlds with a known truth: street, corridor, room. Recordings, where FOLDER (or TSPSLAM_DATA) has them: kitti_05,
kitti_raw_0926, kitti_seq1, euroc_v101_keyframes. With --cache, what was rendered of the truth is kept there.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tspslam import Rig, Session, build_map, list_settings
from tspslam.datasets import open_sequence, synthetic
from tspslam.errors import GeometryError, InputError
from tspslam.mapping.settings import MappingSettings
from tspslam.run.config import resolve
from tspslam.topology.texture import luminance

from . import mapping_measures as measures
from . import mapping_signals as signals

KITTI = Rig(fx=707.09, fy=707.09, cx=601.9, cy=183.1, baseline=0.537, width=1226, height=370)
FAULTS = synthetic.Faults(noise=0.012, blur=0.6, exposure=0.15)
CLEAN = synthetic.Faults(eight_bit=False)
PICTURES = ("map_street_path.png", "map_street_variance.png", "map_corridor_above.png", "map_room_above.png",
            "map_room_response.png")  # fmt: skip
RECORDED = ("kitti_05", "kitti_raw_0926", "kitti_seq1", "euroc_v101_keyframes")
SCENES = {
    "street": (lambda: synthetic.street(60.0, step=0.75), KITTI, 40.0),
    "corridor": (lambda: synthetic.corridor(40.0, step=0.5), synthetic.PAPER_RIG, np.inf),
    "room": (lambda: synthetic.room(laps=1.2, frames=160), synthetic.PAPER_RIG, np.inf),
}  # how to make it, its cameras, and how far what should be covered reaches, m


@dataclass(frozen=True)
class World:
    """A sequence; where the truth is known, also the scene without faults. `farthest` is what should be covered, m."""

    name: str
    sequence: Any
    clean: synthetic.SyntheticSequence | None = None
    farthest: float = np.inf

    def truth(self, frames, cache: Path | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Depth and noise-free luminance of frames, each (K, H, W) float32."""
        assert self.clean is not None
        path = cache / f"{self.name}.npz" if cache else None
        if path and path.exists():
            kept = np.load(path)
            if np.array_equal(kept["frames"], frames):
                return kept["depth"], kept["image"]
        depth = np.stack([self.clean.geometry(int(k)).depth.astype(np.float32) for k in frames])
        image = np.stack([self.clean[int(k)].left for k in frames])
        if path:
            np.savez(path, frames=frames, depth=depth, image=image)
        return depth, image


def known(name: str) -> World:
    make, rig, farthest = SCENES[name]
    scene = make()
    clean = synthetic.SyntheticSequence(scene, rig, CLEAN)
    return World(name, synthetic.SyntheticSequence(scene, rig, FAULTS), clean, farthest)


def build(world: World) -> tuple[Any, dict[str, float]]:
    """The map of a world, and the seconds of the session and of the map."""
    started = time.perf_counter()
    with Session(world.sequence.rig) as session:
        for k in range(len(world.sequence)):
            session.process(world.sequence[k])
        session.finish()
        finished = time.perf_counter()
        made = build_map(session)
    return made, {"session, s": finished - started, "map, s": time.perf_counter() - finished}


def surface_figures(made: Any, rig: Rig) -> dict[str, float]:
    """What needs no truth; shares in per cent. `made` is a map, or whatever has its arrays."""
    xyz, faces, T = made.xyz, made.complex_.faces, made.T_world_camera
    vertex, keyframe = sightings(made)
    edges, fans = measures.manifold_faults(faces, len(xyz))
    return {
        "vertices": len(xyz),
        "faces": len(faces),
        "three sightings": 100 * float((np.diff(made.observations.start) >= 3).mean()),
        "double": 100 * measures.double_layers(xyz, faces, rig, T),
        "edges of 3": edges,
        "fans": fans,
        "blocked": 100 * measures.ray_conflicts(xyz, faces, rig, T, vertex, keyframe),
    }


def truth_figures(made: Any, world: World, depth: np.ndarray) -> dict[str, float]:
    """Beside the true surface; all in per cent."""
    T_true = world.sequence.truth[made.keyframes]
    truth = measures.true_surface(depth, world.sequence.rig, made.T_world_camera, T_true)
    surface = (made.xyz, made.complex_.faces, truth, *sightings(made))
    found = measures.distance_to_truth(*surface)
    names = ("off", "off 95th", "behind", "before", "unviewed")
    shares = dict(zip(names, found, strict=True)) | {
        "off 95th, by face": measures.distance_to_truth(*surface, by="face").p95,
        "off, truth itself": measures.truth_floor(truth)[0],
        "covered": measures.coverage(made.xyz, made.complex_.faces, truth, world.farthest),
    }
    return {name: 100 * share for name, share in shares.items()}


def signal_figures(made: Any, rig: Rig, clean: np.ndarray, taken: np.ndarray) -> dict[str, float]:
    """Errors of faces' luminance, and of directions, degrees; and each over that of a single frame by chance."""
    seen = (made.xyz, made.complex_.faces, rig, made.T_world_camera)
    views = signals.face_views(*seen, np.stack([clean, taken], axis=-1))
    (best, true_ok), (one, one_ok) = (
        f(views, len(seen[1])) for f in (signals.best_face_values, signals.one_view_values)
    )
    ok = np.asarray(made.signals.face_ok) & one_ok
    grey = signals.luminance_error(made.signals.face, ok, best[:, 0], true_ok)
    found = {"grey": grey, "grey / one": grey / signals.luminance_error(one[:, 1], ok, best[:, 0], true_ok)}
    single, _ = signals.one_view_directions(*seen, taken, how="projection")
    filtered, _ = signals.one_view_directions(*seen, clean, seed=None, how="projection")
    ok, strength = np.asarray(made.defined) & single.ok, made.response.magnitude
    for name, true in (("turned", signals.true_directions(*seen, clean)), ("turned by noise", filtered)):
        ours, one = (  # the same vertices in both: the strongest half by the map's response
            float(np.median(signals.direction_errors(direction, strength, ok, true)))
            for direction in (made.direction, single.direction)
        )
        found |= {name: ours, f"{name} / one": ours / one}
    return found


def sightings(made: Any) -> tuple[np.ndarray, np.ndarray]:
    """Vertex, and row of the keyframe, of every observation."""
    start = np.asarray(made.observations.start)
    return np.repeat(np.arange(len(start) - 1), np.diff(start)), np.asarray(made.observations.keyframe)


def figures(made: Any, world: World, cache: Path | None = None) -> dict[str, float]:
    """All measures of a map of a world."""
    started = time.perf_counter()
    found = surface_figures(made, world.sequence.rig)
    if world.clean is not None:
        rendering = time.perf_counter()
        depth, clean = world.truth(np.asarray(made.keyframes), cache)
        taken = np.stack([luminance(world.sequence[int(k)].left) for k in made.keyframes])
        started += time.perf_counter() - rendering
        found |= truth_figures(made, world, depth)
        found |= signal_figures(made, world.sequence.rig, clean, taken)
    return found | {"measures, s": time.perf_counter() - started}


def vary_settings(names: list[str], cache: Path | None, data: Path | None) -> None:
    """Print what half and double of each setting of the map do to it; sources of defaults quote this."""
    sessions = {}
    for name in names:
        world = opened(name, data)
        session = Session(world.sequence.rig)
        for k in range(len(world.sequence)):
            session.process(world.sequence[k])
        session.finish()
        sessions[name] = world, session
    for change, mapping in _variations():
        found = [f"{change:<40}"]
        for name, (world, session) in sessions.items():
            found.append(f"{name}: {_in_short(world, session, mapping, cache)}")
        print("  ".join(found), flush=True)


def _variations():
    """Names and mappings: the defaults, then half and double of every number."""
    yield "default", MappingSettings()
    for row in list_settings():
        if not row.name.startswith("mapping.") or row.type not in (int, float):
            continue
        for factor in (0.5, 2):
            value = min(max(row.type(row.default * factor), row.low), row.high)
            if value != row.default:
                yield f"{row.name}={value:g}", resolve(assignments=[f"{row.name}={value}"]).settings.mapping


def _in_short(world: World, session: Session, mapping: MappingSettings, cache: Path | None) -> str:
    started = time.perf_counter()
    try:
        made = build_map(session, mapping)
    except GeometryError as error:
        return str(error)
    seconds = time.perf_counter() - started
    found = surface_figures(made, world.sequence.rig)
    said = f"V {len(made)} double {found['double']:.2f} blocked {found['blocked']:.2f}"
    if world.clean is not None:
        depth, _ = world.truth(np.asarray(made.keyframes), cache)
        truth = truth_figures(made, world, depth)
        said += f" covered {truth['covered']:.1f} off {truth['off']:.2f} {truth['off 95th, by face']:.2f}"
    return f"{said} defined {100 * made.defined.mean():.0f} {seconds:.2f} s"


ROWS = {
    "vertices; faces": ("vertices", "faces"),
    "of them seen by three keyframes or more, %": ("three sightings",),
    "double, %": ("double",),
    "blocked, %": ("blocked",),
    "edges with three faces; vertices with two fans": ("edges of 3", "fans"),
    "covered, %": ("covered",),
    "off, median over the faces' area, %": ("off",),
    "off, 95th percentile over faces; over their area, %": ("off 95th, by face", "off 95th"),
    "luminance of faces, error over that of a single frame": ("grey / one",),
    "direction, median error, degrees; over that of a single frame": ("turned", "turned / one"),
}


def write_table(path: Path, found: dict[str, dict[str, float]]) -> None:
    """The table of the map's page: a column for each world."""
    rows = [[said, *("; ".join(rounded(world[key], 3) for key in keys) for world in found.values())]
            for said, keys in ROWS.items()]  # fmt: skip
    path.write_text(list_table(["", *found], rows), encoding="utf-8")


def rounded(value: float, digits: int) -> str:
    return f"{value:.0f}" if value >= 10**digits else f"{value:.{digits}g}"


def list_table(head: list[str], rows: list[list[str]]) -> str:
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for cells in [head, *rows]:
        lines += [f"   {'*' if k == 0 else ' '} - {cell}" for k, cell in enumerate(cells)]
    return "\n".join(lines) + "\n"


def draw(folder: Path, name: str, made: Any) -> None:
    """Pictures of a scene's map for the page."""
    from tspslam.view import write_map_pictures

    with tempfile.TemporaryDirectory() as drawn:
        for path in write_map_pictures(made, drawn):
            shown = f"map_{name}_{path.stem.removeprefix('map_')}.png"
            if shown in PICTURES:
                Image.open(path).convert("RGB").quantize(256).save(folder / shown, optimize=True)


def line(name: str, found: dict[str, float]) -> str:
    shown = (f"{key} {value:.0f}" if value >= 1000 else f"{key} {value:.3g}" for key, value in found.items())
    return f"{name}: " + ", ".join(shown)


def opened(name: str, data: Path | None) -> World:
    """A scene, a recording in the folder of data, or one at a path."""
    if name in SCENES:
        return known(name)
    return World(name, open_sequence(data / name if data and (data / name).exists() else name))


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world", nargs="*", default=[*SCENES, *RECORDED], help="scene or recording; all by default")
    parser.add_argument("--data", type=Path, default=os.environ.get("TSPSLAM_DATA"), help="folder of recordings")
    parser.add_argument("--cache", type=Path, help="folder for what is rendered")
    parser.add_argument("--settings", action="store_true", help="what half and double of each setting do")
    parser.add_argument("--docs", type=Path, help="write the table and the pictures of the scenes there")
    given = parser.parse_args(arguments)
    if given.settings:
        vary_settings(given.world, given.cache, given.data and Path(given.data))
        return
    found: dict[str, dict[str, float]] = {}
    for name in list(SCENES) if given.docs else given.world:
        try:
            world = opened(name, given.data and Path(given.data))
        except InputError as error:
            print(f"{name}: left out: {error}")
            continue
        made, seconds = build(world)
        found[name] = figures(made, world, given.cache) | seconds
        print(line(name, found[name]), flush=True)
        if given.docs:
            draw(given.docs / "images", name, made)
    if given.docs:
        write_table(given.docs / "mapping_numbers.inc", found)


if __name__ == "__main__":
    main(sys.argv[1:])
