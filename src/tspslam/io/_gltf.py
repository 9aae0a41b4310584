"""Reading glTF 2.0: the triangles of a scene, each mesh where its node places it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .._files import PathLike, bad_input
from ..errors import InputError
from ..types import FloatArray
from ._gltf_data import EXPECTED, Document, Tree, nodes_of, reals, whole
from ._polygons import strip_triangles

_FLIP = np.array([1.0, -1.0, -1.0])  # half a turn about x, as `write_glb` does: from y up, z back to y down, z forward
_TRIANGLES, _STRIP, _FAN = 4, 5, 6  # modes of primitives; those below are points and lines
_INDICES, _FLOATS = (5121, 5123, 5125), (5126,)
_RIGHT = 1e-3  # that the length of a written quaternion may be off by
_PRIMITIVE = 1 << 10  # bytes that each counts for wherever it is placed, so that a file has not too many
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "KHR_animation_", "KHR_xmp")
"""Extensions that change no place and no triangle."""


class _Part(NamedTuple):
    xyz: FloatArray
    faces: NDArray[np.int64]


def read_gltf(path: PathLike) -> tuple[FloatArray, NDArray[np.int64]]:
    """Read positions and triangles, (F, 3), of the file's scene, turned to x right, y down, z forward."""
    try:
        document = Document(path)
        _check_asset(document.tree)
        parts = list(_parts(document))
    except InputError as error:
        raise bad_input(path, str(error), EXPECTED) from error
    except MemoryError as error:
        raise bad_input(path, "is larger than the memory", EXPECTED) from error
    first = np.cumsum([0, *(len(part.xyz) for part in parts)])
    xyz = np.concatenate([np.empty((0, 3)), *(part.xyz for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, first[:-1], strict=True)]
    return xyz * _FLIP + 0.0, np.concatenate([np.empty((0, 3), np.int64), *faces])


def _check_asset(tree: Tree) -> None:
    asset = tree.get("asset")
    version = asset.get("version") if isinstance(asset, dict) else None
    if version not in ("2.0", "2.1"):
        raise InputError(f"is glTF of version {version!r:.20}, where 2.0 is read")
    needed = tree.get("extensionsRequired", [])
    if not isinstance(needed, list) or not all(isinstance(each, str) for each in needed):
        raise InputError("has extensionsRequired that are no list of names")
    other = [each for each in needed if not each.startswith(_HARMLESS)]
    if other:
        raise InputError(f"needs the extension {other[0][:60]}, which is not read")


def _parts(document: Document) -> Iterator[_Part]:
    """Primitives of triangles in the scene's nodes, each node once."""
    seen = set[int]()
    waiting = [(at, np.eye(4)) for at in reversed(_roots(document))]
    while waiting:
        at, above = waiting.pop()
        if at in seen:
            raise InputError(f"has node {at} in two places, or within itself")
        seen.add(at)
        node = document.pick("nodes", at)
        with np.errstate(over="ignore", invalid="ignore"):
            T = above @ _motion(node)
        if not np.isfinite(T).all():
            raise InputError(f"has node {at} at a place that is not finite")
        waiting += [(child, T) for child in reversed(_numbers_of(node, "children"))]
        if "mesh" in node:
            if "skin" in node or "weights" in node:
                raise InputError(f"has node {at} with a skin or weights, whose shape is not of its mesh alone")
            yield from _placed(document, whole(node, "mesh"), T)


def _roots(document: Document) -> list[int]:
    """Nodes of the scene that is shown; without a scene, all that are no child."""
    if document.nodes("scenes"):
        return _numbers_of(document.pick("scenes", whole(document.tree, "scene", 0)), "nodes")
    nodes = document.nodes("nodes")
    children = {child for node in nodes for child in _numbers_of(node, "children")}
    return [at for at in range(len(nodes)) if at not in children]


def _numbers_of(node: Tree, key: str) -> list[int]:
    found = node.get(key, [])
    if not isinstance(found, list) or not all(type(each) is int and each >= 0 for each in found):
        raise InputError(f"has {key} that are no list of whole numbers")
    return found


def _motion(node: Tree) -> NDArray[np.float64]:
    """What a node does to its mesh: its matrix, or scale, then rotation, then translation."""
    if "matrix" in node:
        T = reals(node, "matrix", [0.0] * 16).reshape(4, 4).T
        if (T[3] != (0, 0, 0, 1)).any():
            raise InputError("has a matrix whose last row is not 0 0 0 1")
        return T
    x, y, z, w = q = reals(node, "rotation", [0.0, 0.0, 0.0, 1.0])
    length = float(np.sqrt((np.clip(q, -2, 2) ** 2).sum()))
    if abs(length - 1) > _RIGHT:
        raise InputError(f"has a rotation of length {length:.6g}, where 1 goes")
    x, y, z, w = q / length
    T = np.eye(4)
    T[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    T[:3, :3] *= reals(node, "scale", [1.0] * 3)
    T[:3, 3] = reals(node, "translation", [0.0] * 3)
    return T


def _placed(document: Document, at: int, T: NDArray[np.float64]) -> Iterator[_Part]:
    mesh = document.pick("meshes", at)
    primitives = nodes_of(mesh, "primitives")
    document.budget.take(_PRIMITIVE * len(primitives))
    _check_shape(mesh, primitives, at)
    for number, primitive in enumerate(primitives):
        mode = whole(primitive, "mode", _TRIANGLES, _FAN)
        if mode < _TRIANGLES:
            continue
        try:
            xyz, faces = _primitive(document, primitive, mode)
        except InputError as error:
            raise InputError(f"primitive {number} of mesh {at} {error}") from error
        with np.errstate(over="ignore", invalid="ignore"):
            placed = xyz @ T[:3, :3].T + T[:3, 3]
        if not np.isfinite(placed).all():
            raise InputError(f"primitive {number} of mesh {at} has a coordinate that is not finite")
        is_mirrored = np.linalg.det(T[:3, :3]) < 0  # then front faces are wound the other way: section 3.7.4
        yield _Part(placed, faces[:, ::-1] if is_mirrored else faces)


def _check_shape(mesh: Tree, primitives: list[Tree], at: int) -> None:
    """Refuse a mesh that is shown in another shape than that of its positions; weights of 0 leave it as it is."""
    weights = mesh.get("weights", [])
    is_moved = not isinstance(weights, list) or any(each not in (0, 0.0) for each in weights)
    if is_moved and any("targets" in primitive for primitive in primitives):
        raise InputError(f"has mesh {at} with weights and targets, whose shape is not of its positions alone")


def _primitive(document: Document, primitive: Tree, mode: int) -> _Part:
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        raise InputError("has no POSITION")
    extensions: Any = primitive.get("extensions", {})
    squeezed = [each for each in extensions if "draco" in each.lower()] if isinstance(extensions, dict) else []
    if squeezed:
        raise InputError(f"is compressed by {squeezed[0][:60]}, which is not read")
    xyz = document.array(whole(attributes, "POSITION"), "VEC3", _FLOATS).astype(np.float64)
    corners = np.arange(len(xyz))
    if "indices" in primitive:
        corners = document.array(whole(primitive, "indices"), "SCALAR", _INDICES)[:, 0].astype(np.int64)
    if corners.size and corners.max() >= len(xyz):
        raise InputError(f"has the corner {corners.max()}, where 0 to {len(xyz) - 1} go")
    return _Part(xyz, _triangles(corners, mode))


def _triangles(corners: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _STRIP:
        return strip_triangles(corners)
    if mode == _FAN:
        tip = np.broadcast_to(corners[:1], max(len(corners) - 2, 0))
        return np.stack([corners[1:-1], corners[2:], tip], axis=1) if len(corners) > 2 else np.empty((0, 3), np.int64)
    if len(corners) % 3:
        raise InputError(f"has {len(corners)} corners, where 3 for each triangle go")
    return corners.reshape(-1, 3)
