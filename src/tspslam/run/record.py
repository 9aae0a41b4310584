"""What a run says of itself: summaries, ``run.json``, hashes, versions."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import __version__
from ..session import Frame, Session
from ..topology.crust import CrustSurface
from ..topology.surface import pinched_vertices
from ..types import Rig, StereoPair
from ..vision.rig import doubts
from ..vision.slam.odometry import StereoOdometry as Odometry

_LARGE_OFFSET, _SURE = 0.5, 3.0  # px: recordings calibrated with care have up to 0.4 (KITTI); standard deviations
_FAR, _FARTHEST = 10.0, 1e4  # m: the depth that is told as an example, and the most that is said of it

Row = dict[str, Any]
Warning_ = dict[str, str]

# Points in a cloud, as a share of the keypoints that the image should have: below it a cloud is almost empty. Of 42
# frames of KITTI, EuRoC, an OAK-D and Motorcycle the poorest (a bare corridor) has 0.095, the next 0.12, the median
# 0.4; Motorcycle's 12-bit pixels taken for 16-bit ones had 0.069.
_FEW = 0.08
_AREA = 50.0  # px² for each keypoint that a small image should have; ORB finds up to one in 21


class SequenceLike(Protocol):
    """What a record is made from."""

    @property
    def source(self) -> Any:
        """Where the pairs came from: its `name` and `rig`."""

    @property
    def folder(self) -> Any:
        """The run folder: its `config_hash`."""

    session: Session
    rows: list[Row]

    @property
    def tracked(self) -> list[Row]:
        """Rows of frames with a pose."""

    @property
    def stored(self) -> list[Row]:
        """Rows of frames with a complex."""


def frame_row(frame: Frame, input_hash: str, *, with_complex: bool = False) -> Row:
    """What one frame gave, in numbers; the same frame always gives the same.

    Raises
    ------
    InputError
        If its complex is asked for and it shows too little.
    """
    tracked = frame.tracked
    row = {
        "index": frame.index,
        "input_hash": input_hash,
        "name": frame.name,
        "stamp": frame.stamp,
        "is_keyframe": tracked.is_keyframe,
        "is_lost": tracked.is_lost,
        "landmarks_seen": tracked.matches,
    }
    row |= _facts(frame.pair)
    return row | _complex_numbers(frame) if with_complex else row


def _facts(pair: StereoPair) -> Row:
    """What was found of the pixels and the map of a pair, where it is not what is usual."""
    bits = {} if pair.bits is None else {"bits": pair.bits}
    return bits | ({"unknown": list(pair.unknown)} if pair.unknown else {})


def _complex_numbers(frame: Frame) -> Row:
    quality = frame.quality
    return {
        "defined": int(frame.response.defined.sum()),
        "points": len(frame.cloud),
        "edges": len(frame.complex_.edges),
        "faces": len(frame.complex_.faces),
        "euler": frame.complex_.euler,
        "pinched_vertices": pinched_vertices(frame.surface.faces, len(frame.cloud)).tolist(),
        "surface": frame.surface.report.verdict if isinstance(frame.surface, CrustSurface) else "image Delaunay",
        "keypoints_left": quality.keypoints_left,
        "keypoints_right": quality.keypoints_right,
        "matched": quality.matched,
        "by_row_search": quality.by_row_search,
        "vertical_offset_px": quality.vertical_offset_px,
        "vertical_offset_std_px": quality.vertical_offset_std_px,
    }


def run_record(sequence: SequenceLike, unpaired: Sequence[str]) -> dict[str, Any]:
    """What ``run.json`` holds; nothing in it varies when the run is repeated."""
    tracked, stored, odometry = sequence.tracked, sequence.stored, sequence.session.odometry
    skipped = len(sequence.rows) - len(tracked)
    lost = sum(row["is_lost"] for row in tracked)
    bare = any("no_complex" in row for row in tracked)
    defined = sum(row["defined"] for row in stored)
    is_path = len(tracked) > 1
    bits = next(({"bits": row["bits"]} for row in tracked if "bits" in row), {})
    return {
        "status": "degraded" if skipped or lost or bare or odometry.unsolved or not defined else "complete",
        "source": sequence.source.name,
        "frames": len(sequence.rows),
        "tracked": len(tracked) - lost,
        "keyframes": sum(row["is_keyframe"] for row in tracked),
        "landmarks": len(odometry.map.xyz),
        "loops": odometry.loops,
        "complex": {
            "n": sum(row["points"] for row in stored),
            **{key: sum(row[key] for row in stored) for key in ("edges", "faces", "euler")},
        },
        "calibration": {
            "vertical_offset_px": float(np.median([row["vertical_offset_px"] for row in stored])),
            "vertical_offset_std_px": stored[0]["vertical_offset_std_px"],
            "disparity_offset_px": odometry.disparity_offset[0] if is_path else None,
            "disparity_offset_std_px": odometry.disparity_offset[1] if is_path else None,
            **bits,
        },
        "warnings": [
            *_troubles(sequence.rows, odometry),
            *_doubts(sequence.source.rig),
            *(offset_doubts(sequence.source.rig, *odometry.disparity_offset) if is_path else ()),
            *pixel_warnings(bits.get("bits"), tracked[0].get("unknown", [])),
            *_few_points(stored, sequence.session),
            *no_response(defined),
            *_warnings(unpaired, stored),
        ],
        "per_frame": [_row(row) for row in tracked],
        "versions": versions(),
        "seeds": {"recognition": 0},
        "input_hash": hash_of([row["input_hash"] for row in sequence.rows]),
        "settings_hash": sequence.folder.config_hash,
    }


def _troubles(rows: list[Row], odometry: Odometry) -> Iterator[Warning_]:
    """What went wrong with frames and the map."""
    for row in rows:
        if "skipped" in row:
            yield {"code": "frame_skipped", "message": f"frame {row['index']}: {row['skipped']}"}
        if "no_complex" in row and not row["is_lost"]:
            yield {"code": "no_complex", "message": f"frame {row['index']} has a pose, but: {row['no_complex']}"}
    lost = [row["index"] for row in rows if row.get("is_lost")]
    if lost:
        message = (
            f"tracking was lost in {len(lost)} of {len(rows)} frames, first in frame {lost[0]}: "
            "their poses are those of a steady motion"
        )
        yield {"code": "tracking_lost", "message": message}
    stamps = [row["stamp"] for row in rows if "stamp" in row]
    if len(set(stamps)) < len(stamps):
        message = (
            f"{len(stamps) - len(set(stamps))} frames have the stamp of the one before and no line in the trajectory"
        )
        yield {"code": "equal_stamps", "message": message}
    if odometry.unsolved:
        message = f"{odometry.unsolved} adjustments of the map had no solution"
        yield {"code": "adjustment", "message": message}


def pixel_warnings(bits: int | None, unknown: Sequence[float] = ()) -> Iterator[Warning_]:
    """What was decided of pixels and of a map's values that a user may know better."""
    if bits is not None and bits < 16:
        message = f"16-bit pixels use {bits} bits: taken {1 << (16 - bits)} times as bright (--bits for another number)"
        yield {"code": "bits", "message": message}
    if unknown:
        said = " and ".join(f"{value:g}" for value in unknown)
        message = f"{said} in the map stands for 'not known', by how common it is (--unknown for another value)"
        yield {"code": "unknown", "message": message}


