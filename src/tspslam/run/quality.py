"""``tspslam quality``: a distorted map, frame or mesh beside its original."""

from __future__ import annotations

from typing import Any

from ..apps.quality import Quality, compare_quality
from ..errors import InputError
from .given import Given


def compare_given(reference: Given, distorted: Given) -> Quality:
    """Compare two textured complexes.

    Parameters
    ----------
    reference, distorted : Given
        As `open_given` reads them.

    Returns
    -------
    Quality

    Raises
    ------
    InputError
        If they cannot be compared; the line says which file it is about.
    """
    try:
        return compare_quality(*((each.xyz, each.complex_, each.signals) for each in (reference, distorted)))
    except InputError as error:
        raise InputError(f"{reference.path} and {distorted.path}: {error}") from error


def describe_quality(found: Quality) -> dict[str, Any]:
    """Make what JSON can hold of a comparison.

    Parameters
    ----------
    found : Quality
        The comparison.

    Returns
    -------
    dict
        ``score`` and ``parts``.
    """
    return {"score": float(found.score), "parts": {name: float(value) for name, value in found.parts.items()}}
