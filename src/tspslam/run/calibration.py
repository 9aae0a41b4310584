"""``tspslam calib convert``: a calibration file in our format or in that of another program."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from .._atomic import write_bytes
from ..errors import InputError
from ..io._export_folder import fill_folder
from ..types import RawRig
from ..vision.calibration.formats.own import save_cameras
from ..vision.calibration.formats.writers import OURS, TARGETS, calibration_files
from ..vision.calibration.show import Size, converted
from .guard import CALIBRATION, Kind, check_new_folder, check_output

FORMATS = (OURS, *TARGETS)
_KINDS = {
    "kalibr": Kind("camera chain of Kalibr", (".yaml", ".yml"), rb"cam0:\s"),
    "opencv": Kind("FileStorage of OpenCV", (".yaml", ".yml"), rb"%YAML:1\.0\s"),
}


def convert(
    file: Path,
    output: Path,
    to: str = OURS,
    *,
    size: Size | None = None,
    rectify: bool = False,
    field_of_view: float | None = None,
    is_forced: bool = False,
) -> list[str]:
    """Write a calibration file in another format, and return remarks on it.

    Parameters
    ----------
    file : path
        As `read_calibration` takes it.
    output : path
        The file to write; for ``ros`` and ``colmap``, which have several, the folder.
    to : str
        One of `FORMATS`.
    size : (width, height), optional
        Of the images, px.
    rectify : bool
        Whether to write the rectified pair in place of raw cameras.
    field_of_view : float, optional
        Across the rectified image, degrees, for our own file of raw cameras.
    is_forced : bool
        Whether a file of another kind, or an earlier folder of this one, may be replaced.

    Returns
    -------
    list of str

    Raises
    ------
    InputError
        If the file cannot be understood, the format cannot hold its cameras, or the output may not be written.
    OutputError
        If it cannot be written.
    """
    is_folder = to in TARGETS and TARGETS[to].is_folder
    if is_folder:
        check_new_folder(output, to, [file], is_forced=is_forced)
    else:
        check_output(output, _KINDS.get(to, CALIBRATION), [file], is_forced=is_forced)
    cameras, remarks = converted(file, size, rectify)
    if field_of_view is not None:
        if not isinstance(cameras, RawRig):
            raise InputError(f"{file}: a field of view is for raw cameras, which are rectified, expected such")
        cameras = replace(cameras, field_of_view=field_of_view)
    if to == OURS:
        save_cameras(cameras, output)
        return remarks
    if isinstance(cameras, RawRig) and cameras.field_of_view is not None:
        remarks = [*remarks, f"the field of view is not written for {to}, only in ours"]
    try:
        texts = calibration_files(cameras, to)
    except InputError as error:
        raise InputError(f"{file}: {error}") from error
    if is_folder:
        with fill_folder(output, to, is_forced=is_forced) as folder:
            for name, text in texts.items():
                write_bytes(folder / name, text.encode("ascii"))
    else:
        write_bytes(output, next(iter(texts.values())).encode("ascii"))
    return remarks
