"""Synthetic sequences: each pair rendered once, and written as folders."""

from PIL import Image

from tspslam import Rig
from tspslam.datasets import synthetic
from tspslam.vision.calibration.formats.own import save_cameras
from tspslam.vision.features.orb import OrbDetector

RIG = synthetic.PAPER_RIG
SMALL_RIG = Rig(RIG.fx / 2, RIG.fy / 2, RIG.cx / 2, RIG.cy / 2, RIG.baseline, RIG.width // 2, RIG.height // 2)
DETECTOR = OrbDetector(count=800)
SETTINGS = ["detector.count=800"]


class Kept(synthetic.SyntheticSequence):
    """A sequence that keeps its pairs: to render one takes five times as long as to track it."""

    def __init__(self, *given, **options):
        super().__init__(*given, **options)
        self._pairs = {}

    def __getitem__(self, index):
        if index not in self._pairs:
            self._pairs[index] = super().__getitem__(index)
        return self._pairs[index]


def write_sequence(folder, sequence):
    """Left and right images and the calibration of a sequence; returns the folder."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    for k, pair in enumerate(sequence):
        for side in ("left", "right"):
            Image.fromarray(getattr(pair, side)).save(folder / side / f"{k:03d}.png", compress_level=1)
    save_cameras(sequence.rig, folder / "calib.yaml")
    return folder


def corridor(length, rig=RIG, **faults):
    return Kept(synthetic.corridor(length), rig, synthetic.Faults(**({"noise": 0.01} | faults)))
