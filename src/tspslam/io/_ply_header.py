"""The header of a PLY file."""

from __future__ import annotations

from dataclasses import dataclass, field

from .._text import is_whole
from ..errors import InputError

LARGEST_HEADER = 1 << 16

TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A property: its name, the type of its values and, for a list, the type of its length (type codes of NumPy)."""

    name: str
    code: str
    length_code: str | None = None


@dataclass(frozen=True)
class Element:
    """An element: its name, how many rows it has, and its properties."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)

    @property
    def lists(self) -> list[Property]:
        """The list properties."""
        return [each for each in self.properties if each.length_code is not None]

    @property
    def smallest_row(self) -> int:
        """Bytes of a binary row whose lists are empty."""
        return sum(int((each.length_code or each.code)[1]) for each in self.properties)


@dataclass(frozen=True)
class Header:
    """A header: the byte order (empty for text), the elements, and where the data start."""

    order: str
    elements: list[Element]
    size: int


def parse_header(data: bytes) -> Header:
    """Parse the header of a PLY file given at least its first 64 KiB."""
    head = data[:LARGEST_HEADER]
    mark = head.find(b"\nend_header")
    end = head.find(b"\n", mark + 1)
    if not head.startswith((b"ply\n", b"ply\r\n")) or mark < 0 or end < 0:
        raise InputError(f"has no PLY header of at most {LARGEST_HEADER} bytes")
    order: str | None = None
    elements: list[Element] = []
    for line in head[:mark].decode("latin-1").split("\n")[1:]:
        words = line.split()
        if not words or words[0] in ("comment", "obj_info"):
            continue
        if words[0] == "format" and order is None:
            order = _order(words)
        elif words[0] == "element":
            elements.append(_element(words, elements))
        elif words[0] == "property" and elements:
            elements[-1].properties.append(_property(words, elements[-1]))
        else:
            raise InputError(f"has the header line {line.strip()[:80]!r}")
    if order is None:
        raise InputError("has no format line")
    return Header(order, elements, end + 1)


def _order(words: list[str]) -> str:
    if len(words) != 3 or words[1] not in ORDERS or words[2] != "1.0":
        raise InputError(f"has the format {' '.join(words[1:])[:80]!r}")
    return ORDERS[words[1]]


def _element(words: list[str], earlier: list[Element]) -> Element:
    if len(words) != 3 or not is_whole(words[2], 18):
        raise InputError(f"has the header line {' '.join(words)[:80]!r}")
    if any(words[1] == each.name for each in earlier):
        raise InputError(f"has two elements called {words[1][:80]}")
    return Element(words[1], int(words[2]))


def _property(words: list[str], element: Element) -> Property:
    if len(words) == 5 and words[1] == "list":
        found = Property(words[4], _code(words[3]), _code(words[2]))
        if found.length_code is not None and found.length_code.startswith("f"):
            raise InputError(f"has a list {found.name[:80]} whose length is no integer")
    elif len(words) == 3:
        found = Property(words[2], _code(words[1]))
    else:
        raise InputError(f"has the header line {' '.join(words)[:80]!r}")
    if any(found.name == each.name for each in element.properties):
        raise InputError(f"has two properties {found.name[:80]} in {element.name[:80]}")
    return found


def _code(word: str) -> str:
    if word not in TYPES:
        raise InputError(f"has the unknown type {word[:80]!r}")
    return TYPES[word]
