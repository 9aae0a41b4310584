"""Camera paths as text: the TUM, KITTI and EuRoC forms."""

from __future__ import annotations

import os

import numpy as np
from numpy.typing import ArrayLike

from .._atomic import write_bytes
from .._checks import require_path
from .._files import PathLike, bad_input
from ..types import FloatArray, Trajectory
from ._path_text import FORMS, KITTI, TUM, check_rise, read_stamps, read_table

_ORTHONORMAL = 1e-6
_ROTATION = 1e-2  # of a written one: KITTI's have six digits


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


def read_trajectory(path: PathLike, stamps: PathLike | None = None) -> Trajectory:
    """Read a trajectory in TUM's, KITTI's or EuRoC's form.

    TUM's lines are ``stamp tx ty tz qx qy qz qw``, with blanks, tabs or commas between, s and m. KITTI's are the three
    upper rows of a pose. EuRoC's ``data.csv`` has commas, stamps in ns, the place, the quaternion with w first, and
    more that is left out; its poses are those of a sensor, so the camera's are known of a whole sequence folder alone
    (`datasets.open_sequence`). A first line that names the columns tells the order of quaternions, and with [ns] that
    stamps are in ns; without one, a whole number of 16 digits is in ns.

    Parameters
    ----------
    path : str or path
        A run folder, whose ``trajectory.tum`` is read, or text, in UTF-8 or with a byte-order mark; lines that begin
        with # or % are passed over, and in TUM's form blank ones. Rotations are made exact.

    stamps : path, optional
        A text with the stamp of each line of a file in KITTI's form, s; without one, its stamps are the numbers of its
        lines, from 0.

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
    lines, table = read_table(path)
    if table.shape[1] == KITTI:
        times = np.arange(len(table), dtype=np.float64) if stamps is None else _stamps_of(path, stamps, len(table))
        return Trajectory(times, _poses(path, lines, table.reshape(-1, 3, 4)))
    if stamps is not None:
        raise bad_input(path, "has stamps of its own", f"poses in KITTI's form to go with {stamps}")
    check_rise(path, lines, table[:, 0])
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


def _stamps_of(path: PathLike, stamps: PathLike, count: int) -> FloatArray:
    found = read_stamps(stamps)
    if len(found) != count:
        raise bad_input(stamps, f"has {len(found)} stamps", f"{count}, one for each line of {path}")
    return found


def _file_of(path: PathLike) -> PathLike:
    """The file itself, or that of a run folder."""
    require_path(path)
    if not os.path.isdir(path):
        return path
    file = os.path.join(path, "trajectory.tum")
    if not os.path.isfile(file):
        raise bad_input(path, "is a folder without trajectory.tum", f"a run folder that has a path, or {FORMS}")
    return file


def has_stamps(path: PathLike) -> bool:
    """Whether the lines of a trajectory file begin with a stamp, as TUM's and EuRoC's; KITTI's have none.

    Parameters
    ----------
    path : str or path
        As `read_trajectory` takes it; errors too.

    Returns
    -------
    bool
    """
    return read_table(_file_of(path))[1].shape[1] == TUM


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
