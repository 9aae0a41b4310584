"""A run is watched while it goes on, and looked at when it is done: steps, path, pictures, report, map.

python examples/08_look.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import tspslam
from tspslam.datasets import synthetic
from tspslam.run.pipeline import Step, run

# A source is anything with a name, a rig, a length and pairs by index: a recording, or a world with a known truth.
source = synthetic.SyntheticSequence(synthetic.corridor(6.0), faults=synthetic.Faults(noise=0.01))
folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="tspslam-"))
stages: list[str] = []


def tell(step: Step) -> None:
    """Say each stage once; the command line shows a line of progress from the same steps."""
    if step.stage not in stages:
        stages.append(step.stage)
        print(f"stage {step.stage}: {step.keyframes} keyframes, {step.lost} lost, {step.loops} loops")


result = run(source, folder / "run", tspslam.Settings(), on_step=tell)
print(f"status: {result.run['status']}, {result.run['tracked']} of {result.run['frames']} frames tracked")

# What it left is read back as the objects that it was made of.
world, path = tspslam.load_map(result.folder), tspslam.load_run(result.folder).trajectory.T_world_camera
truth = np.linalg.inv(source.truth[0]) @ source.truth
print(f"map: {len(world.surface.faces)} faces of {len(world.keyframes)} keyframes")
print(f"path: off by {np.linalg.norm(path[:, :3, 3] - truth[:, :3, 3], axis=1).max():.3f} m at most")
pictures = sorted((result.folder / "pictures").glob("*.png"))
print(f"pictures: {len(pictures)}, the report is {result.folder / 'report.html'}")
