"""Camera paths as text: the TUM and KITTI forms."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from .._atomic import write_bytes
from .._checks import require_path
from .._files import PathLike, bad_input
from .._text import numbers, read_lines, split
from ..types import FloatArray, Trajectory

_ORTHONORMAL = 1e-6
_ROTATION = 1e-2  # of a written one: KITTI's have six digits
_LARGEST_TEXT = 1 << 28  # bytes
_TUM, _KITTI = 8, 12  # values in a line
_FORMS = "lines of 8 numbers (TUM: stamp tx ty tz qx qy qz qw) or of 12 (KITTI: three rows of a pose)"


def write_tum(path: PathLike, stamp: ArrayLike, T_world_camera: ArrayLike) -> None:
    r"""Write a trajectory in TUM's form: ``stamp tx ty tz qx qy qz qw`` a line, with qw >= 0.

    Parameters
    ----------
    path : str or path
        The file to write.
    stamp : (T,) float array
        Times, s.
    T_world_camera : (T, 4, 4) float array
        Poses, camera to world, m.

    Raises
    ------
    InputError
        If shapes do not fit, a value is not finite, or a matrix is not a rigid motion.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_tum(f"{folder}/a.tum", [0.5], np.eye(4)[None])
    ...     Path(folder, "a.tum").read_text()
    '0.5 0.0 0.0 0.0 0.0 0.0 0.0 1.0\n'
    """
    times, poses = _checked(path, stamp, T_world_camera)
    table = np.column_stack([times, poses[:, :3, 3], quaternions(poses[:, :3, :3])])
    write_bytes(path, _text(table))


def write_kitti(path: PathLike, T_world_camera: ArrayLike) -> None:
    r"""Write a trajectory in KITTI's form: the upper three rows of each pose, row by row, a pose a line.

    Parameters
    ----------
    path : str or path
        The file to write.
    T_world_camera : (T, 4, 4) float array
        Poses, camera to world, m.

    Raises
    ------
    InputError
        If the shape does not fit, a value is not finite, or a matrix is not a rigid motion.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_kitti(f"{folder}/a.txt", np.eye(4)[None])
    ...     Path(folder, "a.txt").read_text()
    '1.0 0.0 0.0 0.0 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0\n'
    """
    _, poses = _checked(path, np.zeros(np.shape(T_world_camera)[:1]), T_world_camera)
    write_bytes(path, _text(poses[:, :3].reshape(-1, 12)))


def read_trajectory(path: PathLike) -> Trajectory:
    """Read a trajectory in TUM's or KITTI's form; KITTI's has no stamps, so they are the numbers of its lines, from 0.

    Parameters
    ----------
    path : str or path
        A run folder, whose ``trajectory.tum`` is read, or text, in UTF-8 or with a byte-order mark; lines that begin
        with # or % are passed over, and in TUM's form blank ones. Rotations are made exact.

    Returns
    -------
    Trajectory
        In the order of the file. A pose that the file leaves unknown is NaN: a row that holds NaN, and in KITTI's
        form a blank line before the last, which stands for a frame as any other.

    Raises
    ------
    InputError
        If the file cannot be read, has another number of values in a line, an infinite value, no pose that is known,
        a quaternion that is not of length 1 or a matrix that is no rotation (to 1e-2), or stamps that do not increase.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_tum(f"{folder}/a.tum", [0.5, 0.6], np.tile(np.eye(4), (2, 1, 1)))
    ...     read_trajectory(f"{folder}/a.tum").stamp.tolist()
    [0.5, 0.6]
    """
    path = _file_of(path)
    lines, table = _table(path)
    if table.shape[1] == _KITTI:
        return Trajectory(np.arange(len(table), dtype=np.float64), _poses(path, lines, table.reshape(-1, 3, 4)))
    _check_stamps(path, lines, table[:, 0])
    x, y, z, w = table[:, 4:].T
    length = np.sqrt(x * x + y * y + z * z + w * w)
    wrong = np.abs(length - 1) > _ROTATION
    if wrong.any():
        k = int(np.argmax(wrong))
        raise bad_input(path, f"line {lines[k]} has a quaternion that is not of length 1, but {length[k]:.6g}", "1")
    R = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    ).transpose(2, 0, 1)
    return Trajectory(table[:, 0], _poses(path, lines, np.concatenate([R, table[:, 1:4, None]], axis=2)))


def _file_of(path: PathLike) -> PathLike:
    """The file itself, or that of a run folder."""
    require_path(path)
    if not os.path.isdir(path):
        return path
    file = os.path.join(path, "trajectory.tum")
    if not os.path.isfile(file):
        raise bad_input(path, "is a folder without trajectory.tum", f"a run folder that has a path, or {_FORMS}")
    return file


def has_stamps(path: PathLike) -> bool:
    """Whether a trajectory file is in TUM's form, whose lines begin with a stamp; KITTI's has none.

    Parameters
    ----------
    path : str or path
        As `read_trajectory` takes it; errors too.

    Returns
    -------
    bool
    """
    return _table(_file_of(path))[1].shape[1] == _TUM


def _table(path: PathLike) -> tuple[list[int], FloatArray]:
    """Numbers of the lines of a text file, and their values, (n, 8) or (n, 12): NaN all through where one is."""
    rows: list[list[float]] = []
    at: list[int] = []
    blank: list[int] = []
    for line in read_lines(path, _FORMS, _LARGEST_TEXT):
        if not line[1]:
            blank.append(line[0])
            continue
        count = len(rows[0]) if rows else 0
        rows.append(numbers(path, line, split(path, line, _FORMS, (count or _TUM, count or _KITTI)), _FORMS))
        at.append(line[0])
    if not rows:
        raise bad_input(path, "has no line of values", _FORMS)
    return _checked_table(path, at, np.array(rows), blank)


def _checked_table(
    path: PathLike, lines: list[int], table: FloatArray, blank: list[int]
) -> tuple[list[int], FloatArray]:
    """Refuse what is infinite or all unknown; in KITTI's form blank lines become rows."""
    has_stamp = table.shape[1] == _TUM
    bad = np.flatnonzero(np.isinf(table).any(axis=1) | (np.isnan(table[:, 0]) & has_stamp))
    if bad.size:
        raise bad_input(path, f"line {lines[bad[0]]} has a value that is not finite", _FORMS)
    unknown = np.isnan(table).any(axis=1)
    if unknown.all():
        raise bad_input(
            path, f"has no pose that is known: a value of each line is not finite ({len(table)} x NaN)", _FORMS
        )
    table[unknown, int(has_stamp) :] = np.nan
    if has_stamp:
        return lines, table
    # Line k is for frame k: a blank one is a frame of which nothing is known, unless nothing follows it.
    inner = [number for number in blank if number < lines[-1]]
    order = np.argsort([*lines, *inner], kind="stable")
    whole = np.concatenate([table, np.full((len(inner), _KITTI), np.nan)])
    return [[*lines, *inner][k] for k in order], whole[order]


