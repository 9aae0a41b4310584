"""What a person sees of an object at a prompt: a line that says what and how much, never pages of numbers."""

import dataclasses
import importlib
import inspect
import pkgutil
import re

import numpy as np
import pytest

import tspslam
from tspslam import Cloud, Session, datasets
from tspslam._brief import brief
from tspslam.topology.cells import Polygons
from tspslam.topology.hodge import HodgeParts
from tspslam.types import Response

PARTS_OF_SLAM = {"Keyframe", "MapSnapshot", "PoseEstimate", "Tracked"}  # the others are no one's but the odometry's
ARRAYS = re.compile(r"Array|\bImage\b|\bIndex\b|\bPlane\b|Polygons")


def classes():  # that a person meets
    for found in pkgutil.walk_packages(tspslam.__path__, "tspslam."):
        if not found.name.endswith("__main__"):
            for kind in vars(importlib.import_module(found.name)).values():
                if inspect.isclass(kind) and kind.__module__ == found.name and kind.__name__[0] != "_":
                    yield kind


def holds_arrays(kind):
    """Whether it is a data class or a named tuple with a field that is an array, not merely a callable on some."""
    if not (dataclasses.is_dataclass(kind) or hasattr(kind, "_fields")):
        return False
    said = [
        getattr(each, "__forward_arg__", str(each))
        for base in kind.__mro__
        for each in vars(base).get("__annotations__", {}).values()
    ]
    return any(ARRAYS.search(each) and "Callable" not in each for each in said)


def prints_numbers(kind):
    """Whether its line is the one that `dataclass`, or a tuple, makes of all that it holds."""
    if kind.__repr__ is object.__repr__:
        return True
    if dataclasses.is_dataclass(kind):
        return kind.__dataclass_params__.repr
    return "return brief(self)" not in inspect.getsource(kind)


def test_what_holds_arrays_prints_none_of_their_numbers():
    holding = {kind.__qualname__: kind for kind in classes() if holds_arrays(kind)}
    assert {"Cloud", "Complex", "CellComplex", "Boundary", "VtuMesh", *PARTS_OF_SLAM} <= holding.keys()
    wrong = [
        name
        for name, kind in holding.items()
        if prints_numbers(kind) and (".slam." not in kind.__module__ or name in PARTS_OF_SLAM)
    ]
    assert not set(wrong) - {"Stereo"}  # whose parts are such


def test_a_cloud_is_a_line():
    cloud = Cloud(np.zeros((1304, 3)), np.zeros((1304, 2)), np.zeros(1304))
    assert repr(cloud) == (
        "Cloud(xyz=(1304, 3) float64, uv=(1304, 2) float64, disparity=(1304,) float64, covariance=None)"
    )


def test_parts_are_told_by_what_they_are():
    response = Response(np.zeros(3, complex), 2, np.zeros(3, bool))
    assert repr(response) == "Response(z=(3,) complex128, order=2, defined=(3,) bool)"
    polygons = Polygons(np.zeros(3, np.int32), np.zeros(8, np.int32))
    assert repr(polygons) == "Polygons(start=(3,) int32, items=(8,) int32)"
    parts = HodgeParts(*np.zeros((3, 5)))
    assert repr(parts) == "HodgeParts(gradient=(5,) float64, curl=(5,) float64, harmonic=(5,) float64)"

    @dataclasses.dataclass
    class Held:
        few: tuple = (1, 2.5, "x")
        arrays: tuple = (np.zeros(2), np.zeros(2))
        many: tuple = tuple(range(9))
        cloud: object = Cloud(np.zeros((1, 3)), np.zeros((1, 2)), np.zeros(1))
        number: object = np.float64(0.5)

    said = "few=(1, 2.5, 'x'), arrays=tuple of 2, many=tuple of 9, cloud=Cloud(...), number=np.float64(0.5))"
    assert brief(Held()).partition("(")[2] == said


def test_each_step_of_a_walk_prints_a_line(small_pair):
    left, right, rig = small_pair
    pair = tspslam.StereoPair(left, right, rig)
    with Session(rig) as session:
        assert repr(session) == "Session(300 x 200 px, StereoOdometry(0 frames, 0 keyframes, 0 landmarks))"
        frame = session.process(pair)
        odometry = session.odometry
        shown = [pair, frame.cloud, frame.surface, frame.complex_, frame.signals, frame.response, frame.tracked]
        shown += [frame.complex_.boundary, frame.complex_.neighbours(), frame.tracked.stereo.left]
        shown += [session.trajectory, odometry.map.snapshot(), odometry.map.keyframes[0], session]
    for each in shown:
        assert repr(each).startswith(f"{type(each).__name__}(")
        assert "array" not in repr(each)
        assert "\n" not in repr(each)
        assert len(repr(each)) < 600
    assert re.fullmatch(
        r"Session\(.* px, StereoOdometry\(1 frames, 1 keyframes, \d+ landmarks\), closed\)", repr(session)
    )


def test_a_sequence_tells_its_name_and_length(sequence):
    assert repr(datasets.StereoFolder(sequence)) == "StereoFolder('drive', 3 pairs)"
    world = datasets.synthetic.SyntheticSequence(datasets.synthetic.corridor(0.5))
    assert repr(world) == f"SyntheticSequence({world.name!r}, {len(world)} pairs)"


@pytest.mark.parametrize("name", ["EurocSequence", "KittiSequence", "RosbagSequence", "StereoFolder", "UtiasRun"])
def test_no_sequence_is_an_address(name):
    assert getattr(datasets, name).__repr__ is not object.__repr__
