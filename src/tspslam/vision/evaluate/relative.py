"""What errors of motions are over: one length of the way, of time or of frames, or the sections of KITTI's table."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import NamedTuple

from ...errors import InputError

_DELTA = re.compile(r"([0-9]{1,9}(?:\.[0-9]{1,9})?)(f|m|s)")


@dataclass(frozen=True)
class DistanceErrors:
    """Errors of the motion over one length.

    Attributes
    ----------
    pairs : int
        Of poses that are so far apart along the true path, or in time, to a tenth, each start with its nearest end; or
        so many frames apart.
    translation_m : float
        Root mean square, m; 0 without pairs.
    translation_percent : float
        Mean error over the mean distance along the true path, %; 0 without pairs.
    rotation_deg : float
        Root mean square, degrees; 0 without pairs.
    """

    pairs: int
    translation_m: float
    translation_percent: float
    rotation_deg: float


@dataclass(frozen=True)
class KittiErrors:
    """The table of KITTI's odometry benchmark: errors of sections of 100, 200, ..., 800 m (Geiger et al. 2012).

    A section starts at every tenth matched pose, and ends at the first that is farther along the true path than its
    length. Its errors are ``|t(E)| / length`` and ``∠R(E) / length``, with ``E = (P_i⁻¹ P_j)⁻¹ (Q_i⁻¹ Q_j)``, P
    estimated and Q true.

    Attributes
    ----------
    translation_percent : float
        Mean over all sections of all lengths, %; 0 without one.
    rotation_deg_100m : float
        The same of rotations, degrees per 100 m.
    per_length : dict of float to (int, float, float)
        Of each length, m, that the path is long enough for: sections, %, degrees per 100 m.
    travelled_m : float
        Length of the true path from the first matched pose to the last, m.
    """

    translation_percent: float
    rotation_deg_100m: float
    per_length: dict[float, tuple[int, float, float]]
    travelled_m: float


class Delta(NamedTuple):
    """A length over which motions are compared: so many of a unit."""

    size: float
    unit: str


def parse_delta(text: str) -> Delta:
    """Parse a length with its unit: frames (f), metres (m) or seconds (s).

    Parameters
    ----------
    text : str
        Such as ``1f``, ``10m``, ``0.5s``.

    Returns
    -------
    Delta

    Raises
    ------
    InputError
        If it is none, or 0.

    Examples
    --------
    >>> parse_delta("2.5m")
    Delta(size=2.5, unit='m')
    """
    found = _DELTA.fullmatch(text.strip()) if isinstance(text, str) else None
    if found is None or float(found[1]) == 0 or (found[2] == "f" and "." in found[1]):
        raise InputError(
            f"delta {text!r:.40} is no length, expected frames, metres or seconds, such as 1f, 10m or 0.5s"
        )
    return Delta(float(found[1]), found[2])
