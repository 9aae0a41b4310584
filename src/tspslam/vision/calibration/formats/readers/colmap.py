"""COLMAP's rigs: cameras and rigs of a model, text or binary, or a ``rig_config.json``."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ....._files import PathLike, bad_input, read_bytes
from ....._text import is_comment, is_whole, read_text
from ....._yaml import LARGEST_FILE
from .....types import FloatArray
from .._calibration import Calibration, raw
from .._source import Source, plain_value
from .._values import Found, Size, agreed_size, checked, inverse, motion, size_from_list, turned, with_lens

KIND, KIND_OF_CONFIG = "COLMAP rig", "COLMAP rig_config.json"
PLACES = ("rigs.txt", "rigs.bin", "rig_config.json")
"""Names of a rig's file in a folder."""
EXPECTED = "COLMAP's cameras and rigs (cameras.txt and rigs.txt, or .bin)"
MODELS: dict[str, tuple[str, str]] = {
    "SIMPLE_PINHOLE": ("brown", "f cx cy"),
    "PINHOLE": ("brown", "fx fy cx cy"),
    "SIMPLE_RADIAL": ("brown", "f cx cy k1"),
    "RADIAL": ("brown", "f cx cy k1 k2"),
    "OPENCV": ("brown", "fx fy cx cy k1 k2 p1 p2"),
    "OPENCV_FISHEYE": ("equidistant", "fx fy cx cy k1 k2 k3 k4"),
    "FULL_OPENCV": ("rational", "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6"),
    "FOV": ("", "fx fy cx cy omega"),
    "SIMPLE_RADIAL_FISHEYE": ("equidistant", "f cx cy k1"),
    "RADIAL_FISHEYE": ("equidistant", "f cx cy k1 k2"),
    "THIN_PRISM_FISHEYE": ("", "fx fy cx cy k1 k2 p1 p2 k3 k4 sx1 sy1"),
}
"""For each model of COLMAP's, in the order of its numbers: the lens, empty where we have none, and its parameters."""
TO_CENTRE = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0)
_RIG = re.compile(r"^[ \t]*[0-9]+ +[0-9]+ +(?:CAMERA|IMU) +[0-9]+", re.MULTILINE)
_CAMERA = re.compile(r"^[ \t]*[0-9]+ +[A-Z][A-Z_0-9]{2,} +[0-9]+ +[0-9]+ ", re.MULTILINE)
_IS_CAMERA = 0  # type of a sensor in a binary file


@dataclass
class _Sensor:
    """A camera of a rig, and its pose: quaternion w x y z and translation, None for the one of reference."""

    camera: str
    pose: list[Any] | None


def is_colmap(text: str) -> bool:
    """Tell whether a text is COLMAP's list of cameras or of rigs.

    Parameters
    ----------
    text : str
        Of a file.

    Returns
    -------
    bool
    """
    return bool(_RIG.search(text) or _CAMERA.search(text))


def is_rig_config(source: Source) -> bool:
    """Tell whether a mapping is of a list that a ``rig_config.json`` holds.

    Parameters
    ----------
    source : Source
        A file that was read; what is a list in it stands under the key ``rigs``.

    Returns
    -------
    bool
    """
    rigs = source.values.get("rigs")
    return isinstance(rigs, list) and bool(rigs) and isinstance(rigs[0], dict) and "cameras" in rigs[0]


def read_colmap(path: PathLike, size: Size | None = None) -> Calibration:
    r"""Read the first rig of two cameras or more of a model; of these, the reference and the first other one.

    Which is left, their places tell. The model's unit is taken as metres.

    Parameters
    ----------
    path : str or path
        The file of the rigs or of the cameras, ``.txt`` or ``.bin``; the other is beside it.
    size : (width, height), optional
        Of the images, px; it must be the file's.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If a file is missing or damaged, no rig has two cameras with a pose, or a lens is not known.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     done = Path(folder, "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320.5 240.5\n")
    ...     done = Path(folder, "rigs.txt").write_text("1 2 CAMERA 1 CAMERA 1 1 1 0 0 0 -0.1 0 0\n")
    ...     read_colmap(f"{folder}/rigs.txt").cameras.T_right_left[0]
    (1.0, 0.0, 0.0, -0.1)
    """
    suffix = Path(path).suffix
    cameras, rigs = (Path(path).with_name(f"{name}{suffix}") for name in ("cameras", "rigs"))
    if suffix == ".bin":
        known, found = _binary_cameras(cameras), _binary_rigs(rigs)
    else:
        known, found = _text_cameras(cameras), _text_rigs(rigs)
    chosen = [rig for rig in found if len(rig) > 1 and rig[1].pose is not None]
    if not chosen:
        raise bad_input(rigs, "has no rig of two cameras with a pose", EXPECTED)
    source = Source(rigs, known)
    return _paired(source, chosen[0], len(chosen), size)