def no_response(defined: int) -> Iterator[Warning_]:
    """That nothing came of it all, where no vertex has a response."""
    if not defined:
        message = (
            "no vertex has a response: none has a signal and two neighbours or more that have one, in other places"
        )
        yield {"code": "no_response", "message": message}


def _few_points(stored: list[Row], session: Session) -> Iterator[Warning_]:
    """Frames whose clouds are almost empty for their images."""
    rig, count = session.rig, getattr(session.settings.detector, "count", None)
    fits = rig.width * rig.height / _AREA
    wanted = {row["index"]: min(count if isinstance(count, int) else row["keypoints_left"], fits) for row in stored}
    few = [row for row in stored if row["points"] < _FEW * wanted[row["index"]]]
    if few:
        first = few[0]
        message = (
            f"{len(few)} of {len(stored)} clouds are almost empty, first frame {first['index']}: {first['points']} "
            f"points of {first['keypoints_left']} keypoints, where {wanted[first['index']]:.0f} are usual; is the "
            "image dark, blurred or bare, or are its bits others (--bits)?"
        )
        yield {"code": "few_points", "message": message}


def _row(row: Row) -> Row:
    plain = {key: value for key, value in row.items() if key not in ("seconds", "input_hash", "bits", "unknown")}
    return plain | ({"pinched_vertices": len(row["pinched_vertices"])} if "points" in row else {})


def _doubts(rig: Rig) -> Iterator[Warning_]:
    return ({"code": "calibration", "message": line} for line in doubts(rig))


def offset_doubts(rig: Rig, offset: float, std: float) -> Iterator[Warning_]:
    """What an offset of all disparities does, if the motion tells for sure that there is a large one."""
    if abs(offset) <= max(_LARGE_OFFSET, _SURE * std):
        return
    beyond = rig.fx * rig.baseline
    seen = beyond / max(beyond / _FAR + offset, beyond / _FARTHEST)
    message = (
        f"disparities are off by {offset:+.2f} ± {std:.2g} px, as the motion tells; expected less than "
        f"{_LARGE_OFFSET:g}: is the calibration of these images? In the frames' points {_FAR:g} m are {seen:.3g} m; "
        "in path and landmarks the offset is taken off"
    )
    yield {"code": "disparity_offset", "message": message}


def _warnings(unpaired: Sequence[str], done: list[Row]) -> Iterator[Warning_]:
    if unpaired:
        names = ", ".join(unpaired[:3])
        yield {"code": "unpaired", "message": f"{len(unpaired)} images have no partner or no stamp: {names}"}
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
