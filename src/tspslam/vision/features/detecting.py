"""Keypoints of an image of which a part may not have been seen: none whose patch reaches there."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from ...types import Features
from ..images import Detector, PreparedImage, are_usable


def detect_usable(image: PreparedImage, detect: Detector) -> Features:
    """Detect keypoints, and drop those whose patch reaches pixels that the camera did not see.

    Parameters
    ----------
    image : PreparedImage
        The image, and its usable pixels.
    detect : callable
        Grey image (H, W) uint8 -> `Features`.

    Returns
    -------
    Features
        What the detector gave, where all pixels are usable.

    Examples
    --------
    >>> from tspslam import OrbDetector, datasets
    >>> image = PreparedImage(datasets.motorcycle().left)
    >>> right_half = np.arange(741) > 370
    >>> seen = PreparedImage(image.image, np.broadcast_to(right_half, (500, 741)))
    >>> bool(detect_usable(seen, OrbDetector()).uv[:, 0].min() > 370)
    True
    """
    found = image.features(detect)
    if image.usable is None or not isinstance(found, Features) or np.shape(found.uv)[1:] != (2,):
        return found  # what a detector of one's own gives is looked at by those who ask
    rows = are_usable(image.usable, found.uv)
    return found if rows.all() else Features(*(getattr(found, each.name)[rows] for each in fields(Features)))
