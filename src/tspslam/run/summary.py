"""What ``run.json`` says of a whole run, and what the run warns of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..session import Session
from ..topological_map import TopologicalMap
from ..vision.rig import doubts
from ..vision.slam.odometry import StereoOdometry
from .offset_doubts import Warning_ as Warning_
from .offset_doubts import describe_health, offset_doubts, rows_doubts
from .record import ComplexRecord, FrameRecord, Row, SkippedPair, flatten_row, hash_of, versions

# Points in a cloud, as a share of the keypoints that the image should have: below it a cloud is almost empty. Of 42
# frames of KITTI, EuRoC, an OAK-D and Motorcycle the poorest (a bare corridor) has 0.095, the next 0.12, the median
# 0.4; Motorcycle's 12-bit pixels taken for 16-bit ones had 0.069.
_FEW = 0.08
THIN = 0.2  # of the landmarks; of seven recordings and worlds the thinnest has 0.5
_AREA = 50.0  # px² for each keypoint that a small image should have; ORB finds up to one in 21


def summarize_run(
    source: str, rows: Sequence[Row], session: Session, *, settings_hash: str, unpaired: Sequence[str] = ()
) -> dict[str, Any]:
    """What ``run.json`` holds; nothing in it varies when the run is repeated.

    Parameters
    ----------
    source : str
        What was processed.
    rows : sequence of FrameRecord or SkippedPair
        One for each pair, at least one of them with a complex.
    session : Session
        What processed them.
    settings_hash : str
        Hash of the settings.
    unpaired : sequence of str
        Images without a partner.

    Returns
    -------
    dict
        Plain values, fit for JSON.
    """
    odometry = _stereo_odometry(session)
    tracked = [row for row in rows if isinstance(row, FrameRecord)]
    stored = [row.complex_ for row in tracked if row.complex_ is not None]
    lost = sum(row.is_lost for row in tracked)
    defined = sum(each.defined for each in stored)
    bits = next(({"bits": row.bits} for row in tracked if row.bits is not None), {})
    is_bare = any(row.no_complex is not None for row in tracked)
    is_degraded = len(tracked) < len(rows) or lost or is_bare or (odometry and odometry.unsolved) or not defined
    return {
        "status": "degraded" if is_degraded else "complete",
        "source": source,
        "frames": len(rows),
        "tracked": len(tracked) - lost,
        "keyframes": sum(row.is_keyframe for row in tracked),
        "landmarks": odometry.map.landmark_count if odometry else 0,
        "loops": odometry.loops if odometry else 0,
        "loop_closures": [[tracked[k].index for k in loop] for loop in odometry.mapper.closures] if odometry else [],
        "skipped": [row.index for row in rows if isinstance(row, SkippedPair)],
        "complex": _sizes(stored),
        "defined": defined,
        "calibration": _calibration(tracked, odometry if len(tracked) > 1 else None, session) | bits,
        "warnings": list(_warnings(rows, session, unpaired)),
        "per_frame": [_row(row) for row in tracked],
        "versions": versions(),
        "seeds": {"recognition": 0},
        "input_hash": hash_of([row.input_hash for row in rows]),
        "settings_hash": settings_hash,
    }


def describe_map(record: dict[str, Any], made: TopologicalMap | None, warnings: Sequence[Warning_]) -> dict[str, Any]:
    """What ``run.json`` says once the map is made: its sizes, and what is to be doubted.

    Parameters
    ----------
    record : dict
        As `summarize_run` gave it.
    made : TopologicalMap or None
        The map; None where the keyframes span none, and the run is degraded.
    warnings : sequence of dict
        Further warnings.

    Returns
    -------
    dict
        Plain values, fit for JSON.
    """
    both = [*record["warnings"], *warnings]
    if made is None:
        return record | {"status": "degraded", "warnings": both}
    complex_, sightings = made.complex_, np.diff(made.observations.start)
    sizes = {"n": complex_.n, "edges": len(complex_.edges), "faces": len(complex_.faces), "euler": complex_.euler}
    told = {
        "keyframes": len(made.keyframes),
        "parts": int(made.part.max()) + 1,
        "observations": len(made.observations),
        "three_or_more": int((sightings >= 3).sum()),
        "faces_seen": int(made.signals.face_ok.sum()),
        "defined": int(made.defined.sum()),
    }
    return record | {"complex": sizes, "defined": told["defined"], "map": told, "warnings": both}


def doubts_of_map(made: TopologicalMap, landmarks: int) -> Iterator[Warning_]:
    """What is to be doubted of a map of several keyframes.

    Parameters
    ----------
    made : TopologicalMap
        The map.
    landmarks : int
        Landmarks of the path; 0 where it has none.

    Yields
    ------
    dict of str to str
        A ``code`` and a ``message``.
    """
    groups = _joined_keyframes(made)
    if len(groups) > 1:
        said = "; ".join(f"{len(group)} from frame {group[0]}" for group in groups[:3])
        message = (
            f"the map is in {len(groups)} parts that share no landmark ({said} keyframes): "
            "where they stand to one another is a guess"
        )
        yield {"code": "map_parts", "message": message}
    if len(made) < THIN * landmarks:
        message = f"the map has {len(made)} vertices for {landmarks} landmarks: few of these are seen by two keyframes"
        yield {"code": "thin_map", "message": message}


def _joined_keyframes(made: TopologicalMap) -> list[list[int]]:
    """Frames of the keyframes that vertices join, group by group; those that see no vertex are left out."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    seen, count = made.observations, len(made.keyframes)
    size = count + len(made)
    edges = coo_array((np.ones(len(seen), np.int8), (seen.keyframe, count + seen.vertex)), shape=(size, size))
    _, label = connected_components(edges, directed=False)
    used = np.unique(seen.keyframe)
    return [made.keyframes[used[label[used] == one]].tolist() for one in dict.fromkeys(label[used].tolist())]


