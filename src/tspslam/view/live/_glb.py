"""Triangles or lines with a colour at each corner as binary glTF: what viser sends as it is, and no light changes."""

from __future__ import annotations

import json
import struct
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...types import FloatArray

LINES: Literal[1] = 1
TRIANGLES: Literal[4] = 4
_FLOAT, _USHORT = 5126, 5123
_UNLIT = "KHR_materials_unlit"


def glb_of(xyz: FloatArray, rgb: NDArray[np.uint8], mode: Literal[1, 4] = TRIANGLES) -> bytes:
    """Pack corners, (n, 3), m, and their sRGB colours, (n, 3): two make a line, three a triangle."""
    places = np.ascontiguousarray(xyz, "<f4")
    colours = np.full((len(rgb), 4), 65535, "<u2")
    colours[:, :3] = _linear()[rgb]
    body = places.tobytes() + colours.tobytes()
    text = json.dumps(_document(places, len(body), mode), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(body))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body


def _linear() -> NDArray[np.uint16]:
    """Linear intensity of each sRGB level, in 1/65535, as glTF wants it."""
    x = np.arange(256) / 255
    return np.rint(65535 * np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)).astype(np.uint16)


def _document(places: NDArray[Any], size: int, mode: int) -> dict[str, Any]:
    count = len(places)
    span = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
    material = {"doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0}, "extensions": {_UNLIT: {}}}
    return {
        "asset": {"version": "2.0"}, "extensionsUsed": [_UNLIT], "scene": 0,
        "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}], "materials": [material],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "material": 0, "mode": mode}]}],
        "buffers": [{"byteLength": size}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 12 * count},
            {"buffer": 0, "byteOffset": 12 * count, "byteLength": 8 * count},
        ],
        "accessors": [
            {"bufferView": 0, "componentType": _FLOAT, "count": count, "type": "VEC3", **span},
            {"bufferView": 1, "componentType": _USHORT, "normalized": True, "count": count, "type": "VEC4"},
        ],
    }  # fmt: skip
