"""One image of a COLMAP text model and the points that it observes, to a complex with signals."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, open_input
from ..errors import InputError
from ..topology.complex import build_complex
from ..topology.surface import delaunay_surface
from ..topology.texture import sample_signals
from ..types import Cloud, FloatArray, Image
from .meshes import Textured

_EXPECTED = "COLMAP's text model: cameras.txt, images.txt, points3D.txt"
_TO_CENTRE = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0)


def from_colmap(folder: PathLike, name: str, image: Image, *, max_depth_ratio: float = 0.08) -> Textured:
    """Triangulate the points that one image of a COLMAP model observes, and give them its texture.

    Parameters
    ----------
    folder : path
        Of cameras.txt, images.txt and points3D.txt.
    name : str
        The image's name in images.txt.
    image : (H, W) or (H, W, 3) array
        The image itself, as COLMAP saw it (its distortion, if any, does not matter: observations are used, not
        projections).
    max_depth_ratio : float
        As `tspslam.delaunay_surface`.

    Returns
    -------
    Textured
        Points in the frame of this camera, in the model's unit; their `disparity` is that of a baseline of one unit.

    Raises
    ------
    InputError
        If a file cannot be read, the model has no such image, the image has another size than its camera, or it
        observes fewer than 3 points.

    Notes
    -----
    Format of https://colmap.github.io/format.html. Points behind the camera, and repeated observations of a point, are
    left out.
    """
    root = Path(folder)
    pose, camera, uv, ids = _observations(root / "images.txt", name)
    focal = _focal_length(root / "cameras.txt", camera, image)
    positions = _points(root / "points3D.txt", set(ids.tolist()))
    _, first = np.unique(ids, return_index=True)
    seen = np.array([k for k in np.sort(first) if int(ids[k]) in positions], np.int64)
    world = np.array([positions[int(k)] for k in ids[seen]]).reshape(-1, 3)
    xyz, uv = world @ pose[:, :3].T + pose[:, 3], uv[seen] - _TO_CENTRE
    in_front = xyz[:, 2] > 0
    if in_front.sum() < 3:
        raise bad_input(root, f"image {name} observes {in_front.sum()} points in front of it", "at least 3")
    cloud = Cloud(xyz[in_front], uv[in_front], focal / xyz[in_front, 2])
    surface = delaunay_surface(cloud, max_depth_ratio=max_depth_ratio)
    complex_ = build_complex(surface.faces, len(cloud))
    return Textured(cloud, surface, complex_, sample_signals(image, cloud.uv, complex_))


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line that is no comment; empty lines stay, they mean something in images.txt."""
    with open_input(path, _EXPECTED) as handle:
        for number, line in enumerate(handle, start=1):
            text = line.decode("utf-8", "replace").strip()
            if not text.startswith("#"):
                yield number, text.split()


def _numbers(path: Path, number: int, words: list[str], count: int) -> FloatArray:
    try:
        values = np.array(words, np.float64)
    except ValueError as error:
        raise bad_input(path, f"line {number} holds something that is no number", _EXPECTED) from error
    if len(values) < count or not np.isfinite(values).all():
        raise bad_input(path, f"line {number} has {len(values)} numbers or some that are not finite", _EXPECTED)
    return values


def _observations(path: Path, name: str) -> tuple[FloatArray, str, FloatArray, NDArray[np.int64]]:
    """Pose (3, 4), world to camera; camera; observed pixels (N, 2) and the points (N,) that they show."""
    lines = _lines(path)
    for number, words in lines:
        if len(words) < 10:
            if words:
                raise bad_input(path, f"line {number} has {len(words)} words", _EXPECTED)
            continue
        _, observed = next(lines, (0, []))
        if " ".join(words[9:]) != name:
            continue
        values = _numbers(path, number + 1, observed, 0)
        if len(values) % 3:
            raise bad_input(path, f"line {number + 1} has {len(values)} numbers, not three a point", _EXPECTED)
        triples = values.reshape(-1, 3)
        triples = triples[triples[:, 2] >= 0]
        return _pose(path, number, words), words[8], triples[:, :2], triples[:, 2].astype(np.int64)
    raise bad_input(path, f"has no image {name!r}", "the name of one of its images")


def _pose(path: Path, number: int, words: list[str]) -> FloatArray:
    from scipy.spatial.transform import Rotation

    w, x, y, z, *t = _numbers(path, number, words[1:8], 7)
    if not np.hypot(np.hypot(w, x), np.hypot(y, z)) > 0:
        raise bad_input(path, f"line {number} has a quaternion of 0", _EXPECTED)
    return np.column_stack([Rotation.from_quat([x, y, z, w]).as_matrix(), t])


def _focal_length(path: Path, camera: str, image: Image) -> float:
    for number, words in _lines(path):
        if words and words[0] == camera:
            width, height, focal = _numbers(path, number, words[2:], 3)[:3]
            if np.shape(image)[:2] != (height, width):
                wanted = f"the camera's {height:g} x {width:g}"
                raise InputError(f"image has shape {np.shape(image)}, expected {wanted} of {path}")
            return float(focal)
    raise bad_input(path, f"has no camera {camera}", _EXPECTED)


def _points(path: Path, wanted: set[int]) -> dict[int, FloatArray]:
    """Positions of the wanted points."""
    found = {}
    for number, words in _lines(path):
        if words and words[0].isdigit() and int(words[0]) in wanted:
            found[int(words[0])] = _numbers(path, number, words[1:4], 3)
    return found