def _stereo_odometry(session: Session) -> StereoOdometry | None:
    """What has a map, and an offset of the disparities; None if the poses come from elsewhere."""
    return session.odometry if isinstance(session.odometry, StereoOdometry) else None


def _sizes(stored: list[ComplexRecord]) -> dict[str, int]:
    names = {"n": "points", "edges": "edges", "faces": "faces", "euler": "euler"}
    return {key: sum(getattr(each, name) for each in stored) for key, name in names.items()}


def _calibration(tracked: list[FrameRecord], odometry: StereoOdometry | None, session: Session) -> dict[str, Any]:
    """How far the rig is off: as the images tell, and as the motion does, if there was one."""
    stored, fixed = [row.complex_ for row in tracked if row.complex_ is not None], session.settings.mapping.fix_offset
    offset, std = (None, None) if odometry is None else odometry.disparity_offset
    rows, bias = [each.vertical_offset_px for each in stored], None if odometry is None else odometry.mapper.bias
    return {
        "vertical_offset_px": float(np.median(rows)),
        "vertical_offset_std_px": stored[0].vertical_offset_std_px,
        "disparity_offset_px": offset,
        "disparity_offset_std_px": std,
    } | describe_health(rows, bias, is_fixed=fixed, frames=[row.index for row in tracked])


def _row(row: FrameRecord) -> dict[str, Any]:
    """A row of ``per_frame``."""
    plain = {name: value for name, value in flatten_row(row).items() if name not in ("input_hash", "bits", "unknown")}
    return plain | ({"pinched_vertices": len(row.complex_.pinched_vertices)} if row.complex_ else {})


def _warnings(rows: Sequence[Row], session: Session, unpaired: Sequence[str]) -> Iterator[Warning_]:
    odometry, rig = _stereo_odometry(session), session.rig
    tracked = [row for row in rows if isinstance(row, FrameRecord)]
    stored = [row.complex_ for row in tracked if row.complex_ is not None]
    yield from _troubles(rows, odometry)
    for line in doubts(rig):
        yield {"code": "calibration", "message": line}
    if odometry and len(tracked) > 1:
        fixed, frames = session.settings.mapping.fix_offset, [row.index for row in tracked]
        yield from offset_doubts(rig, odometry.mapper.bias, is_fixed=fixed, frames=frames)
    lone_std = stored[0].vertical_offset_std_px / max(stored[0].points, 1) ** 0.5 if stored else np.inf
    yield from rows_doubts([each.vertical_offset_px for each in stored], lone_std)
    yield from pixel_warnings(next((row.bits for row in tracked if row.bits is not None), None), tracked[0].unknown)
    yield from _few_points(tracked, session)
    yield from no_response(sum(each.defined for each in stored))
    yield from _surfaces(unpaired, stored)


