"""Topics of colour and depth in a bag, and the camera that a camera info describes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from .._files import bad_input
from ._bags import Bag
from ._encodings import COMPRESSED
from ._ros import CAMERA_INFO, IMAGE, partners

ALIGNED = (
    "aligned",
    "registered",
    "depth_to_rgb",
)  # in names of topics whose depths are of the colour camera's pixels
_COLOUR = ("color", "rgb")


def has_depth(kinds: Mapping[str, str]) -> bool:
    """Whether topics of a bag are of colour images and depths."""
    return bool(_of_depth(kinds)) and bool(_of_colour(kinds))


def is_rgbd_bag(path: Path | Sequence[Path], topics: tuple[str, str] | None) -> bool:
    """Whether a bag is to be read as colour and depth: topics say so, or none of its images are left and right."""
    if topics is not None:
        return "depth" in topics[1].lower()
    kinds = Bag(path, (IMAGE, COMPRESSED, CAMERA_INFO)).kinds
    return has_depth(kinds) and not partners({topic: kind for topic, kind in kinds.items() if kind != CAMERA_INFO})


def _of_depth(kinds: Mapping[str, str]) -> list[str]:
    return [topic for topic, kind in kinds.items() if kind != CAMERA_INFO and "depth" in topic.lower()
            and (kind == IMAGE or topic.endswith("compressedDepth"))]  # fmt: skip


def _of_colour(kinds: Mapping[str, str]) -> list[str]:
    depths = set(_of_depth(kinds))
    return [topic for topic, kind in kinds.items() if kind != CAMERA_INFO and topic not in depths
            and not topic.endswith("compressedDepth") and any(word in topic.lower() for word in _COLOUR)]  # fmt: skip


def rgbd_topics(path: Path, kinds: Mapping[str, str], colour: str | None, depth: str | None) -> tuple[str, str]:
    """Return the topics of colour and depth: those asked for, else the best of each, if there is one."""
    images = sorted(topic for topic, kind in kinds.items() if kind != CAMERA_INFO)
    for given in (colour, depth):
        if given is not None and given not in images:
            raise bad_input(path, f"has no images on {given[:80]}", f"one of {', '.join(images)[:400]}")

    def best(what: str, found: list[str]) -> str:
        ranks = {
            t: (not any(word in t for word in ALIGNED) and what == "depths", kinds[t] == COMPRESSED) for t in found
        }
        first = [topic for topic in found if ranks[topic] == min(ranks.values())]
        if len(first) != 1:
            said = f"has {len(first) or 'no'} topics of {what}"
            raise bad_input(path, said, f"topics to be given (--topics COLOUR DEPTH), of {', '.join(images)[:400]}")
        return first[0]

    return colour or best("colour images", _of_colour(kinds)), depth or best("depths", _of_depth(kinds))
