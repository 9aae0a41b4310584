"""Our calibration files: a YAML mapping of plain numbers, for a rectified pair or for two raw cameras."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from dataclasses import fields
from typing import Any

import numpy as np

from ...._files import PathLike, one_line
from ...._yaml import dump_yaml, read_yaml
from ....errors import InputError
from ....types import LENSES, Camera, RawRig, Rig
from ._calibration import Calibration
from ._source import Source
from ._values import Size, agreed_size

Mapping = dict[Any, Any]

_LENS = ("fx", "fy", "cx", "cy")
_SIZE = ("width", "height")
_REQUIRED = (*_LENS, *_SIZE)
_OPTIONAL = ("baseline", "skew", "doffs")
_RAW = ("left", "right", "T_right_left")
_PLAIN_LENS = "brown"
_SAME_BASELINE = 1e-3  # relative


def load_rig(path: PathLike) -> Rig:
    """Read a calibration file of a rectified pair, or of a single camera.

    The file is a YAML mapping of plain numbers: ``fx fy cx cy baseline width height`` and, where they are not 0,
    ``skew`` and ``doffs``. Units: px, and metres for the baseline, which a single camera leaves out.

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Rig

    Raises
    ------
    InputError
        If the file cannot be read, is over 1 MiB, is not such a mapping, or uses tags, anchors or aliases; if a key is
        unknown, missing or twice there; if a value is not a number in its range; or if it describes raw cameras.

    Examples
    --------
    >>> import tempfile
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_cameras(rig, f"{folder}/calib.yaml")
    ...     load_rig(f"{folder}/calib.yaml") == rig
    True
    """
    cameras = load_cameras(path)
    if isinstance(cameras, RawRig):
        raise InputError(f"{path}: describes raw cameras (left, right, T_right_left), expected a rectified pair")
    return cameras


def load_cameras(path: PathLike) -> Rig | RawRig:
    """Read our calibration file of a rectified or a raw pair.

    A raw pair adds to the keys of `load_rig`, which are then the left camera's, ``left: {distortion: [k1, k2, p1, p2,
    k3]}``, ``right: {fx, fy, cx, cy, distortion}``, each with its own ``skew`` if that is not 0, and ``T_right_left``,
    four rows of four numbers; it needs no ``baseline``, and has no ``doffs``. A lens of another model is named, as in
    ``left: {lens: equidistant, distortion: [k1, k2, k3, k4]}``; ``field_of_view``, degrees, is that of the rectified
    image (`RawRig`).

    Parameters
    ----------
    path : str or path
        The file.

    Returns
    -------
    Rig or RawRig

    Raises
    ------
    InputError
        As `load_rig`; also if the baseline is not the length of the translation.

    Examples
    --------
    >>> import tempfile
    >>> eye = ((1.0, 0.0, 0.0, -0.1), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.0))
    >>> camera = Camera(500.0, 500.0, 320.0, 240.0, 640, 480, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_cameras(RawRig(camera, camera, eye), f"{folder}/calib.yaml")
    ...     load_cameras(f"{folder}/calib.yaml").left.distortion[:2]
    (-0.3, 0.1)
    """
    content = read_yaml(path, "a calibration file")
    if not isinstance(content, dict):
        kind = "blank" if content is None else f"a {type(content).__name__}"
        raise InputError(f"{path}: is {kind}, expected a mapping with the keys {', '.join(_REQUIRED)}")
    try:
        return _raw(content) if any(key in content for key in _RAW) else _rectified(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def save_cameras(cameras: Rig | RawRig, path: PathLike) -> None:
    """Write a calibration file that `load_cameras` reads back exactly.

    Parameters
    ----------
    cameras : Rig or RawRig
        The cameras.
    path : str or path
        The file; it is replaced as a whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> rig = Rig(fx=500, fy=500, cx=320, cy=240, baseline=0.1, width=640, height=480)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save_cameras(rig, f"{folder}/calib.yaml")
    """
    from ...._atomic import write_bytes

    if isinstance(cameras, Rig):
        tree = {key: _plain(getattr(cameras, key)) for key in (*_LENS, "baseline", *_SIZE, "skew", "doffs")}
    else:
        left, right = cameras.left, cameras.right
        tree = {key: _plain(getattr(left, key)) for key in (*_LENS, *_SIZE)}
        tree["left"] = _lens_of(left) | {key: _plain(getattr(left, key)) for key in ("skew", "distortion")}
        numbers = {key: _plain(getattr(right, key)) for key in (*_LENS, *_SIZE, "skew", "distortion")}
        tree["right"] = _lens_of(right) | numbers
        tree["T_right_left"] = _plain(cameras.T_right_left)
        if cameras.field_of_view is not None:
            tree["field_of_view"] = _plain(cameras.field_of_view)
    write_bytes(path, dump_yaml(tree).encode("ascii"))


def _lens_of(camera: Camera) -> Mapping:
    """The name of a lens, where it is not the one of a file that names none."""
    return {} if camera.lens == _PLAIN_LENS else {"lens": camera.lens}


def _rectified(content: Mapping) -> Rig:
    _check_keys(content, _REQUIRED, _OPTIONAL)
    return Rig(**{key: _number(key, value) for key, value in content.items()})


def _raw(content: Mapping) -> RawRig:
    _check_keys(content, (*_LENS, *_SIZE, *_RAW), ("baseline", "skew", "field_of_view"))
    left, right = (_part(content, side) for side in ("left", "right"))
    shared = {key: content[key] for key in (*_LENS, *_SIZE, "skew") if key in content}
    left, right = shared | left, {key: content[key] for key in _SIZE} | right
    _check_keys(left, (*_LENS, *_SIZE), ("skew", "lens", "distortion"), "left: ")
    _check_keys(right, (*_LENS, *_SIZE), ("skew", "lens", "distortion"), "right: ")
    field_of_view = _number("field_of_view", content["field_of_view"]) if "field_of_view" in content else None
    rig = RawRig(_camera(left, "left"), _camera(right, "right"), _pose(content["T_right_left"]), field_of_view)
    baseline, length = content.get("baseline"), float(np.linalg.norm(rig.matrix[:3, 3]))
    if baseline is not None and abs(_number("baseline", baseline) - length) > _SAME_BASELINE * length:
        raise InputError(f"baseline is {baseline} m, but T_right_left moves by {length:.6g} m, expected the same")
    return rig


def _part(content: Mapping, side: str) -> Mapping:
    part = content[side]
    if not isinstance(part, dict):
        raise InputError(f"{side} is {_shown(part)}, expected a mapping such as {{distortion: [k1, k2, p1, p2, k3]}}")
    return part


def _camera(values: Mapping, side: str) -> Camera:
    numbers: dict[str, Any] = {
        key: _number(f"{side}.{key}", value) for key, value in values.items() if key not in ("lens", "distortion")
    }
    lens = values.get("lens", _PLAIN_LENS)
    if not isinstance(lens, str) or lens not in LENSES:
        raise InputError(f"{side}.lens is {_shown(lens)}, expected one of {', '.join(LENSES)}")
    try:
        return Camera(**numbers, distortion=_distortion(values, side, lens), lens=lens)
    except InputError as error:
        raise InputError(f"{side} {error}" if str(error).startswith("camera") else str(error)) from error


def _distortion(values: Mapping, side: str, lens: str) -> tuple[float, ...]:
    """The coefficients of a lens; of Brown's, k3 may be left out, or all."""
    names, is_plain = LENSES[lens], lens == _PLAIN_LENS
    given = values.get("distortion", [0.0] * len(names) if is_plain else None)
    lengths = (len(names) - 1, len(names)) if is_plain else (len(names),)
    if not isinstance(given, list) or len(given) not in lengths:
        found = "missing" if given is None else _shown(given)
        raise InputError(f"{side}.distortion is {found}, expected [{', '.join(names)}]")
    return tuple(_number(f"{side}.distortion", value) for value in (*given, 0.0)[: len(names)])


def _pose(rows: Any) -> tuple[Any, ...]:
    if not isinstance(rows, list) or len(rows) != 4 or any(not isinstance(r, list) or len(r) != 4 for r in rows):
        raise InputError(f"T_right_left is {_shown(rows)}, expected four rows of four numbers")
    return tuple(tuple(_number("T_right_left", value) for value in row) for row in rows)


def _check_keys(content: Mapping, required: Iterable[str], optional: Iterable[str], where: str = "") -> None:
    known = (*required, *optional)
    for key in content:
        if key not in known:
            near = difflib.get_close_matches(str(key), known, n=1)
            hint = f"did you mean {near[0]}?" if near else f"expected {', '.join(known)}"
            raise InputError(f"{where}unknown key {one_line(str(key))[:40]!r}; {hint}")
    missing = [key for key in required if key not in content]
    if missing:
        raise InputError(f"{where}lacks {', '.join(missing)}, expected {', '.join(required)}")


def _number(key: str, value: Any) -> Any:
    """A value as `Rig` and `Camera` take it; whether it is in range, they say."""
    is_count = key.rpartition(".")[2] in _SIZE
    wanted = "a whole number" if is_count else "a number"
    if isinstance(value, bool) or not isinstance(value, int if is_count else int | float):
        quotes = " without quotes" if isinstance(value, str) and _reads_as_number(value) else ""
        raise InputError(f"{key} is {_shown(value)}, expected {wanted}{quotes}")
    return value if is_count or abs(value) > 1 << 53 else float(value)


def _shown(value: Any) -> str:
    return one_line(repr(value))[:60]


def _reads_as_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _plain(value: Any) -> Any:
    """NumPy's numbers as Python's, tuples as lists."""
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return value.item() if isinstance(value, np.generic) else value


KIND = "tspslam calibration file"
_KEYS = ("fx", "fy", "cx", "cy", "baseline", "left", "right", "T_right_left")


def is_own(source: Source) -> bool:
    """Tell whether a mapping has keys of our files.

    Parameters
    ----------
    source : Source
        A file that was read.

    Returns
    -------
    bool
    """
    return any(key in source for key in _KEYS)


def read_own(source: Source, size: Size | None = None) -> Calibration:
    """Read the file anew, as our own.

    Parameters
    ----------
    source : Source
        A file that was read, and is known as ours.
    size : (width, height), optional
        Of the images, px, which the file must agree with.

    Returns
    -------
    Calibration
    """
    cameras = load_cameras(source.path)
    camera = cameras if isinstance(cameras, Rig) else cameras.left
    agreed_size(source, {"width": (camera.width, "width"), "height": (camera.height, "height")}, size)
    return Calibration(cameras, KIND, _origin(source, cameras))


def _origin(source: Source, cameras: Rig | RawRig) -> dict[str, str]:
    if isinstance(cameras, Rig):
        return {field.name: field.name for field in fields(Rig) if field.name in source}
    origin = {key: key for key in ("T_right_left", "field_of_view") if key in source}
    for side, camera in (("left", cameras.left), ("right", cameras.right)):
        part = source.part(side)
        for field in (each.name for each in fields(Camera) if each.name != "distortion"):
            if field in part or field in source:
                origin[f"{side}.{field}"] = part.label(field) if field in part else field
        for k, name in enumerate(LENSES[camera.lens][: len(part.values.get("distortion", ()))]):
            origin[f"{side}.{name}"] = f"{part.label('distortion')}[{k}]"
    return origin
