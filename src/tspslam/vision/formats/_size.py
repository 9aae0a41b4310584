"""The image size: the file's own, or the caller's where the file has none."""

from __future__ import annotations

from ._source import Source, whole
from ._values import Found

Size = tuple[int, int]
"""Width and height, px."""


def size_from_keys(source: Source, width: str, height: str) -> Found:
    """Return the image size that has a key for each side."""
    sides = (("width", width), ("height", height))
    return {name: (_side(source, key, source.number(key)), source.label(key)) for name, key in sides}


def size_from_list(source: Source, key: str) -> Found:
    """Return the image size that is a list of width and height."""
    names = (f"{key}[0]", f"{key}[1]")
    width, height = (_side(source, name, value) for name, value in zip(names, source.vector(key, 2), strict=True))
    return {"width": (width, source.label(names[0])), "height": (height, source.label(names[1]))}


def agreed_size(source: Source, found: Found | None, given: Size | None) -> Found:
    """Return the file's image size, else the caller's; they must be the same if there are both."""
    if found is None:
        if given is None:
            raise source.error("holds no image size; expected width and height from elsewhere (--size, or size=)")
        return {name: (value, "given size") for name, value in zip(("width", "height"), given, strict=True)}
    seen = found["width"][0], found["height"][0]
    if given is not None and seen != given:
        keys = f"{found['width'][1]}, {found['height'][1]}"
        raise source.error(
            f"is for images of {seen[0]} x {seen[1]} px ({keys}), but {given[0]} x {given[1]} px are given, "
            "expected the same"
        )
    return found


def _side(source: Source, key: str, value: float) -> float:
    if not (1 <= value <= 1_000_000 and value == int(value)):
        raise source.wrong(key, whole(value), "a whole number of px from 1 to 1000000")
    return int(value)
