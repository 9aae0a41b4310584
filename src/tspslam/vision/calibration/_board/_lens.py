"""Which coefficients of a lens the views of a board determine, and whether a lens is one."""

from __future__ import annotations

import numpy as np

from ....errors import GeometryError, InputError
from ....types import Camera, RawRig
from ..lenses import unproject
from ..rectify import rectification

HELD = {"brown": ("k3",), "rational": ("k3", "k4", "k5", "k6"), "equidistant": ("k3", "k4")}
"""Coefficients that are 0 unless the corners speak for them: where they do not, they bend what no corner shows."""

FREED = {
    "brown": (("k3",),),
    "rational": (("k3",), ("k4",), ("k3", "k4", "k5", "k6")),
    "equidistant": (("k3",), ("k3", "k4")),
}
"""Which of them are tried together."""

EVIDENCE = 10.0
"""Of the Bayesian information criterion: "very strong" (Kass and Raftery 1995)."""

_GRID = (33, 25)  # pixels across and down, to the corners of the image, whose rays are looked up
_NOTED_RAYLESS = 0.02  # of the image: a row or so of the grid
_MOST_RAYLESS = (
    0.5  # of the image: around the largest circle in one of 4:3 lie 41 %, and there a fisheye may see nothing
)


def evidence(before: float, after: float, count: int, freed: int) -> float:
    """Fall of the Bayesian information criterion from one cost to another, with `freed` unknowns more."""
    return float(count * np.log(before / max(after, 1e-300)) - freed * np.log(count))


def is_sound(before: RawRig, after: RawRig) -> bool:
    """Whether lenses with more coefficients have rays where those with fewer had them, and can be rectified."""
    pairs = ((before.left, after.left), (before.right, after.right))
    return all(rayless(now) <= rayless(then) for then, now in pairs) and not why_unusable(after)


def rayless(camera: Camera) -> float:
    """Share of the image that has no ray."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID[0]), np.linspace(0, camera.height - 1, _GRID[1]))
    return float(np.isnan(unproject(camera, np.column_stack([u.ravel(), v.ravel()]))).any(axis=1).mean())


def why_unusable(rig: RawRig) -> str:
    """Say why cameras cannot be rectified; empty where they can."""
    try:
        rectification(rig)
    except (InputError, GeometryError) as error:
        return str(error)
    return ""


def check_lens(rig: RawRig) -> None:
    """Refuse a lens that folds its image, where no view has shown its corners."""
    why = why_unusable(rig)
    for side, camera in (("left", rig.left), ("right", rig.right)):
        if not why and (share := rayless(camera)) > _MOST_RAYLESS:
            why = f"{share:.0%} of the {side} image has no ray through this lens, expected at most {_MOST_RAYLESS:.0%}"
    if why:
        raise InputError(f"board: {why}; views near the corners of the images show what the lens does there")


def lens_doubts(rig: RawRig) -> dict[str, str]:
    """Warn of a lens that has no ray for a part of its image."""
    shares = {"left": rayless(rig.left), "right": rayless(rig.right)}
    side = max(shares, key=lambda name: shares[name])
    if shares[side] <= _NOTED_RAYLESS:
        return {}
    part = f"{shares[side]:.0%} of the {side} image"
    return {"no_ray": f"{part} has no ray through this lens: unless that part is black, show the board there"}
