"""Binary glTF 2.0 (.glb): coloured triangles, lines, points, and cameras, as browsers, Blender and Windows open it."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .._atomic import write_bytes
from .._brief import Brief
from .._checks import is_rigid
from .._files import PathLike, bad_input
from ..types import FloatArray, Rig
from .trajectory import quaternions

Mode = Literal["points", "lines", "triangles"]

# Numbers of the specification, version 2.0: component types, targets of buffer views, modes of primitives.
_USHORT, _UINT, _FLOAT = 5123, 5125, 5126
_VERTICES, _INDICES = 34962, 34963
_MODES: dict[Mode, tuple[int, int]] = {"points": (0, 1), "lines": (1, 2), "triangles": (4, 3)}  # and corners of each
_JSON, _BINARY = b"JSON", b"BIN\0"
_LARGEST = (1 << 32) - 1  # bytes: lengths are 32-bit numbers
_FARTHEST = float(np.finfo(np.float32).max)
_NEAR = 0.01  # m: from where on a keyframe's camera shows things
_FLIP = np.array([1.0, -1.0, -1.0])  # half a turn about x: from y down, z forward to y up, z back
_UNLIT = "KHR_materials_unlit"


@dataclass(frozen=True, repr=False)
class Drawn(Brief):
    """What is drawn as one node: points, lines or triangles.

    Attributes
    ----------
    name : str
        Of the node.
    mode : {"points", "lines", "triangles"}
        What two or three vertices make.
    xyz : (N, 3) float64
        Vertices, m; x right, y down, z forward.
    rgb : (N, 3) uint8
        Their colours, sRGB.
    rows : (M,), (M, 2) or (M, 3) integers, or None
        Vertices of each point, line or triangle; None where they follow each other.
    values : dict of str to (N,) numbers, or None
        More of the vertices: ``magnitude`` becomes the attribute ``_MAGNITUDE``, float32.
    at : (3,) float64 or None
        Where the node stands, m, from which `xyz` are counted: what is far from 0 keeps the digits of float32.
    """

    name: str
    mode: Mode
    xyz: FloatArray
    rgb: NDArray[np.uint8]
    rows: NDArray[Any] | None = None
    values: Mapping[str, NDArray[Any]] | None = None
    at: FloatArray | None = None


def write_glb(
    path: PathLike, drawn: Sequence[Drawn], rig: Rig | None = None, cameras: Mapping[str, FloatArray] | None = None,
    *, extras: Mapping[str, Any] | None = None,
) -> None:  # fmt: skip
    """Write what is drawn, and cameras, as binary glTF; equal things give equal bytes.

    glTF has y up and z back: everything is turned by half a turn about x, in metres. Places are float32. Colours are
    linear there: each sRGB byte becomes a linear 16-bit number, which gives it back exactly. Materials are unlit where
    the program knows `KHR_materials_unlit`, and seen from both sides. glTF's cameras have no principal point.

    Parameters
    ----------
    path : str or path
        The file to write.
    drawn : sequence of Drawn
        Nodes; those without an element are left out.
    rig : Rig, optional
        Of the cameras.
    cameras : dict of str to (4, 4) float64, optional
        Poses, camera to world, m, by the names of their nodes.
    extras : dict, optional
        What else is to be known of the file: plain values, kept in ``asset.extras``.

    Raises
    ------
    InputError
        If arrays do not fit each other, or are not finite, or a pose is no rigid motion.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> grey = np.full((3, 3), 128, np.uint8)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_glb(f"{folder}/a.glb", [Drawn("one", "triangles", np.eye(3), grey)])
    ...     Path(folder, "a.glb").read_bytes()[:4]
    b'glTF'
    """
    parts = _Parts(path)
    for each in drawn:
        parts.draw(each)
    for name, pose in (cameras or {}).items():
        parts.place(name, pose)
    tree = parts.tree(rig, extras or {})
    text = json.dumps(tree, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode("utf-8")
    chunks = [_chunk(_JSON, text, b" ")]
    if parts.data:
        chunks.append(_chunk(_BINARY, bytes(parts.data), b"\0"))
    length = 12 + sum(map(len, chunks))
    if length > _LARGEST:
        raise bad_input(path, f"would have {length} bytes", f"at most {_LARGEST}, which is all that a .glb can hold")
    write_bytes(path, b"".join([struct.pack("<4sII", b"glTF", 2, length), *chunks]))


class _Parts:
    """The lists of a glTF file while they grow."""

    def __init__(self, path: PathLike) -> None:
        self.path, self.data = path, bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []
        self.meshes: list[dict[str, Any]] = []
        self.nodes: list[dict[str, Any]] = []

    def draw(self, each: Drawn) -> None:
        mode, corners = _MODES[each.mode]
        _check(self.path, each, corners)
        if not len(each.xyz) or (each.rows is not None and not len(each.rows)):
            return
        xyz = (each.xyz * _FLIP + 0.0).astype("<f4")
        if not np.isfinite(xyz).all():
            raise bad_input(self.path, f"{each.name} has a place that is not finite or too large", "finite metres")
        low, high = xyz.min(axis=0).tolist(), xyz.max(axis=0).tolist()
        made = {"POSITION": self._accessor(xyz, _FLOAT, "VEC3", _VERTICES, min=low, max=high)}
        made["COLOR_0"] = self._accessor(_linear(each.rgb), _USHORT, "VEC4", _VERTICES, normalized=True)
        for name, values in (each.values or {}).items():
            made[f"_{name.upper()}"] = self._accessor(values.astype("<f4"), _FLOAT, "SCALAR", _VERTICES)
        primitive: dict[str, Any] = {"attributes": made, "material": 0, "mode": mode}
        if each.rows is not None:
            primitive["indices"] = self._accessor(each.rows.ravel().astype("<u4"), _UINT, "SCALAR", _INDICES)
        place = {} if each.at is None else {"translation": (each.at * _FLIP + 0.0).tolist()}
        self.nodes.append({"mesh": len(self.meshes), "name": each.name} | place)
        self.meshes.append({"name": each.name, "primitives": [primitive]})

    def place(self, name: str, pose: FloatArray) -> None:
        if np.shape(pose) != (4, 4) or not is_rigid(pose):
            raise bad_input(self.path, f"the pose of {name} is no rigid motion", "(4, 4) float64, camera to world")
        turn = quaternions((pose[:3, :3] * _FLIP[:, None] * _FLIP)[None])[0]
        turn /= np.linalg.norm(turn)
        place = pose[:3, 3] * _FLIP + 0.0  # no -0
        self.nodes.append({"camera": 0, "name": name, "rotation": turn.tolist(), "translation": place.tolist()})

    def tree(self, rig: Rig | None, extras: Mapping[str, Any]) -> dict[str, Any]:
        """All lists that are not empty, since the format knows no empty ones."""
        has_cameras = any("camera" in node for node in self.nodes)
        if has_cameras and rig is None:
            raise bad_input(self.path, "has cameras without a rig", "the rig that they share")
        nodes = list(range(len(self.nodes)))
        lists: dict[str, Any] = {
            "extensionsUsed": [_UNLIT] if self.meshes else [],
            "scene": 0,
            "scenes": [{"nodes": nodes} if nodes else {"name": "empty"}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": [_material()] if self.meshes else [],
            "cameras": [_camera(rig)] if rig is not None and has_cameras else [],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.data)}] if self.data else [],
        }
        asset = {"version": "2.0", "generator": "tspslam"} | ({"extras": dict(extras)} if extras else {})
        return {"asset": asset} | {name: value for name, value in lists.items() if value != []}

    def _accessor(self, values: NDArray[Any], component: int, kind: str, target: int, **more: Any) -> int:
        """Append rows of whole 4-byte words, so that all that follows stays aligned."""
        data = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), "target": target}
        self.data += data
        self.views.append(view)
        count = {"bufferView": len(self.views) - 1, "componentType": component, "count": len(values), "type": kind}
        self.accessors.append(count | more)
        return len(self.accessors) - 1


def _check(path: PathLike, each: Drawn, corners: int) -> None:
    count = len(each.xyz)
    if each.xyz.shape != (count, 3) or each.rgb.shape != (count, 3) or each.rgb.dtype != np.uint8:
        found = f"{each.name} has places {each.xyz.shape} and colours {each.rgb.dtype} {each.rgb.shape}"
        raise bad_input(path, found, "(N, 3) and uint8 (N, 3)")
    for name, values in (each.values or {}).items():
        if values.shape != (count,) or not (np.abs(values) <= _FARTHEST).all():
            raise bad_input(path, f"{each.name} has {name} of shape {values.shape}", f"({count},), finite as float32")
    if each.at is not None and not (each.at.shape == (3,) and np.isfinite(each.at).all()):
        raise bad_input(path, f"{each.name} stands at {each.at!r:.60}", "(3,) finite metres")
    if each.rows is None:
        if count % corners:
            raise bad_input(path, f"{each.name} has {count} vertices", f"{corners} for each of its {each.mode}")
        return
    expected = (len(each.rows), corners)[: each.rows.ndim]
    if each.rows.shape != expected or (each.rows.ndim == 1 and corners > 1):
        raise bad_input(path, f"{each.name} has rows of shape {each.rows.shape}", f"(M, {corners})")
    if each.rows.size and not (each.rows.min() >= 0 and each.rows.max() < count):
        raise bad_input(path, f"{each.name} has rows {each.rows.min()} to {each.rows.max()}", f"0 to {count - 1}")


def _linear(rgb: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Colours as linear light, (N, 4) with an opaque fourth: three 16-bit numbers would not be whole words."""
    bytes_ = np.arange(256) / 255  # IEC 61966-2-1
    light = np.where(bytes_ <= 0.04045, bytes_ / 12.92, ((bytes_ + 0.055) / 1.055) ** 2.4)
    made = np.full((len(rgb), 4), 65535, "<u2")
    made[:, :3] = np.rint(65535 * light).astype("<u2")[rgb]
    return made


def _material() -> dict[str, Any]:
    """Unlit; where that is not known, as dull as can be."""
    return {
        "doubleSided": True,
        "extensions": {_UNLIT: {}},
        "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
    }


def _camera(rig: Rig) -> dict[str, Any]:
    across, down = rig.width / rig.fx, rig.height / rig.fy
    lens = {"aspectRatio": across / down, "yfov": float(2 * np.arctan(down / 2)), "znear": _NEAR}
    return {"name": "left camera", "perspective": lens, "type": "perspective"}


def _chunk(kind: bytes, data: bytes, filler: bytes) -> bytes:
    data += filler * (-len(data) % 4)
    return struct.pack("<I4s", len(data), kind) + data
