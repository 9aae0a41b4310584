"""The uses on the map of a sequence: ``python -m benchmarks.uses.on_map [--development] [--docs docs]``."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tspslam import TopologicalMap, segment
from tspslam.datasets import synthetic
from tspslam.run.denoise import denoise
from tspslam.run.given import Given
from tspslam.vision.rig import project

from .. import mapping, mapping_measures
from .segment_measures import adjusted_rand

DEVELOPMENT = {
    "corridor 100": lambda: synthetic.corridor(20.0, step=0.5, seed=100),
    "room 100": lambda: synthetic.room(laps=0.6, frames=160, seed=100),
}


def opened(name: str) -> mapping.World:
    """A world of the scored or of the development data."""
    if name in mapping.SCENES:
        return mapping.known(name)
    scene, rig = DEVELOPMENT[name](), synthetic.PAPER_RIG
    clean = synthetic.SyntheticSequence(scene, rig, mapping.CLEAN)
    return mapping.World(name, synthetic.SyntheticSequence(scene, rig, mapping.FAULTS), clean)


def true_shapes(made: TopologicalMap, world: mapping.World) -> tuple[np.ndarray, np.ndarray]:
    """Which shape each face shows in its best view, and whether one is known: its depth there is the face's to 3 %."""
    middle, view = made.xyz[made.surface.faces].mean(axis=1), np.asarray(made.best_view.face)
    shape, ok = np.zeros(len(view), np.int64), np.zeros(len(view), bool)
    for row in np.unique(view[view >= 0]):
        T = np.linalg.inv(made.T_world_camera[row])
        local = middle[view == row] @ T[:3, :3].T + T[:3, 3]
        seen = world.clean.geometry(int(made.keyframes[row]))
        column, line = np.floor(project(made.rig, local) + 0.5).astype(int).T
        height, width = seen.label.shape
        inside = (column >= 0) & (column < width) & (line >= 0) & (line < height)
        column, line = np.where(inside, column, 0), np.where(inside, line, 0)
        near = np.abs(local[:, 2] - seen.depth[line, column]) < 0.03 * local[:, 2]
        shape[view == row], ok[view == row] = seen.label[line, column], inside & near
    return shape, ok


def figures(name: str) -> dict[str, float]:
    """All measures of a world, in per cent but for the index."""
    world = opened(name)
    made, _ = mapping.build(world)
    depth, _ = world.truth(np.asarray(made.keyframes))
    T_true = world.sequence.truth[made.keyframes]
    truth = mapping_measures.true_surface(depth, world.sequence.rig, made.T_world_camera, T_true)
    vertex, keyframe = mapping.sightings(made)
    first = np.asarray(made.observations.start)[:-1]
    pose = made.T_world_camera[keyframe[first]]
    z = np.einsum("ni,ni->n", made.xyz - pose[:, :3, 3], pose[:, :3, 2])
    found: dict[str, float] = {"vertices": len(made)}
    moved = denoise(Given(Path(name), made), signals=False).xyz
    for when, xyz in (("raw", made.xyz), ("denoised", moved)):
        off = truth.distance(xyz) / z
        share = mapping_measures.distance_to_truth(xyz, made.surface.faces, truth, vertex, keyframe, by="face")
        found |= {
            f"{when}: vertices": 100 * float(np.median(off)),
            f"{when}: 95th": 100 * float(np.quantile(off, 0.95)),
        }
        found |= {f"{when}: faces": 100 * share.median, f"{when}: faces 95th": 100 * share.p95}
    shape, ok = true_shapes(made, world)
    labels = segment(made.complex_, made.signals, xyz=made.xyz, covariance=made.covariance)
    found |= {
        "regions": int(labels.max()) + 1,
        "Rand index": adjusted_rand(shape[ok] - 1, labels[ok], np.ones(ok.sum())),
    }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--docs", type=Path)
    said = parser.parse_args()
    table = {name: figures(name) for name in (DEVELOPMENT if said.development else mapping.SCENES)}
    names = list(next(iter(table.values())))
    rows = [["", *table], *([name, *(f"{row[name]:.4g}" for row in table.values())] for name in names)]
    for row in rows:
        print("  ".join(f"{cell:>18}" for cell in row))
    if said.docs:
        lines = [".. list-table::", "   :header-rows: 1", ""]
        for row in rows:
            lines += [f"   {'*' if k == 0 else ' '} - {cell}" for k, cell in enumerate(row)]
        (said.docs / "uses_map.inc").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
