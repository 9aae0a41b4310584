"""Ways to one surface over the same landmarks, measured on the same worlds: the table of the map's page.

``python -m benchmarks.mapping_candidates [WORLD]... [--cache FOLDER]``, as `benchmarks.mapping`.
"""

from __future__ import annotations

import argparse
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tspslam import Cloud, Complex, GeometryError, Session, build_complex, delaunay_surface
from tspslam.mapping.build import collect_landmarks
from tspslam.mapping.landmarks import Landmarks, measure_covariances
from tspslam.mapping.settings import MappingSettings, SurfaceSettings
from tspslam.mapping.surface import Rays, _border, _full, _is_short, _tetrahedra, cut_surface, make_manifold, make_rays
from tspslam.mapping.views import View, to_camera
from tspslam.mapping.visibility import face_normals
from tspslam.run.map import kept_keyframes
from tspslam.topological_map import Observations

from . import mapping

NONE = SurfaceSettings(quality=0, behind=3, longest_apart=0.4)
PROBE = SurfaceSettings(quality=0.5, behind=3, longest_apart=0.4)


@dataclass(frozen=True)
class Candidate:
    """What the measures want of a map."""

    xyz: np.ndarray
    complex_: Complex
    observations: Observations
    keyframes: np.ndarray
    T_world_camera: np.ndarray


@dataclass(frozen=True)
class Material:
    """What all candidates are made of."""

    rig: object
    T: np.ndarray
    landmarks: Landmarks
    covariance: np.ndarray
    rays: Rays
    keyframes: np.ndarray


def gather(session: Session) -> Material:
    given, settings = kept_keyframes(session), MappingSettings()
    snapshot, rig = given.snapshot, given.rig
    numbers = snapshot.keyframe.tolist()
    views = [View(given.index[n], T, given.image_of(n)) for n, T in zip(numbers, snapshot.T_world_camera, strict=True)]
    landmarks = collect_landmarks(views, snapshot, rig, settings)
    landmarks, covariance = measure_covariances(rig, snapshot.T_world_camera, landmarks, settings.observe)
    rays = make_rays(snapshot.T_world_camera, landmarks, covariance)
    frames = np.array([given.index[n] for n in numbers])
    return Material(rig, snapshot.T_world_camera, landmarks, covariance, rays, frames)


def laid_over(m: Material) -> np.ndarray:
    """Triangles of each keyframe's own landmarks in its image, cut where the depth steps, all of them."""
    seen, parts = m.landmarks.seen, []
    for k, T in enumerate(m.T):
        rows = seen.landmark[seen.keyframe == k]
        points = to_camera(m.landmarks.xyz[rows], T)
        covariance = T[:3, :3].T @ m.covariance[rows] @ T[:3, :3]
        good = points[:, 2] > 0
        cloud = Cloud(points[good], seen.uv[seen.keyframe == k][good], np.ones(good.sum()), covariance[good])
        try:
            faces = rows[good][delaunay_surface(cloud).faces]
        except GeometryError:
            continue
        corner = m.landmarks.xyz[faces[:, 0]]
        is_away = np.einsum("fi,fi->f", face_normals(m.landmarks.xyz, faces), T[:3, 3] - corner) < 0
        faces[is_away] = faces[is_away][:, ::-1]
        parts.append(faces)
    every = np.concatenate(parts)
    _, first = np.unique(np.sort(every, axis=1), axis=0, return_index=True)
    return every[np.sort(first)].astype(np.int32)


def cut(m: Material, settings: SurfaceSettings) -> np.ndarray:
    """The border of the minimum cut without what is too long; nothing else is dropped."""
    xyz = m.landmarks.xyz
    cells = _tetrahedra(xyz, m.rays.origin)
    faces = _border(cells, _full(cells, m.rays, settings), len(xyz))
    return faces[_is_short(xyz, faces, m.rays, m.T[:, :3, 3], settings)]


CANDIDATES = {
    "triangles of all keyframes": laid_over,
    "of them, what makes a manifold": lambda m: make_manifold(laid_over(m), m.landmarks.xyz),
    "minimum cut": lambda m: cut(m, NONE),
    "with a quality prior, cleaned": lambda m: make_manifold(cut(m, PROBE), m.landmarks.xyz),
    "full right behind the landmarks": lambda m: make_manifold(cut(m, SurfaceSettings()), m.landmarks.xyz),
    "without what nobody sees from the front": lambda m: ours(m, replace(SurfaceSettings(), seen_through=1000)),
    "without what a camera saw through (ours)": lambda m: ours(m, SurfaceSettings()),
}


def ours(m: Material, settings: SurfaceSettings) -> np.ndarray:
    return cut_surface(m.rig, m.T, m.landmarks.xyz, m.rays, settings, MappingSettings().views)


def as_map(m: Material, faces: np.ndarray) -> Candidate:
    seen, n = m.landmarks.seen, len(m.landmarks.xyz)
    start = np.searchsorted(seen.landmark, np.arange(n + 1))
    rows = Observations(start, seen.keyframe, seen.uv, seen.disparity, np.ones(len(seen.uv)))
    return Candidate(m.landmarks.xyz, build_complex(faces, n), rows, m.keyframes, m.T)


def measured(name: str, data: Path | None, cache: Path | None) -> dict[str, dict[str, float]]:
    """Figures of each candidate on a world."""
    world = mapping.opened(name, data)
    with Session(world.sequence.rig) as session:
        for k in range(len(world.sequence)):
            session.process(world.sequence[k])
        session.finish()
        material = gather(session)
    found = {}
    for label, make in CANDIDATES.items():
        started = time.perf_counter()
        faces = make(material)
        seconds = time.perf_counter() - started
        candidate = as_map(material, faces)
        figures = mapping.surface_figures(candidate, world.sequence.rig)
        figures |= {"vertices": len(np.unique(faces)), "seconds": seconds}
        if world.clean is not None:
            figures |= mapping.truth_figures(candidate, world, world.truth(candidate.keyframes, cache)[0])
        found[label] = figures
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("world", nargs="*", default=[*mapping.SCENES, *mapping.RECORDED])
    parser.add_argument("--data", type=Path, default=os.environ.get("TSPSLAM_DATA"))
    parser.add_argument("--cache", type=Path)
    parser.add_argument("--docs", type=Path, help="write the table of the scenes there")
    given = parser.parse_args()
    found = {}
    for name in list(mapping.SCENES) if given.docs else given.world:
        found[name] = measured(name, given.data and Path(given.data), given.cache)
        for label, figures in found[name].items():
            print(f"{label:<46}", mapping.line(name, figures), flush=True)
    if given.docs:
        (given.docs / "mapping_candidates.inc").write_text(table(found), encoding="utf-8")


def table(found: dict[str, dict[str, dict[str, float]]]) -> str:
    """A row for each candidate; numbers of the worlds one after another."""
    head = [
        ", ".join(found),
        "edges with three faces",
        "double, %",
        "blocked, %",
        "covered, %",
        "off, 95th percentile, %",
    ]
    keys = ("edges of 3", "double", "blocked", "covered", "off 95th, by face")
    rows = [[label, *("; ".join(mapping.rounded(world[label][key], 2) for world in found.values()) for key in keys)]
            for label in CANDIDATES]  # fmt: skip
    return mapping.list_table(head, rows)


if __name__ == "__main__":
    main()
