"""What a run says of itself: summaries, ``run.json``, hashes, versions."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import __version__
from .session import Frame
from .topology.crust import CrustSurface
from .topology.surface import pinched_vertices
from .types import Rig, StereoPair
from .vision.rig import doubts

Summary = dict[str, Any]
Warning_ = dict[str, str]


def frame_summary(frame: Frame, input_hash: str) -> Summary:
    """What one frame gave, in numbers; the same frame always gives the same."""
    quality = frame.quality
    return {
        "index": frame.index,
        "input_hash": input_hash,
        "name": frame.name,
        "stamp": frame.stamp,
        "points": len(frame.cloud),
        "edges": len(frame.complex_.edges),
        "faces": len(frame.complex_.faces),
        "euler": frame.complex_.euler,
        "pinched_vertices": pinched_vertices(frame.surface.faces, len(frame.cloud)).tolist(),
        "surface": frame.surface.report.verdict if isinstance(frame.surface, CrustSurface) else "image Delaunay",
        "defined": int(frame.response.defined.sum()),
        "keypoints_left": quality.keypoints_left,
        "keypoints_right": quality.keypoints_right,
        "matched": quality.matched,
        "by_row_search": quality.by_row_search,
        "vertical_offset_px": quality.vertical_offset_px,
        "vertical_offset_std_px": quality.vertical_offset_std_px,
    }


def run_record(
    source: str,
    unpaired: Sequence[str],
    rig: Rig,
    done: list[Summary],
    skipped: list[Warning_],
    settings_hash: str,
    shown: str,
) -> Summary:
    """What ``run.json`` holds; nothing in it varies when the run is repeated."""
    first = done[0]
    offsets = [unit["vertical_offset_px"] for unit in done]
    return {
        "status": "degraded" if skipped else "complete",
        "source": source,
        "frames": len(done) + len(skipped),
        "tracked": len(done),
        "keyframes": len(done),
        "landmarks": first["points"],
        "complex": {"n": first["points"], **{key: first[key] for key in ("edges", "faces", "euler")}},
        "calibration": {
            "vertical_offset_px": float(np.median(offsets)),
            "vertical_offset_std_px": first["vertical_offset_std_px"],
            "disparity_offset_px": None,
            "disparity_offset_std_px": None,
        },
        "warnings": [*skipped, *_doubts(rig), *_warnings(unpaired, done, shown)],
        "per_frame": [_row(unit) for unit in done],
        "versions": versions(),
        "seeds": {},
        "input_hash": hash_of([unit["input_hash"] for unit in done]),
        "settings_hash": settings_hash,
    }


def _row(unit: Summary) -> Summary:
    row = {key: value for key, value in unit.items() if key not in ("seconds", "input_hash")}
    return row | {"pinched_vertices": len(unit["pinched_vertices"])}


def _doubts(rig: Rig) -> Iterator[Warning_]:
    return ({"code": "calibration", "message": line} for line in doubts(rig))


def _warnings(unpaired: Sequence[str], done: list[Summary], shown: str) -> Iterator[Warning_]:
    if len(done) > 1:
        message = f"frames are processed one by one, without a path between them; map and pictures show {shown}"
        yield {"code": "frames_independent", "message": message}
    if unpaired:
        names = ", ".join(unpaired[:3])
        yield {"code": "unpaired", "message": f"{len(unpaired)} images have no partner: {names}"}
    pinched = sum(len(unit["pinched_vertices"]) for unit in done)
    broken = {unit["surface"] for unit in done} - {"image Delaunay", "closed manifold"}
    for verdict in sorted(broken):
        yield {"code": "surface", "message": verdict}
    if pinched and not broken:
        message = (
            f"the surface is not a manifold at {pinched} vertices (frames/*.json): depth cuts left several fans there"
        )
        yield {"code": "pinched_vertices", "message": message}


def pair_hash(pair: StereoPair) -> str:
    """SHA-256 of all that a frame is made from: images, rig, place, time, name; hexadecimal."""
    digest = hashlib.sha256(_json_bytes([_rig_record(pair.rig), pair.index, pair.stamp, pair.name]))
    for values in (pair.left, pair.right, pair.disparity):
        digest.update(b"" if values is None else array_hash(values).encode())
    return digest.hexdigest()


def array_hash(values: NDArray[Any]) -> str:
    """SHA-256 of an array's shape, type and content, hexadecimal."""
    head = f"{values.shape} {values.dtype}".encode()
    return hashlib.sha256(head + np.ascontiguousarray(values).tobytes()).hexdigest()


def _rig_record(rig: Rig) -> dict[str, float]:
    return {key: float(value) for key, value in vars(rig).items()}


def hash_of(value: Any) -> str:
    """SHA-256 of a value as JSON, hexadecimal."""
    return hashlib.sha256(_json_bytes(value)).hexdigest()


def _json_bytes(value: Any) -> bytes:
    return (json.dumps(value, sort_keys=True, allow_nan=False) + "\n").encode()


def versions() -> dict[str, str]:
    """Versions of this package and of those that its results depend on."""
    packages = ("numpy", "scipy", "opencv-python-headless", "numba")
    return {"tspslam": __version__, **{name: version(name) for name in packages}}


def machine() -> dict[str, str]:
    """What the run ran on."""
    return {"system": platform.platform(), "python": platform.python_version(), "processor": platform.machine()}