def _check_stamps(path: PathLike, lines: list[int], stamps: FloatArray) -> None:
    falls = np.diff(stamps) <= 0
    if falls.any():
        k = int(np.argmax(falls))
        said = f"line {lines[k + 1]}: stamp {k + 2} is {stamps[k + 1]:.9f}, that before it {stamps[k]:.9f}"
        raise bad_input(path, said, "a rise")


def _poses(path: PathLike, lines: list[int], rows: FloatArray) -> FloatArray:
    """(n, 4, 4) motions of (n, 3, 4) rows, their rotations made exact; NaN where a row is."""
    known = np.flatnonzero(~np.isnan(rows[:, 0, 0]))
    U, size, Vt = np.linalg.svd(rows[known, :, :3])
    off = np.abs(size - 1).max(axis=1)
    bad = np.flatnonzero((off > _ROTATION) | (np.linalg.det(rows[known, :, :3]) < 0))
    if bad.size:
        said = f"line {lines[known[bad[0]]]} holds no rotation (off by {off[bad[0]]:.2g})"
        raise bad_input(path, said, "one to 1e-2")
    poses = np.full((len(rows), 4, 4), np.nan)
    poses[known] = np.eye(4)
    poses[known, :3, :3], poses[known, :3, 3] = U @ Vt, rows[known, :, 3]
    return poses


def quaternions(R: FloatArray) -> FloatArray:
    """Return unit quaternions (x, y, z, w), w >= 0, of rotation matrices.

    Each is the largest column of 4qqᵀ, which the matrix gives without a branch that loses digits.

    Parameters
    ----------
    R : (T, 3, 3) float64
        Rotations.

    Returns
    -------
    (T, 4) float64
        The quaternions.

    Examples
    --------
    >>> quaternions(np.diag([1.0, -1.0, -1.0])[None]).tolist()
    [[1.0, 0.0, 0.0, 0.0]]
    """
    xx, yy, zz = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    xy, xz, yz = R[:, 0, 1] + R[:, 1, 0], R[:, 0, 2] + R[:, 2, 0], R[:, 1, 2] + R[:, 2, 1]
    xw, yw, zw = R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]
    outer = np.array(
        [
            [1 + xx - yy - zz, xy, xz, xw],
            [xy, 1 - xx + yy - zz, yz, yw],
            [xz, yz, 1 - xx - yy + zz, zw],
            [xw, yw, zw, 1 + xx + yy + zz],
        ]
    ).transpose(2, 0, 1)
    largest = np.argmax(np.diagonal(outer, axis1=1, axis2=2), axis=1)
    q = outer[np.arange(len(R)), largest]
    q = q / np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(q[:, 3:] < 0, -q, q) + 0.0


def _checked(path: PathLike, stamp: ArrayLike, T_world_camera: ArrayLike) -> tuple[FloatArray, FloatArray]:
    times, poses = np.asarray(stamp, np.float64), np.asarray(T_world_camera, np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or times.shape != poses.shape[:1]:
        raise bad_input(path, f"stamp has shape {times.shape}, T_world_camera {poses.shape}", "(T,) and (T, 4, 4)")
    if not (np.isfinite(times).all() and np.isfinite(poses).all()):
        raise bad_input(path, "the trajectory holds a value that is not finite", "finite numbers")
    R = poses[:, :3, :3]
    error = np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2), initial=0.0)
    bad = np.flatnonzero((error > _ORTHONORMAL) | (np.linalg.det(R) < 0) | (poses[:, 3] != [0, 0, 0, 1]).any(axis=1))
    if bad.size:
        raise bad_input(path, f"pose {bad[0]} is not a rigid motion", "rotations, and 0 0 0 1 in the last row")
    return times, poses


def _text(table: FloatArray) -> bytes:
    # Adding 0 turns -0 into 0; repr gives the shortest text that reads back exactly.
    return "".join(" ".join(map(repr, row)) + "\n" for row in (table + 0.0).tolist()).encode("ascii")
