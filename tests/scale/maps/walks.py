"""Runs of pieces of one walk, and of another one, for the tests of joins."""

import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tspslam.datasets import synthetic
from tspslam.io import read_trajectory
from tspslam.run.config import resolve
from tspslam.run.pipeline import run
from tspslam.scale.maps import steps
from tspslam.scale.maps.joining import join_runs
from tspslam.vision.se3 import inverse

from ...sequences import SETTINGS, SMALL_RIG, Kept, corridor

PIECES = {"start": range(7), "middle": range(4, 12), "end": range(10, 18)}
OTHER = range(6)


@dataclass(frozen=True)
class Piece:
    """Some pairs of a sequence, as a recording of its own: no true poses, stamps that begin at 0."""

    whole: Kept
    places: range
    name: str

    rig = SMALL_RIG

    def __len__(self):
        return len(self.places)

    def __getitem__(self, index):
        from dataclasses import replace

        pair = self.whole[self.places[index]]
        return replace(pair, index=index, stamp=0.1 * index, name=f"{index:03d}")


def walk():
    return corridor(9.0, SMALL_RIG)


def elsewhere():
    return Kept(synthetic.corridor(3.5, seed=1), SMALL_RIG, synthetic.Faults(noise=0.01))


def write_runs(folder: Path):
    """A run of each piece, and of another corridor; returns the true poses of the walk."""
    whole, settings = walk(), resolve(assignments=SETTINGS)
    pieces = [Piece(whole, places, name) for name, places in PIECES.items()]
    for piece in (*pieces, Piece(elsewhere(), OTHER, "other")):
        run(piece, folder / piece.name, settings)
    return whole.truth


def error_of(out, truth, *names):
    """Largest distance of a joined path from the true one, from the first camera on, m."""
    true = truth[[k for name in names for k in PIECES[name]]]
    found = read_trajectory(out / "trajectory.tum").T_world_camera
    return float(np.linalg.norm((inverse(true[0]) @ true - found)[:, :3, 3], axis=1).max())


def content(folder):
    """Bytes of every file of a run but what may vary."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != "timings.json")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def without_warnings(folder):
    """The same, but for the files that say what a run warns of."""
    told = "run.json", "report.html", "manifest.jsonl"
    files = {name: data for name, data in content(folder).items() if name not in told}
    record = json.loads((folder / "run.json").read_text())
    return files, {name: value for name, value in record.items() if name not in ("warnings", "status")}


def spied(monkeypatch, kinds):
    """Note the steps that are done."""
    for kind, make in steps._MAKERS.items():

        def noted(*given, kind=kind, make=make):
            kinds.append(kind)
            return make(*given)

        monkeypatch.setitem(steps._MAKERS, kind, noted)


def kill_at_pictures(folders, out):
    """Join runs in a process that is killed while it writes the run."""
    child = os.fork()
    if not child:

        def kill(step):
            if step.stage == "pictures":
                os.kill(os.getpid(), signal.SIGKILL)

        join_runs(folders, out, on_step=kill)
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
