"""A triangle mesh from any file that we read, told by its suffix."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, read_bytes
from ..errors import InputError
from ..types import FloatArray
from .frames import read_frame
from .ply import read_ply
from .vtu import read_vtu

_EXPECTED = "a triangle mesh in .ply, .vtu, .obj, or a frame's .npz"


def read_mesh(path: PathLike) -> tuple[FloatArray, NDArray[np.int32]]:
    r"""Read positions and triangles from a .ply, .vtu or .obj file, or a stored frame (.npz).

    Parameters
    ----------
    path : str or path
        The file; its suffix, in any case, tells the format.

    Returns
    -------
    xyz : (N, 3) float64
        Positions, m.
    faces : (F, 3) int32
        Triangles, winding kept.

    Raises
    ------
    InputError
        If the suffix is another, or the file is not a sound triangle mesh.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, "a.obj").write_text("v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n")
    ...     xyz, faces = read_mesh(f"{folder}/a.obj")
    >>> faces.tolist()
    [[0, 1, 2]]
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        ply = read_ply(path)
        return ply.xyz, ply.faces
    if suffix == ".vtu":
        vtu = read_vtu(path)
        return vtu.xyz, vtu.faces
    if suffix == ".npz":
        frame = read_frame(path)
        return frame.cloud.xyz, frame.surface.faces
    if suffix == ".obj":
        return _read_obj(path)
    raise bad_input(path, f"has the suffix {suffix!r}", _EXPECTED)


def _read_obj(path: PathLike) -> tuple[FloatArray, NDArray[np.int32]]:
    vertices: list[list[float]] = []
    faces: list[list[int]] = []
    for number, line in enumerate(read_bytes(path, _EXPECTED).split(b"\n"), start=1):
        words = line.split(b"#", 1)[0].split()
        try:
            if words and words[0] == b"v":
                vertices.append(_position(words))
            elif words and words[0] == b"f":
                faces.append(_triangle(words, len(vertices)))
        except ValueError as error:
            raise bad_input(path, f"line {number} holds a word that is no number", _EXPECTED) from error
        except InputError as error:
            raise bad_input(path, f"line {number} {error}", _EXPECTED) from error
    if not vertices:
        raise bad_input(path, "has no vertices", _EXPECTED)
    triangles = np.array(faces, np.int64).reshape(-1, 3)
    bad = np.flatnonzero(((triangles < 0) | (triangles >= len(vertices))).any(axis=1))
    if bad.size:
        reason = f"face {bad[0]} has corners {(triangles[bad[0]] + 1).tolist()} of {len(vertices)} vertices"
        raise bad_input(path, reason, _EXPECTED)
    return np.array(vertices, np.float64), triangles.astype(np.int32)


def _position(words: list[bytes]) -> list[float]:
    position = [float(word) for word in words[1:4]]
    if len(position) < 3 or not np.isfinite(position).all():
        raise InputError("has no three finite coordinates")
    return position


def _triangle(words: list[bytes], n: int) -> list[int]:
    if len(words) != 4:
        raise InputError(f"has a face of {len(words) - 1} corners, where 3 go")
    corners = [int(word.split(b"/", 1)[0]) for word in words[1:]]
    if not all(0 < abs(corner) < 1 << 31 for corner in corners):
        raise InputError("has a corner that counts neither from the first vertex nor from the last")
    return [corner - 1 if corner > 0 else n + corner for corner in corners]
