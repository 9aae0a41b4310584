"""Lens models in files that we do not support: fisheye lenses and mirrors."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from ._source import Source

_DEEPEST = 3  # levels of a file in which a lens is named
_FISHEYE = "the fisheye model of Kannala and Brandt (equidistant)"
_MODELS = {  # words of a name, and what the model is
    r"kannala|\bkb[48]?\b|fish-?eye|equi(?:dist(?:ant)?)?\b": _FISHEYE,
    r"omni|\bmei\b|catadioptric|scaramuzza|ocam": "an omnidirectional model",
    r"\bds\b|double-?sphere": "the double sphere model",
    r"\be?ucm\b|unified": "a unified camera model",
    r"\bfov\b|\batan\b": "the field-of-view (FOV) fisheye model",
    r"thin-?prism": "the thin prism fisheye model",
}
_TELLING = re.compile(r"model|type|fish_?eye|lens|projection|distortion$", re.IGNORECASE)
_NOT_READ = re.compile(r"cam[2-9][0-9]*")  # Kalibr's cameras after the second
_NO = (0, False, None, "", "0", "no", "false", "none")


def check_lens(source: Source) -> None:
    """Refuse a file that names a lens model which is not a pinhole with k1, k2, p1, p2, k3.

    Four coefficients of a fisheye lens look like k1, k2, p1, p2, and would be used as these.

    Examples
    --------
    >>> check_lens(Source("a.yaml", {"Camera.type": "KannalaBrandt8"}))
    Traceback (most recent call last):
    tspslam.errors.InputError: a.yaml: Camera.type is 'KannalaBrandt8', expected pinhole with k1, k2, p1, p2, k3: \
the fisheye model of Kannala and Brandt (equidistant) is not supported yet
    """
    for key, value in _named(source.values, ""):
        model = _model(key, value)
        if model:
            raise source.wrong(key, value, f"pinhole with k1, k2, p1, p2, k3: {model} is not supported yet")


def _named(values: dict[Any, Any], prefix: str, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Keys that may name a lens, with what they say."""
    for key, value in values.items():
        if _NOT_READ.fullmatch(str(key)):
            continue
        if _TELLING.search(str(key)):
            yield f"{prefix}{key}", value
        if isinstance(value, dict) and depth < _DEEPEST:
            yield from _named(value, f"{prefix}{key}.", depth + 1)


def _model(key: str, value: Any) -> str | None:
    """What lens a key and its value name, if it is none of ours."""
    said = re.sub(r"[_\s]+", "-", value.lower()) if isinstance(value, str) else value
    if re.search("fish_?eye", key.rpartition(".")[2], re.IGNORECASE) and said not in _NO:
        return _FISHEYE
    named = said if isinstance(said, str) else ""
    return next((model for words, model in _MODELS.items() if re.search(words, named)), None)
