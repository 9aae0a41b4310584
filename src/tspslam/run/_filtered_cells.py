"""The response of a mesh whose faces stay polygons: cells of the triangles that they are cut into."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..frame import Frame
from ..topology.cells import CellComplex, merge_cells, merge_signals
from ..topology.harmonic import Tmahf

POLYGONS = ("fan", "cells")
"""What becomes of faces of more than three corners: triangles, or cells of a complex."""


def answer_on_cells(frame: Frame, face_of: NDArray[np.int64], stage: Tmahf) -> tuple[Frame, CellComplex]:
    """Filter a frame on the faces that its triangles were cut from.

    Parameters
    ----------
    frame : Frame
        With the triangles of a mesh.
    face_of : (F,) int64
        The face that each triangle is of.
    stage : Tmahf
        The filter.

    Returns
    -------
    Frame
        With the response on the cells; its complex and its signals stay those of the triangles, which files hold.
    CellComplex
        What the response is of: sides of faces, and no diagonals.

    Raises
    ------
    InputError
        If two triangles have the same corners, or those of a face are no disc.
    """
    if len(frame.complex_.faces) != len(face_of):
        twice = len(face_of) - len(frame.complex_.faces)
        raise InputError(f"{twice} triangles have the corners of another, expected faces that do not cover each other")
    cells = merge_cells(frame.complex_, face_of)
    signals = merge_signals(frame.complex_, face_of, frame.signals)
    return replace(frame, response=stage(cells, frame.cloud.uv, signals)), cells
