"""One type for a frame, whoever made it; its parts are values, or computed once when they are first asked for."""

import ast
import copy
import dataclasses
import pickle
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

import tspslam
from tspslam import Cloud, Frame, InputError, Response, Rig, Session, Surface, build_complex, sample_signals
from tspslam.interop import from_arrays
from tspslam.io import read_frame, write_frame
from tspslam.view import write_pictures

RIG = Rig(fx=9, fy=9, cx=4, cy=4, baseline=0.1, width=9, height=9)
UV = np.array([[1.0, 1], [8, 2], [3, 7]])
COMPLEX = build_complex([[0, 1, 2]], 3)
PARTS = {
    "cloud": Cloud(np.eye(3) + 1, UV, np.ones(3)),
    "surface": Surface(COMPLEX.faces),
    "complex_": COMPLEX,
    "signals": sample_signals(np.eye(9), UV, COMPLEX),
    "response": Response(np.ones(3, complex), 1, np.ones(3, bool)),
}


def frame(**changes):
    return Frame(**({"index": 7, "stamp": 0.5, "name": "seventh", "rig": RIG} | PARTS | changes))


class Counted:
    """A function that counts its calls."""

    def __init__(self, result):
        self.result, self.calls = result, 0

    def __call__(self):
        self.calls += 1
        if isinstance(self.result, Exception):
            raise self.result
        return self.result


@pytest.mark.parametrize("part", PARTS)
def test_a_part_is_a_value_or_a_function_that_gives_it(part):
    lazy = Counted(PARTS[part])
    assert getattr(frame(), part) is PARTS[part]
    given = frame(**{part: lazy})
    assert lazy.calls == 0
    assert getattr(given, part) is getattr(given, part) is PARTS[part]
    assert lazy.calls == 1


def test_a_part_is_computed_once_though_many_threads_ask_at_once():
    lazy, start = Counted(PARTS["cloud"]), Barrier(8)
    given = frame(cloud=lazy)

    def ask(_):
        start.wait()
        return given.cloud

    with ThreadPoolExecutor(8) as pool:
        assert all(cloud is PARTS["cloud"] for cloud in pool.map(ask, range(8)))
    assert lazy.calls == 1


@pytest.mark.parametrize("error", [InputError("nothing to join"), ZeroDivisionError("the user's own")])
def test_what_a_part_raised_is_raised_at_each_ask(error):
    lazy = Counted(error)
    given = frame(surface=lazy)
    for _ in range(3):
        with pytest.raises(type(error), match=str(error)):
            _ = given.surface
    assert lazy.calls == 1


@pytest.mark.parametrize("name", ["index", "image", "landmark", *PARTS])
def test_a_frame_is_frozen(name):
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(frame(), name, None)


def test_a_frame_is_shown_without_computing_it():
    lazy = Counted(COMPLEX)
    given = frame(complex_=lazy, is_keyframe=True)
    assert repr(given) == "Frame(7, 'seventh', 3 points, keyframe)"
    assert lazy.calls == 0
    assert len(given.complex_.edges) == 3
    assert repr(given) == "Frame(7, 'seventh', 3 points, 3 edges, 1 faces, keyframe)"


def test_a_frame_with_another_image_is_the_same_but_for_it():
    image, given = np.zeros((9, 9)), frame(response=Counted(PARTS["response"]))
    changed = dataclasses.replace(given, image=image)
    assert changed.image is image
    assert all(getattr(changed, part) is getattr(given, part) for part in PARTS)


@pytest.mark.parametrize("again", [lambda given: pickle.loads(pickle.dumps(given)), copy.deepcopy])
def test_a_copy_of_a_frame_has_the_values(again):
    class_of_lambdas = frame(cloud=lambda: PARTS["cloud"], quality=lambda: None)  # which have no pickle
    np.testing.assert_array_equal(again(class_of_lambdas).cloud.xyz, PARTS["cloud"].xyz)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"T_world_camera": np.eye(3)}, r"T_world_camera is float64 of shape \(3, 3\), expected \(4, 4\)"),
        ({"T_world_camera": np.full((4, 4), np.nan)}, "expected \\(4, 4\\) finite numbers"),
        ({"T_world_camera": None}, "T_world_camera is NoneType"),
        ({"landmark": np.zeros(3)}, r"landmark is float64 of shape \(3,\), expected \(N,\) whole numbers"),
        ({"landmark": np.zeros((3, 1), int)}, "landmark is int64 of shape"),
        ({"landmark": [1, 2, 3]}, "landmark is list"),
    ],
)
def test_a_pose_or_landmarks_that_are_none_are_named(changes, said):
    with pytest.raises(InputError, match=f"^frame: .*{said}"):
        frame(**changes)


def test_sessions_files_and_meshes_give_the_same_type(motorcycle, tmp_path):
    with Session(motorcycle.rig) as session:
        tracked = session.process(motorcycle)
    write_frame(tmp_path / "frame.npz", tracked)
    stored = read_frame(tmp_path / "frame.npz")
    image = np.random.default_rng(0).random((9, 9))
    mesh = from_arrays([[0, 0, 5], [1, 0, 5], [0, 1, 5.0]], [[0, 1, 2]], image, RIG)
    assert {type(each) for each in (tracked, stored, mesh)} == {Frame}
    assert np.array_equal(tracked.image, motorcycle.left)
    assert np.array_equal(stored.image, motorcycle.left)
    np.testing.assert_array_equal(mesh.response.z, tspslam.tmahf(mesh.complex_, mesh.cloud.uv, mesh.signals, order=1).z)
    with pytest.raises(InputError, match=r"has no image, .* dataclasses.replace\(frame, image=pair.left\)"):
        write_pictures(dataclasses.replace(stored, image=None), tmp_path)


def test_no_other_class_has_the_parts_of_a_frame():
    parts = {"cloud", "surface", "complex_"}
    found = []
    for path in Path(tspslam.__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names = {getattr(each, "name", getattr(getattr(each, "target", None), "id", "")) for each in node.body}
                found += [node.name] if parts <= names else []
    assert found == ["Frame"]


@pytest.mark.parametrize(("part", "said"), [
    ({"cloud": None}, "frame: cloud is NoneType, expected a Cloud"), ({"surface": "abc"}, "frame: surface is the text 'abc'"),
    ({"response": np.zeros(3)}, "frame: response is float64 of shape .3,., expected a Response"),
    ({"rig": None}, "frame: rig is NoneType, expected a Rig"), ({"name": 3}, "frame: name is int, expected text"),
])  # fmt: skip
def test_parts_of_another_kind_are_named(part, said):
    lazy = dict.fromkeys(("cloud", "surface", "complex_", "signals", "response"), lambda: None)
    with pytest.raises(InputError, match=said):
        Frame(**{"index": 0, "stamp": 0.0, "name": "one", "rig": RIG} | lazy | part)


@pytest.mark.parametrize("part", ["cloud", "surface", "signals", "response"])
def test_a_part_that_is_computed_as_something_else_is_named(part, tmp_path):
    frame = Frame(0, 0.0, "one", RIG, **PARTS | {part: lambda: None})
    with pytest.raises(InputError, match=f"frame: {part} is NoneType, expected a {part.capitalize()}"):
        getattr(frame, part)
    with pytest.raises(InputError, match=f"frame: {part} is NoneType"):
        write_frame(tmp_path / "frame.npz", frame)
    assert not (tmp_path / "frame.npz").exists()
