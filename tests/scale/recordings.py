"""Tiny recordings on disk for the tests of batches."""

import numpy as np

from tspslam import Rig
from tspslam.datasets import synthetic

from ..sequences import RIG, write_sequence

TINY = Rig(RIG.fx / 4, RIG.fy / 4, RIG.cx / 4, RIG.cy / 4, RIG.baseline, RIG.width // 4, RIG.height // 4)


def write_walk(folder, length=4.0):
    """A walk through a corridor, two frames each metre; returns its true poses."""
    walk = synthetic.SyntheticSequence(synthetic.corridor(length), TINY, synthetic.Faults(noise=0.01))
    write_sequence(folder, walk)
    return walk.truth


def write_truth(path, truth):
    """Poses in KITTI's form."""
    np.savetxt(path, truth[:, :3].reshape(len(truth), 12))


def content(folder):
    """Bytes of every file of a run but what may vary."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "timings.json")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
