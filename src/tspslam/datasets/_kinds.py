"""Files that are no images of a pair: what they are, and how to get images from them."""

from __future__ import annotations

import os
import shlex
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from .._files import bad_input
from ..errors import InputError

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp"})
"""Of images that are read."""
_FLOATS = (".exr", ".pfm")  # read too, but often maps beside images
_READ = "images as .png, .jpg, .tif, .bmp, .pgm, .ppm or .webp"
_MAX_NAMED = 6
_KINDS = {
    "a video": ".mp4 .m4v .mov .avi .mkv .webm .wmv .mpg .mpeg .mts .h264 .h265 .hevc .ogv .flv .3gp .y4m .mjpeg .mjpg",
    "a recording of a ZED camera": ".svo .svo2",
    "a bag that was not closed": ".active",
    "an archive": ".zip .tar .gz .tgz .bz2 .tbz2 .xz .txz .7z .rar .zst .zstd .lz4",
    "one image": " ".join(sorted({*SUFFIXES, *_FLOATS})),
    "an image of a kind that is not read": ".gif .heic .heif .avif .jp2 .jxl .hdr .dng .tga .svg",
    "a mesh or a cloud": ".ply .obj .vtu .stl .pcd .off",
    "a text": ".yaml .yml .txt .json .csv .xml",
}
_WAYS = {
    "a video": "two images of a pair; a video goes alone with --layout, or two videos, left and right, with --calib",
    "a recording of a ZED camera": "left/ and right/ with its frames, as ZED's own tools export them",
    "a bag that was not closed": "a whole bag: rosbag reindex {name} mends one of ROS 1",
    "an archive": "a folder: unpack it first",
    "one image": "two images, left and right, with --calib, or one with --depth or --disparity",
    "an image of a kind that is not read": f"{_READ}: magick {{name}} {{stem}}.png makes one",
    "a mesh or a cloud": "images of a pair; tspslam filter takes a mesh (PLY, OBJ, VTU)",
    "a text": "images of a pair, or a folder of them; a calibration goes with --calib",
    "a folder": "two images, or one folder with left/ and right/ in it",
}
_OF = {suffix: kind for kind, suffixes in _KINDS.items() for suffix in suffixes.split()}


def no_source(path: Path) -> InputError | None:
    """Return what a file that is no source of pairs is instead, if its name says so."""
    return _named(path, _OF.get(path.suffix.lower()))


def is_video(path: Path) -> bool:
    """Whether a file is a video by its name."""
    return _OF.get(path.suffix.lower()) == "a video" and not path.is_dir()


def no_image(path: Path) -> InputError | None:
    """Return what a path that is no image of a pair is instead, if it is a folder or its name says so."""
    kind = "a folder" if os.path.isdir(path) else _OF.get(path.suffix.lower())
    return None if kind == "one image" else _named(path, kind)


def _named(path: Path, kind: str | None) -> InputError | None:
    if kind is None or not os.path.exists(path):
        return None
    way = _WAYS[kind].format(name=shlex.quote(path.name), stem=shlex.quote(path.stem))
    return bad_input(path, f"is {kind}", way)


def only_images(folder: Path, files: Iterable[Path]) -> list[Path]:
    """Return the files of a folder that are images by name, without hidden ones; InputError if it has others only."""
    seen = [file for file in files if not file.name.startswith(".")]
    images = [file for file in seen if file.suffix.lower() in SUFFIXES]
    images = images or [file for file in seen if file.suffix.lower() in _FLOATS]
    others = Counter(file.suffix.lower() for file in seen if not images and file.is_file())
    if others:
        (suffix, count), kind = others.most_common(1)[0], _OF.get(others.most_common(1)[0][0])
        said = f"holds {count} files {'of ' + suffix if suffix else 'without a suffix'}, a kind that is not read"
        way = (
            f": magick mogrify -format png *{suffix} makes some"
            if kind == "an image of a kind that is not read"
            else ""
        )
        raise bad_input(folder, said, _READ + way)
    return images


def listed(folder: Path) -> str:
    """Return what lies in a folder, in a few words."""
    try:
        names = sorted(name for name in os.listdir(folder) if not name.startswith("."))
    except OSError:
        names = []
    more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
    return (", ".join(name[:40] for name in names[:_MAX_NAMED]) or "nothing") + more
