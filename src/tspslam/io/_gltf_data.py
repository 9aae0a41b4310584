"""The bytes of a glTF file: its JSON, its buffers, embedded or beside it, and the arrays in them."""

from __future__ import annotations

import base64
import binascii
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, read_bytes, unpacked_limit
from .._text import parse_json, unmarked
from ..errors import InputError
from ._vtk_data import Budget

Tree = Mapping[str, Any]
EXPECTED = "a glTF 2.0 file of triangles (.gltf or .glb)"
_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_LARGEST_JSON = 1 << 26  # bytes: it takes ten times as many in memory
_MOST = (1 << 32) - 1
_MEDIA = ("application/octet-stream", "application/gltf-buffer")
_TYPES = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}  # of components, in the specification
_SHAPES = {"SCALAR": 1, "VEC3": 3}


def whole(node: Tree, key: str, default: int | None = None, most: int = _MOST) -> int:
    """A number from 0 of a node of the tree."""
    value = node.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= most:
        raise InputError(f"has {key} {value!r:.40}, where a whole number up to {most} goes")
    return value


def nodes_of(tree: Tree, key: str) -> list[Tree]:
    """A list of nodes; empty where it is left out."""
    found = tree.get(key, [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InputError(f"has {key} that are no list of objects")
    return found


def reals(node: Tree, key: str, default: list[float]) -> NDArray[np.float64]:
    """As many finite numbers as the default has."""
    value = node.get(key, default)
    is_list = isinstance(value, list) and len(value) == len(default)
    if not is_list or not all(type(each) in (int, float) and abs(each) <= sys.float_info.max for each in value):
        raise InputError(f"has a {key} that is not {len(default)} finite numbers")
    return np.array(value, np.float64)


class Document:
    """A glTF file: its tree, and its arrays once they are asked for."""

    def __init__(self, path: PathLike) -> None:
        data = read_bytes(path, EXPECTED)
        text, self._binary = _parts(data)
        if len(text) > _LARGEST_JSON:
            raise InputError(f"has {len(text)} bytes of JSON, where at most {_LARGEST_JSON} are read")
        try:
            tree = parse_json(text)
        except (ValueError, RecursionError) as error:
            raise InputError(f"is not JSON ({str(error)[:80]})") from error
        if not isinstance(tree, dict):
            raise InputError("holds no object of JSON")
        self.tree: Tree = tree
        self.budget = Budget(unpacked_limit(len(data)))
        self._folder = Path(path).parent
        self._buffers: dict[int, bytes] = {}
        self._lists: dict[str, list[Tree]] = {}

    def nodes(self, key: str) -> list[Tree]:
        """A list of the tree, checked once however often it is asked for."""
        if key not in self._lists:
            self._lists[key] = nodes_of(self.tree, key)
        return self._lists[key]

    def pick(self, key: str, at: int) -> Tree:
        """One node of such a list."""
        found = self.nodes(key)
        if not 0 <= at < len(found):
            raise InputError(f"refers to {key} {at} of {len(found)}")
        return found[at]

    def array(self, at: int, kind: str, codes: tuple[int, ...]) -> NDArray[Any]:
        """The values of an accessor, (count, components), of one of some types."""
        accessor = self.pick("accessors", at)
        code, count = whole(accessor, "componentType"), whole(accessor, "count")
        if accessor.get("type") != kind or code not in codes:
            found = f"{accessor.get('type')!r:.20} of component type {code}"
            raise InputError(f"has accessor {at} of {found}, where {kind} of {', '.join(map(str, codes))} goes")
        if "sparse" in accessor or "bufferView" not in accessor or accessor.get("normalized", False) is not False:
            raise InputError(f"has accessor {at} that is sparse, normalised or without bytes, which is not read")
        view = self.pick("bufferViews", whole(accessor, "bufferView"))
        data = self._buffer(whole(view, "buffer"))
        row = np.dtype(_TYPES[code]).itemsize * _SHAPES[kind]
        stride, length = whole(view, "byteStride", row), whole(view, "byteLength")
        first, offset = whole(view, "byteOffset", 0), whole(accessor, "byteOffset", 0)
        used = offset + stride * (count - 1) + row if count else offset
        if not row <= stride <= 252 and "byteStride" in view:
            raise InputError(f"has rows of {stride} bytes in accessor {at}, where {row} to 252 go")
        if used > length or first + length > len(data):
            raise InputError(f"has accessor {at} that ends behind its buffer")
        self.budget.take(8 * count * _SHAPES[kind])
        return np.ndarray(
            (count, _SHAPES[kind]), _TYPES[code], data, first + offset, (stride, np.dtype(_TYPES[code]).itemsize)
        )

    def _buffer(self, at: int) -> bytes:
        if at not in self._buffers:
            self._buffers[at] = self._read(at)
        return self._buffers[at]

    def _read(self, at: int) -> bytes:
        buffer = self.pick("buffers", at)
        size, uri = whole(buffer, "byteLength"), buffer.get("uri")
        if uri is None:
            if at or self._binary is None:
                raise InputError(f"has buffer {at} without bytes")
            data = self._binary
        elif isinstance(uri, str):
            data = _embedded(uri) if uri.startswith("data:") else read_bytes(self._beside(uri), EXPECTED)
        else:
            raise InputError(f"has buffer {at} whose uri is no text")
        if len(data) < size:
            raise InputError(f"has buffer {at} of {len(data)} bytes, where {size} are claimed")
        return data[:size]

    def _beside(self, uri: str) -> Path:
        """The file that a buffer names: in the folder of the file, or in one below."""
        name = unquote(uri)
        folder = os.path.realpath(self._folder)
        is_plain = name.isprintable() and ":" not in name and "\\" not in name and not name.startswith("/")
        place = os.path.realpath(os.path.join(folder, name)) if is_plain else ""  # only of what is a name at all
        if not place or os.path.commonpath([folder, place]) != folder:
            raise InputError(f"has a buffer at {uri!r:.80}, where a file beside it or below goes")
        return Path(place)


def _parts(data: bytes) -> tuple[bytes, bytes | None]:
    """The JSON of a file, and the binary chunk, if there is one."""
    if not data.startswith(_MAGIC):
        return unmarked(data), None
    version, length = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    if version != 2 or length != len(data):
        raise InputError(f"is a GLB of version {version} that claims {length} bytes, and has {len(data)}")
    found: list[tuple[bytes, bytes]] = []
    at = 12
    while at < len(data):
        size, kind = int.from_bytes(data[at : at + 4], "little"), data[at + 4 : at + 8]
        if len(kind) < 4 or at + 8 + size > len(data) or size % 4:
            raise InputError(
                f"has chunk {len(found)} of {size} bytes that ends behind the file, or not at a fourth byte"
            )
        found.append((kind, data[at + 8 : at + 8 + size]))
        at += 8 + size
    if not found or found[0][0] != _JSON:
        raise InputError("has no JSON in its first chunk")
    return found[0][1], found[1][1] if len(found) > 1 and found[1][0] == _BINARY else None


def _embedded(uri: str) -> bytes:
    head, comma, text = uri[5:].partition(",")
    media, mark, form = head.rpartition(";")
    if not (comma and mark) or form != "base64" or media.partition(";")[0] not in _MEDIA:
        raise InputError(f"has a buffer at {uri[:40]!r}, where {' or '.join(_MEDIA)} in base64 goes")
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise InputError("has a buffer of damaged base64") from error
