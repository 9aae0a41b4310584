"""Calibration files of lines ``key=value``."""

from __future__ import annotations

from collections.abc import Container

from ...._files import PathLike, bad_input


def key_and_value(
    path: PathLike, line: tuple[int, str], earlier: Container[object], section: str = ""
) -> tuple[str, str]:
    """Return the two sides of a line, the key with its section before it; a key that was there `earlier` is refused.

    Examples
    --------
    >>> key_and_value("calib.txt", (1, "width = 640"), {})
    ('width', '640')
    """
    number, text = line
    key, sign, rest = (word.strip() for word in text.partition("="))
    name = section + key
    if not sign or not key or name in earlier:
        what = f"the key {name[:40]!r} twice" if name in earlier else f"the line {text.strip()[:40]!r}"
        raise bad_input(path, f"line {number} holds {what}", "lines key=value, each key once")
    return name, rest
