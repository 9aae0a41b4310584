"""Lens models that files name in words of their own, where their format has no key for it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from ._source import Source

_DEEPEST = 3  # levels of a file in which a lens is named
FISHEYE = "the fisheye model of Kannala and Brandt (equidistant)"
_MODELS = {  # words of a name, and what the model is
    r"thin-?prism-?fisheye": "the thin prism fisheye model",
    r"kannala|\bkb[48]?\b|fish-?eye|equi(?:dist(?:ant)?)?\b": FISHEYE,
    r"omni|\bmei\b|catadioptric|scaramuzza|ocam": "an omnidirectional model",
    r"\bds\b|double-?sphere": "the double sphere model",
    r"\be?ucm\b|unified": "a unified camera model",
    r"\bfov\b|\batan\b": "the field-of-view (FOV) fisheye model",
    r"equirect": "an equirectangular image",
}
_TELLING = re.compile(r"model|type|fish_?eye|lens|projection|distortion$", re.IGNORECASE)
_NO = (0, False, None, "", "0", "no", "false", "none")
PINHOLE = "a pinhole with k1, k2, p1, p2, k3 or a fisheye lens"


def fisheye_key(source: Source) -> str | None:
    """Return the key that says that a lens is a fisheye; another lens that we cannot read here is refused.

    Examples
    --------
    >>> fisheye_key(Source("a.yaml", {"lens": {"model": "fisheye"}}))
    'lens.model'
    >>> fisheye_key(Source("a.yaml", {"model": "ocam"}))
    Traceback (most recent call last):
    tspslam.errors.InputError: a.yaml: model is 'ocam', expected a pinhole with k1, k2, p1, p2, k3 or a fisheye lens: \
an omnidirectional model is not read from such a file
    """
    found = None
    for key, value in _named(source.values, ""):
        model = _model(key, value)
        if model == FISHEYE:
            found = found or key
        elif model:
            raise source.wrong(key, value, f"{PINHOLE}: {model} is not read from such a file")
    return found


def _named(values: dict[Any, Any], prefix: str, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Keys that may name a lens, with what they say."""
    for key, value in values.items():
        if _TELLING.search(str(key)):
            yield f"{prefix}{key}", value
        if isinstance(value, dict) and depth < _DEEPEST:
            yield from _named(value, f"{prefix}{key}.", depth + 1)


def _model(key: str, value: Any) -> str | None:
    """What lens a key and its value name, if it is not Brown's."""
    said = re.sub(r"[_\s]+", "-", value.lower()) if isinstance(value, str) else value
    if re.search("fish_?eye", key.rpartition(".")[2], re.IGNORECASE) and said not in _NO:
        return FISHEYE
    named = said if isinstance(said, str) else ""
    return next((model for words, model in _MODELS.items() if re.search(words, named)), None)
