"""One image of a COLMAP text model and the points that it observes, to a complex with signals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input, one_line
from .._text import Line, is_whole, numbers, read_lines, separators_of
from ..errors import InputError
from ..frame import Frame, Once
from ..topology.complex import build_complex
from ..topology.harmonic import Tmahf
from ..topology.surface import delaunay_surface
from ..topology.texture import sample_signals
from ..types import Cloud, FloatArray, Image, Rig
from ..vision.se3 import inverse

_EXPECTED = "COLMAP's text model: cameras.txt, images.txt, points3D.txt"
_LARGEST_ID = 1 << 53  # of a point: larger ones are no whole numbers as floats
_TWO_FOCAL_LENGTHS = frozenset(
    {"PINHOLE", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "FOV", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE"}
)  # models whose parameters begin with fx, fy; the others have one focal length
_TO_CENTRE = 0.5  # COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0)


def from_colmap(folder: PathLike, name: str, image: Image, *, max_depth_ratio: float = 0.08) -> Frame:
    """Triangulate the points that one image of a COLMAP model observes, and give them its texture.

    Parameters
    ----------
    folder : path
        Of cameras.txt, images.txt and points3D.txt.
    name : str
        The image's name in images.txt.
    image : (H, W) or (H, W, 3) uint8, uint16 or float array
        The image itself, as COLMAP saw it (its distortion, if any, does not matter: observations are used, not
        projections).
    max_depth_ratio : float
        As `tspslam.delaunay_surface`.

    Returns
    -------
    Frame
        Points in the frame of this camera, in the model's unit; their `disparity` is that of a baseline of one unit,
        their `landmark` the point's id in the model, whose world is that of ``T_world_camera``. The response is that of
        the default filter, `tspslam.tmahf`.

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
    T_camera_world, camera, uv, ids = _observations(root / "images.txt", name)
    rig = _rig(root / "cameras.txt", camera, image)
    positions = _points(root / "points3D.txt", set(ids.tolist()))
    _, first = np.unique(ids, return_index=True)
    seen = np.array([k for k in np.sort(first) if int(ids[k]) in positions], np.int64)
    world = np.array([positions[int(k)] for k in ids[seen]]).reshape(-1, 3)
    xyz = world @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    seen, xyz = seen[xyz[:, 2] > 0], xyz[xyz[:, 2] > 0]
    if len(seen) < 3:
        raise bad_input(root, f"image {name} observes {len(seen)} points in front of it", "at least 3")
    cloud = Cloud(xyz, uv[seen] - _TO_CENTRE, rig.fx / xyz[:, 2])
    surface = delaunay_surface(cloud, max_depth_ratio=max_depth_ratio)
    complex_ = build_complex(surface.faces, len(cloud))
    signals = sample_signals(image, cloud.uv, complex_)
    response = Once(lambda: Tmahf()(complex_, cloud.uv, signals))
    return Frame(
        0, 0.0, one_line(name), rig, cloud, surface, complex_, signals, response,
        image=image, T_world_camera=inverse(T_camera_world), landmark=ids[seen],
    )  # fmt: skip


def _numbers(path: Path, line: Line, words: list[str], count: int) -> FloatArray:
    values = np.array(numbers(path, line, words, _EXPECTED), np.float64)
    if len(values) < count:
        raise bad_input(path, f"line {line[0]} has {len(values)} numbers, where {count} go", _EXPECTED)
    if not np.isfinite(values).all():
        raise bad_input(path, f"line {line[0]} has a number that is not finite", _EXPECTED)
    return values


def _observations(path: Path, name: str) -> tuple[FloatArray, str, FloatArray, NDArray[np.int64]]:
    """Pose (4, 4), world to camera; camera; observed pixels (N, 2) and the points (N,) that they show."""
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
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat([x, y, z, w]).as_matrix(), t
    return T


def _rig(path: Path, camera: str, image: Image) -> Rig:
    """A camera as a rig of a baseline of one unit; its distortion is left out."""
    for line in read_lines(path, _EXPECTED):
        words = line[1].split()
        if not words or words[0] != camera:
            continue
        width, height, *rest = _numbers(path, line, words[2:], 3).tolist()
        if np.shape(image)[:2] != (height, width):
            wanted = f"the camera's {height:g} x {width:g}"
            raise InputError(f"image has shape {np.shape(image)}, expected {wanted} of {path}")
        fx, *rest = rest
        fy, *rest = rest if words[1] in _TWO_FOCAL_LENGTHS else [fx, *rest]
        if len(rest) < 2:
            raise bad_input(path, f"line {line[0]} has no principal point", _EXPECTED)
        try:
            return Rig(fx, fy, rest[0] - _TO_CENTRE, rest[1] - _TO_CENTRE, 1.0, int(width), int(height))
        except InputError as error:
            raise bad_input(path, f"line {line[0]} is no camera ({error})", _EXPECTED) from error
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
