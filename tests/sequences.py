"""Synthetic sequences written as folders."""

from PIL import Image

from tspslam.datasets import synthetic
from tspslam.vision.calibration import save_cameras
from tspslam.vision.orb import OrbDetector

RIG = synthetic.PAPER_RIG
DETECTOR = OrbDetector(count=800)
SETTINGS = ["detector.count=800"]


def write_sequence(folder, sequence):
    """Left and right images and the calibration of a sequence; returns the folder."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    for k, pair in enumerate(sequence):
        for side in ("left", "right"):
            Image.fromarray(getattr(pair, side)).save(folder / side / f"{k:03d}.png", compress_level=1)
    save_cameras(sequence.rig, folder / "calib.yaml")
    return folder


def corridor(length, **faults):
    return synthetic.SyntheticSequence(synthetic.corridor(length), RIG, synthetic.Faults(noise=0.01, **faults))