def _troubles(rows: Sequence[Row], odometry: StereoOdometry | None) -> Iterator[Warning_]:
    """What went wrong with frames and the map."""
    for row in rows:
        if isinstance(row, SkippedPair):
            yield {"code": "frame_skipped", "message": f"frame {row.index}: {row.skipped}"}
        elif row.no_complex is not None and not row.is_lost:
            yield {"code": "no_complex", "message": f"frame {row.index} has a pose, but: {row.no_complex}"}
    tracked = [row for row in rows if isinstance(row, FrameRecord)]
    lost = [row.index for row in tracked if row.is_lost]
    if lost:
        message = (
            f"tracking was lost in {len(lost)} of {len(rows)} frames, first in frame {lost[0]}: "
            "their poses are those of a constant velocity"
        )
        yield {"code": "tracking_lost", "message": message}
    yield from _two_motions(tracked, odometry)
    repeated = len(tracked) - len({row.stamp for row in tracked})
    if repeated:
        message = f"{repeated} frames have the stamp of the one before and no line in the trajectory"
        yield {"code": "equal_stamps", "message": message}
    if odometry and odometry.unsolved:
        message = f"{odometry.unsolved} adjustments of the map had no solution"
        yield {"code": "adjustment", "message": message}
    if odometry and odometry.map.images.forgotten:
        message = (
            f"{odometry.map.images.forgotten} images of old keyframes are gone: the disk had no room for them, or the "
            "source has them no more; their places are not known again"
        )
        yield {"code": "images_forgotten", "message": message}


def _two_motions(tracked: Sequence[FrameRecord], odometry: StereoOdometry | None) -> Iterator[Warning_]:
    """That another motion explains some frames about as well as the one that was taken."""
    doubted = odometry.path.doubted if odometry else []
    if doubted:
        frame, agree, other = doubted[0]
        message = (
            f"{len(doubted)} of {len(tracked)} frames show two motions, first frame {tracked[frame].index}: {agree} "
            f"landmarks agree with the one that was taken, {other} with another, known or not, and the path may go "
            "with what moves"
        )
        yield {"code": "two_motions", "message": message}


def pixel_warnings(bits: int | None, unknown: Sequence[float] = ()) -> Iterator[Warning_]:
    """What was decided of pixels and of a map's values that a user may know better.

    Parameters
    ----------
    bits : int or None
        Bits that 16-bit pixels use, where that was found.
    unknown : sequence of float
        Values of the map that were taken for "not known".

    Yields
    ------
    dict of str to str
        A ``code`` and a ``message``.
    """
    if bits is not None and bits < 16:
        message = f"16-bit pixels use {bits} bits: taken {1 << (16 - bits)} times as bright (--bits for another number)"
        yield {"code": "bits", "message": message}
    if unknown:
        said = " and ".join(f"{value:g}" for value in unknown)
        message = f"{said} in the map stands for 'not known', by how common it is (--unknown for another value)"
        yield {"code": "unknown", "message": message}


def no_response(defined: int) -> Iterator[Warning_]:
    """That nothing came of it all, where no vertex has a response.

    Returns: as `pixel_warnings`.

    Parameters
    ----------
    defined : int
        Vertices with a response.
    """
    if not defined:
        message = (
            "no vertex has a response: none has a signal and two neighbours or more that have one, in other places"
        )
        yield {"code": "no_response", "message": message}


def _few_points(tracked: list[FrameRecord], session: Session) -> Iterator[Warning_]:
    """Frames whose clouds are almost empty for their images."""
    rig, count = session.rig, getattr(session.settings.detector, "count", None)
    fits = rig.width * rig.height / _AREA
    stored = [(row.index, row.complex_) for row in tracked if row.complex_ is not None]
    usual = [min(count if isinstance(count, int) else each.keypoints_left, fits) for _, each in stored]
    few = [(*row, wanted) for row, wanted in zip(stored, usual, strict=True) if row[1].points < _FEW * wanted]
    if few:
        index, first, wanted = few[0]
        message = (
            f"{len(few)} of {len(stored)} clouds are almost empty, first frame {index}: {first.points} "
            f"points of {first.keypoints_left} keypoints, where {wanted:.0f} are usual; is the "
            "image dark, blurred or bare, or are its bits others (--bits)?"
        )
        yield {"code": "few_points", "message": message}


def _surfaces(unpaired: Sequence[str], stored: list[ComplexRecord]) -> Iterator[Warning_]:
    if unpaired:
        names = ", ".join(unpaired[:3])
        yield {"code": "unpaired", "message": f"{len(unpaired)} images have no partner or no stamp: {names}"}
    for verdict in sorted({each.surface for each in stored} - {"image Delaunay", "closed manifold"}):
        yield {"code": "surface", "message": verdict}
