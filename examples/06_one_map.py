"""A room walked in a loop becomes one complex; every tool for complexes works on it: Hodge, heat, holes, cells."""

import sys

import numpy as np

from tspslam import (
    Session,
    betti_numbers,
    build_map,
    grow_labels,
    heat_filter,
    hodge_decompose,
    merge_cells,
    merge_signals,
)
from tspslam.datasets import synthetic

faults = synthetic.Faults(noise=0.01, exposure=0.1)
walk = synthetic.SyntheticSequence(synthetic.room(frames=40), faults=faults)
with Session(walk.rig) as session:
    for pair in walk:
        session.process(pair)
    session.finish()
    world = build_map(session)  # of a finished run: build_map("runs/drive")

complex_, signals = world.complex_, world.signals
print(f"map: {len(world)} landmarks, {len(complex_.faces)} faces of {len(world.keyframes)} keyframes")
print(f"views of a face: {np.median(world.view_count.face):.0f}, unseen {np.mean(~signals.face_ok):.1%}")
spread = np.degrees(np.median(world.direction_spread[world.direction_count > 1]))
print(f"directions: {world.defined.mean():.0%} defined, spread over views {spread:.1f} degrees")

# What the views disagree on: noise here; on a street also what moves and shines.
noise = np.sqrt(np.median(world.view_variance.face[world.view_count.face > 2]))
print(f"luminance of a face differs by {noise:.4f} between views")

# Luminance smoothed along the surface, and its differences along edges split by Hodge.
smooth = heat_filter(complex_.L0, signals.vertex, 2.0)
flow = np.diff(smooth[complex_.edges], axis=1)[:, 0]
gradient, curl, harmonic = hodge_decompose(complex_, flow)
print(f"flow: {np.abs(gradient - flow).max():.0e} from a gradient, {np.abs(curl).max():.0e} curl")
holes = betti_numbers(complex_)
print(f"holes: parts {holes[0]}, loops {holes[1]}")

# Neighbouring faces joined to polygons, and their signals with them.
labels = grow_labels(complex_, 6)
cells = merge_cells(complex_, labels)
means = merge_signals(complex_, labels, signals)
print(f"cells: {len(cells.faces)} polygons of {len(complex_.faces)} faces, luminance {means.face.mean():.3f}")

if len(sys.argv) > 1:
    from tspslam.view import write_map_pictures

    print(f"pictures: {len(write_map_pictures(world, sys.argv[1]))}")
