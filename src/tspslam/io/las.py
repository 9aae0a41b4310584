"""LAS 1.4 and LAZ: a cloud with intensity, colours and further columns, as CloudCompare, QGIS and PDAL open it."""

from __future__ import annotations

import datetime
import importlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._files import PathLike, bad_input
from ..errors import InputError
from ..types import FloatArray

QUANTUM = 1e-4
"""Step of the places in a file, m; ten times more, and so on, where a place is beyond 214 km."""
_MOST_STEPS = (1 << 31) - 1  # places are 32-bit whole numbers
_PLAIN, _COLOURED = 6, 7  # point formats of LAS 1.4
_NO_DAY = datetime.date(1980, 1, 1)  # stands for none: equal clouds give equal bytes on any day


def write_las(
    path: PathLike, xyz: FloatArray, intensity: FloatArray, *, rgb: NDArray[np.uint8] | None = None,
    columns: Mapping[str, NDArray[Any]] | None = None,
) -> float:  # fmt: skip
    """Write a cloud as LAS, or where the file's name ends with .laz as LAZ; equal clouds give equal bytes.

    LAS has z up: x is right, y is forward, z is up, in metres, without a place on Earth.

    Parameters
    ----------
    path : str or path
        The file to write.
    xyz : (N, 3) float64
        Places, m; x right, y down, z forward.
    intensity : (N,) float64
        What becomes the 16-bit intensity, in [0, 1]; what is beyond becomes the nearer end.
    rgb : (N, 3) uint8, optional
        Colours, sRGB; 16-bit in the file, 255 being 65535.
    columns : dict of (N,) arrays, optional
        More numbers of each point by name, of at most 32 letters: extra bytes of their own type.

    Returns
    -------
    float
        Step of the places in the file, m: each is within half of it of where it was.

    Raises
    ------
    InputError
        If laspy is not installed, or an array does not fit the places or is not finite.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_las(f"{folder}/a.las", np.eye(3), np.ones(3))
    0.0001
    """
    laspy = _module("laspy")
    is_packed = Path(path).suffix.lower() == ".laz"
    if is_packed:
        _module("lazrs")
    given = {"intensity": intensity, **(columns or {})} | ({} if rgb is None else {"rgb": rgb})
    _check(path, xyz, given)
    step = _step_of(xyz)
    header = laspy.LasHeader(point_format=_PLAIN if rgb is None else _COLOURED, version="1.4")
    header.scales, header.offsets = np.full(3, step), np.zeros(3)
    header.creation_date, header.generating_software, header.system_identifier = _NO_DAY, "tspslam", "stereo cameras"
    header.global_encoding.wkt = True  # as the standard asks of these point formats
    header.add_extra_dims([laspy.ExtraBytesParams(name, each.dtype) for name, each in (columns or {}).items()])
    points = laspy.LasData(header)
    points.X, points.Z, points.Y = (np.rint(values / step).astype(np.int32) for values in (xyz * (1, -1, 1)).T)
    points.intensity = _sixteen_bits(intensity)
    points.return_number = points.number_of_returns = np.ones(len(xyz), np.uint8)
    if rgb is not None:
        points.red, points.green, points.blue = (257 * rgb.astype(np.uint16)).T
    for name, values in (columns or {}).items():
        points[name] = values
    stream = io.BytesIO()
    points.write(stream, do_compress=is_packed)
    write_bytes(path, stream.getvalue())
    return step


def _check(path: PathLike, xyz: FloatArray, given: Mapping[str, NDArray[Any]]) -> None:
    if xyz.shape != (len(xyz), 3):
        raise bad_input(path, f"xyz has shape {xyz.shape}", "(N, 3)")
    for name, values in {"xyz": xyz, **given}.items():
        if len(values) != len(xyz):
            raise bad_input(path, f"{name} has shape {values.shape}", f"one for each of {len(xyz)} points")
        if not np.isfinite(values).all():
            raise bad_input(path, f"{name} holds a value that is not finite", "finite numbers")


def _step_of(xyz: FloatArray) -> float:
    """The smallest of 0.1 mm, 1 mm and so on in which the farthest place is a 32-bit number of steps."""
    farthest, power = float(np.abs(xyz).max(initial=0.0)), 4
    while farthest * 10.0**power > _MOST_STEPS:
        power -= 1
    return float(f"1e{-power}")


def _sixteen_bits(values: FloatArray) -> NDArray[np.uint16]:
    return np.rint(65535 * np.clip(values, 0, 1)).astype(np.uint16)


def _module(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(
            f"{name} is not installed, expected an installation of it: pip install 'tspslam[las]'"
        ) from error