def read_rig_config(source: Source, size: Size | None = None) -> Calibration:
    """Read the first rig of a ``rig_config.json``; which of its cameras is left, their places tell.

    Parameters
    ----------
    source : Source
        The file, its list under the key ``rigs``.
    size : (width, height), optional
        Of the images, px, which the file has not.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If there are not two cameras with their lenses and a pose, or no image size is given.
    """
    config = Source(source.path, source.values["rigs"][0])
    listed = config.value("cameras", "a list of two cameras")
    if not isinstance(listed, list) or len(listed) < 2 or not all(isinstance(each, dict) for each in listed):
        raise config.wrong("cameras", listed, "a list of two cameras")
    if not any(each.get("ref_sensor") is True for each in listed):
        raise config.error("cameras has none with ref_sensor true, expected one")
    values: dict[Any, Any] = {}
    rig = []
    for at, each in enumerate(sorted(listed, key=lambda each: each.get("ref_sensor") is not True)):
        part = Source(source.path, each, f"cameras[{at}].")
        pose = None
        if at > 0:
            pose = [*part.vector("cam_from_rig_rotation", 4), *part.vector("cam_from_rig_translation", 3)]
        model = part.text("camera_model_name", "the name of a lens of COLMAP")
        values[str(at)] = [model, None, *_listed(part, "camera_params")]
        rig.append(_Sensor(str(at), pose))
    return _paired(Source(source.path, values), rig, len(source.values["rigs"]), size, KIND_OF_CONFIG)


def _listed(part: Source, key: str) -> list[Any]:
    values = part.value(key, "a list of numbers")
    if not isinstance(values, list):
        raise part.wrong(key, values, "a list of numbers")
    return values


def _paired(source: Source, rig: list[_Sensor], count: int, size: Size | None, kind: str = KIND) -> Calibration:
    """The reference and the first other camera as left and right; the right one is where x is positive."""
    sides = [_camera(source, sensor.camera, size) for sensor in rig[:2]]
    T = _pose(source, rig[1]) @ inverse(_pose(source, rig[0]))
    origin = f"pose of camera {rig[1].camera}"
    if -(T[:3, :3].T @ T[:3, 3])[0] < 0:
        sides, T, origin = sides[::-1], inverse(T), f"inverse of the {origin}"
    remarks = ["the unit of the poses is taken as metres: a model that was not scaled has another"]
    if count > 1 or len(rig) > 2:
        remarks.append("the first rig and its first two cameras are read, no others")
    return raw(source, (sides[0], sides[1]), (T, origin), kind, tuple(remarks))


def _pose(source: Source, sensor: _Sensor) -> FloatArray:
    if sensor.pose is None:
        return np.eye(4)
    key = f"pose of camera {sensor.camera}"
    values = Source(source.path, {key: sensor.pose}).vector(key, 7)
    return motion(turned(source, key, values[:4]), values[4:])


