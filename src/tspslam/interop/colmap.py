"""One image of a COLMAP text model and the points that it observes, to a complex with signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input
from .._text import Line, is_whole, numbers, read_lines, separators_of
from ..errors import InputError
from ..topology.complex import build_complex
from ..topology.surface import delaunay_surface
from ..topology.texture import sample_signals
from ..types import Cloud, FloatArray, Image
from .meshes import Textured

_EXPECTED = "COLMAP's text model: cameras.txt, images.txt, points3D.txt"
_LARGEST_ID = 1 << 53  # of a point: larger ones are no whole numbers as floats
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


def _numbers(path: Path, line: Line, words: list[str], count: int) -> FloatArray:
    values = np.array(numbers(path, line, words, _EXPECTED), np.float64)
    if len(values) < count:
        raise bad_input(path, f"line {line[0]} has {len(values)} numbers, where {count} go", _EXPECTED)
    if not np.isfinite(values).all():
        raise bad_input(path, f"line {line[0]} has a number that is not finite", _EXPECTED)
    return values


def _observations(path: Path, name: str) -> tuple[FloatArray, str, FloatArray, NDArray[np.int64]]:
    """Pose (3, 4), world to camera; camera; observed pixels (N, 2) and the points (N,) that they show."""
    lines = read_lines(path, _EXPECTED)
    for line in lines:
        words = line[1].split(maxsplit=9)
        if len(words) < 10:
            if words:
                said = f"line {line[0]} has {len(words)} words{separators_of(line[1])}"
                raise bad_input(path, said, _EXPECTED)
            continue
        observed = next(lines, (line[0] + 1, ""))  # empty for an image that observes nothing
        if words[9] == name:
            return _pose(path, line, words), words[8], *_observed(path, observed)
    raise bad_input(path, f"has no image {name!r}", "the name of one of its images")


def _observed(path: Path, line: Line) -> tuple[FloatArray, NDArray[np.int64]]:
    """Pixels (N, 2) and points (N,) of a line ``u v id u v id ...``, without those that show no point."""
    values = _numbers(path, line, line[1].split(), 0)
    if len(values) % 3:
        raise bad_input(path, f"line {line[0]} has {len(values)} numbers, not three a point", _EXPECTED)
    triples = values.reshape(-1, 3)
    triples = triples[triples[:, 2] >= 0]
    ids = triples[:, 2]
    bad = ids[(ids != np.rint(ids)) | (ids > _LARGEST_ID)]
    if len(bad):
        raise bad_input(path, f"line {line[0]} names the point {bad[0]:.17g}", f"a whole number, at most {_LARGEST_ID}")
    return triples[:, :2], ids.astype(np.int64)


def _pose(path: Path, line: Line, words: list[str]) -> FloatArray:
    from scipy.spatial.transform import Rotation

    w, x, y, z, *t = _numbers(path, line, words[1:8], 7)
    if not np.hypot(np.hypot(w, x), np.hypot(y, z)) > 0:
        raise bad_input(path, f"line {line[0]} has a quaternion of 0", _EXPECTED)
    return np.column_stack([Rotation.from_quat([x, y, z, w]).as_matrix(), t])


def _focal_length(path: Path, camera: str, image: Image) -> float:
    for line in read_lines(path, _EXPECTED):
        words = line[1].split()
        if words and words[0] == camera:
            width, height, focal = _numbers(path, line, words[2:], 3)[:3]
            if np.shape(image)[:2] != (height, width):
                wanted = f"the camera's {height:g} x {width:g}"
                raise InputError(f"image has shape {np.shape(image)}, expected {wanted} of {path}")
            return float(focal)
    raise bad_input(path, f"has no camera {camera}", _EXPECTED)


def _points(path: Path, wanted: set[int]) -> dict[int, FloatArray]:
    """Positions of the wanted points."""
    found = {}
    for line in read_lines(path, _EXPECTED):
        words = line[1].split(maxsplit=4)
        if words and (point := _id(path, line, words[0])) in wanted:
            found[point] = _numbers(path, line, words[1:4], 3)
    return found


def _id(path: Path, line: Line, word: str) -> int:
    if not is_whole(word, 20):
        raise bad_input(path, f"line {line[0]} begins with {word[:40]!r}", "the number of a point")
    return int(word)
