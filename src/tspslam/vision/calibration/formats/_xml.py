"""OpenCV's FileStorage in XML: elements, numbers and text; no document type, no entities, nothing from elsewhere."""

from __future__ import annotations

import re
from typing import Any
from xml.parsers import expat

from ...._files import PathLike, bad_input, one_line
from ...._text import is_plain

_DEEPEST = 21  # levels, as of YAML
_ROOT = "opencv_storage"
_INTEGER = re.compile(r"[-+]?[0-9]{1,400}")
_WORD = re.compile(r'"(?:[^"\\]|\\.)*"|\S+')


def is_xml(text: str) -> bool:
    """Whether a text begins as XML does."""
    return text.lstrip().startswith("<")


def parse_opencv_xml(text: str, path: PathLike, expected: str) -> dict[Any, Any]:
    r"""Return what the text of a file says, as YAML of the same content would be read.

    Examples
    --------
    >>> parse_opencv_xml("<opencv_storage><imageSize>640 480</imageSize></opencv_storage>", "a.xml", "a calibration")
    {'imageSize': [640, 480]}
    """
    reader = _Reader()
    try:
        reader.parse(text)
        return reader.root
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise bad_input(path, f"is no XML of OpenCV: {one_line(str(error))[:160]}", expected) from error


class _Reader:
    """Elements as they are met: each level is its children, by name or in order, and its text."""

    def __init__(self) -> None:
        self.root: dict[Any, Any] = {}
        self._levels: list[tuple[dict[Any, Any], list[Any], list[str]]] = []

    def parse(self, text: str) -> None:
        parser = expat.ParserCreate("utf-8")
        parser.StartDoctypeDeclHandler = _refuse
        parser.EntityDeclHandler = _refuse
        parser.ExternalEntityRefHandler = _refuse_outside
        parser.StartElementHandler = self._open
        parser.EndElementHandler = self._close
        parser.CharacterDataHandler = self._text
        parser.Parse(text.lstrip().encode("utf-8"), True)

    def _open(self, name: str, _attributes: dict[str, str]) -> None:
        if not self._levels and name != _ROOT:
            raise ValueError(f"its root is <{name[:40]}>, not <{_ROOT}>")
        if len(self._levels) > _DEEPEST:
            raise ValueError("too many levels")
        self._levels.append(({}, [], []))

    def _text(self, data: str) -> None:
        self._levels[-1][2].append(data)

    def _close(self, name: str) -> None:
        named, items, words = self._levels.pop()
        value: Any = named or items or _value("".join(words), name)
        if not self._levels:
            self.root = named
        elif name == "_":
            self._levels[-1][1].append(value)
        elif name in self._levels[-1][0]:
            raise ValueError(f"<{name[:40]}> is there twice")
        else:
            self._levels[-1][0][name] = value


def _refuse(*_given: Any) -> None:
    raise ValueError("a document type and entities are not allowed")


def _refuse_outside(*_given: str | None) -> int:
    raise ValueError("an entity from elsewhere is not allowed")


def _value(text: str, name: str) -> Any:
    """A number, a text, or a list of them."""
    words = [_plain(word) for word in _WORD.findall(text)]
    return words if name == "data" or len(words) > 1 else words[0] if words else None


def _plain(word: str) -> Any:
    if word.startswith('"'):
        return word.strip('"')
    if _INTEGER.fullmatch(word):
        return int(word)
    try:
        return float(word) if is_plain(word) else word
    except ValueError:
        return word