def _camera(source: Source, name: str, size: Size | None) -> Found:
    """Values of a camera: its model, its size if the file tells one, its parameters."""
    if name not in source:
        raise source.error(f"names camera {name}, expected one of cameras.txt or cameras.bin")
    model, pixels, *values = source.values[name]
    lens, names = MODELS.get(model, ("", ""))
    if not lens:
        known = ", ".join(each for each, (lens, _) in MODELS.items() if lens)
        raise source.error(f"camera {name} is of the model {model[:40]!r}, expected one of {known}")
    key = f"camera {name} {model}"
    params = Source(source.path, {key: values}).vector(key, len(names.split()))
    found: Found = {}
    for k, (field, value) in enumerate(zip(names.split(), params, strict=True)):
        for each in ("fx", "fy") if field == "f" else (field,):
            shifted = value - TO_CENTRE if each in ("cx", "cy") else value
            found[each] = shifted, f"{key}[{k}]" + (" - 0.5" if each in ("cx", "cy") else "")
    if lens == "rational" and not any(found[each][0] for each in ("k4", "k5", "k6")):
        lens = "brown"
        found = {each: value for each, value in found.items() if each not in ("k4", "k5", "k6")}
    own = None
    if pixels is not None:
        sized = f"size of camera {name}"
        own = size_from_list(Source(source.path, {sized: pixels}), sized)
    return checked(source, with_lens(found, lens, key)) | agreed_size(source, own, size)


def _lines(path: Path) -> list[tuple[int, list[str]]]:
    text = read_text(path, EXPECTED, LARGEST_FILE)
    lines = [(number, line.split()) for number, line in enumerate(text.split("\n"), 1) if not is_comment(line)]
    return [(number, words) for number, words in lines if words]


def _text_cameras(path: Path) -> dict[Any, Any]:
    found: dict[Any, Any] = {}
    for number, words in _lines(path):
        if len(words) < 5 or not is_whole(words[0], 20):
            raise bad_input(path, f"line {number} is no camera", "id, model, width, height, parameters")
        found[words[0]] = [words[1], [plain_value(word) for word in words[2:4]], *map(plain_value, words[4:])]
    return found


def _text_rigs(path: Path) -> list[list[_Sensor]]:
    return [_text_rig(path, number, words) for number, words in _lines(path)]


def _text_rig(path: Path, number: int, words: list[str]) -> list[_Sensor]:
    """The cameras of a line: id, count, type and id of the reference, then type, id, 0 or 1 and pose of each other."""
    rig = [_Sensor(words[3], None)] if len(words) > 3 and words[2] == "CAMERA" else []
    at = 4
    while at + 2 < len(words):
        has_pose = words[at + 2] == "1"
        pose = words[at + 3 : at + 10] if has_pose else None
        if pose is not None and len(pose) < 7:
            raise bad_input(path, f"line {number} ends within a pose", EXPECTED)
        if words[at] == "CAMERA" and pose is not None:
            rig.append(_Sensor(words[at + 1], [plain_value(word) for word in pose]))
        at += 10 if has_pose else 3
    return rig


class _Bytes:
    """A binary file, read number by number; never past its end."""

    def __init__(self, path: Path) -> None:
        self.path, self.at = path, 0
        self.data = read_bytes(path, EXPECTED, LARGEST_FILE)

    def take(self, form: str) -> tuple[Any, ...]:
        end = self.at + struct.calcsize(f"<{form}")
        if end > len(self.data):
            raise bad_input(self.path, f"ends at byte {len(self.data)}, within a record", EXPECTED)
        values = struct.unpack_from(f"<{form}", self.data, self.at)
        self.at = end
        return values


def _binary_cameras(path: Path) -> dict[Any, Any]:
    reader, names = _Bytes(path), list(MODELS)
    found: dict[Any, Any] = {}
    for _ in range(reader.take("Q")[0]):
        number, model, width, height = reader.take("IiQQ")
        if not 0 <= model < len(names):
            raise bad_input(path, f"camera {number} is of the model {model}", f"0 to {len(names) - 1}")
        count = len(MODELS[names[model]][1].split())
        found[str(number)] = [names[model], [width, height], *reader.take(f"{count}d")]
    return found


def _binary_rigs(path: Path) -> list[list[_Sensor]]:
    reader = _Bytes(path)
    return [_binary_rig(reader) for _ in range(reader.take("Q")[0])]


def _binary_rig(reader: _Bytes) -> list[_Sensor]:
    _, count = reader.take("II")
    rig = []
    for at in range(count):
        kind, number = reader.take("iI")
        pose = list(reader.take("7d")) if at > 0 and reader.take("B")[0] else None
        if kind == _IS_CAMERA and (at == 0 or pose is not None):
            rig.append(_Sensor(str(number), pose))
    return rig
