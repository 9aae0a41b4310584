"""The images that a store's vertices are seen in: where they lie, and where in them a vertex falls."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..._brief import Brief
from ..._checks import is_rigid, require_path
from ..._files import bad_input
from ...errors import InputError
from ...types import FloatArray, Rig
from ...vision.rig import project


@dataclass(frozen=True, repr=False)
class ImageReference(Brief):
    """An image by its path, with what tells where a vertex falls in it: a posed camera, or a place in a plane.

    Attributes
    ----------
    path : str
        The image file, or a stored frame (.npz) whose image it is.
    rig : Rig or None
        The camera that took it; with one, vertices are projected.
    T_world_camera : (4, 4) float array or None
        Its pose, m; the world by default. Goes with `rig`.
    origin : (u, v) or None
        Where the image's pixel (0, 0) lies in the plane of the vertices' `uv`, px; (0, 0) without a camera. Tiles
        of an orthophoto are images of this kind.

    Raises
    ------
    InputError
        If the pose is no rigid motion, an origin is not finite, or a camera and an origin are given at once.

    Examples
    --------
    >>> tile = ImageReference("tile.png", origin=(100.0, 0.0))
    >>> tile.places(np.zeros((1, 3)), np.array([[101.0, 2.0]])).tolist()
    [[1.0, 2.0]]
    """

    path: str
    rig: Rig | None = None
    T_world_camera: ArrayLike | None = None
    origin: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        require_path(self.path, "image")
        object.__setattr__(self, "path", os.fspath(self.path))
        if self.rig is None and self.T_world_camera is not None:
            raise InputError(f"image {self.path}: has a pose and no camera, expected both, or an origin")
        if self.rig is not None and self.origin is not None:
            raise InputError(f"image {self.path}: has a camera and an origin, expected one of them")
        T = self.pose
        if T.shape != (4, 4) or not is_rigid(T):
            raise InputError(f"image {self.path}: T_world_camera is no rigid motion, expected a pose (4, 4)")
        if np.shape(self.corner) != (2,) or not np.isfinite(self.corner).all():
            raise InputError(f"image {self.path}: origin is {self.origin}, expected (u, v), finite, px")

    @cached_property
    def pose(self) -> FloatArray:
        """Pose of the camera, (4, 4) float64."""
        return np.eye(4) if self.T_world_camera is None else np.array(self.T_world_camera, np.float64)

    @property
    def corner(self) -> FloatArray:
        """Where pixel (0, 0) lies in the plane of the vertices' uv, (2,) float64, px."""
        return np.array(self.origin or (0.0, 0.0), np.float64)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px: the camera's, or that of the file; `InputError` where it is not there."""
        from ...io import image_size

        return image_size(self.path) if self.rig is None else (self.rig.width, self.rig.height)

    def places(self, xyz: FloatArray | None, uv: FloatArray | None) -> FloatArray:
        """Where vertices fall in the image; each row depends on its own vertex alone, to the last bit.

        Parameters
        ----------
        xyz : (N, 3) float64 or None
            Vertices, m; for an image with a camera.
        uv : (N, 2) float64 or None
            Theirs in the common plane, px; for an image without a camera.

        Returns
        -------
        (N, 2) float64
            px, also outside the image; NaN behind the camera.

        Raises
        ------
        InputError
            If what the image needs of them is not given.
        """
        if self.rig is None:
            if uv is None:
                raise InputError(f"image {self.path}: has no camera, and the vertices no uv; expected one of them")
            return np.asarray(uv, np.float64) - self.corner
        if xyz is None:
            raise InputError(f"image {self.path}: has a camera, and the vertices no xyz; expected both")
        return project(self.rig, self.in_camera(xyz))

    @property
    def camera(self) -> Rig:
        """The camera; `InputError` where there is none."""
        if self.rig is None:
            raise InputError(f"image {self.path}: has no camera, expected one")
        return self.rig

    def in_camera(self, xyz: FloatArray) -> FloatArray:
        """Vertices in the camera's frame; each row depends on its own vertex alone, to the last bit.

        Parameters
        ----------
        xyz : (N, 3) float64
            Vertices in the world, m.

        Returns
        -------
        (N, 3) float64
            m.
        """
        R, t = self.pose[:3, :3], self.pose[:3, 3]
        x, y, z = (np.asarray(xyz, np.float64) - t).T
        # No product of matrices: how it sums may depend on how many rows there are.
        return np.stack([x * R[0, k] + y * R[1, k] + z * R[2, k] for k in range(3)], axis=1)

    def load(self, path: Path) -> NDArray[Any] | None:
        """Read the pixels.

        Parameters
        ----------
        path : Path
            Where the file lies now.

        Returns
        -------
        (H, W) or (H, W, 3) uint8, uint16 or float array, or None
            None where the file is not there, or the stored frame has no image.

        Raises
        ------
        InputError
            If it is there and damaged, or has not the camera's size.
        """
        from ...io import read_frame, read_image

        if not os.path.exists(path):
            return None
        pixels: NDArray[Any] | None = read_frame(path).image if path.suffix.lower() == ".npz" else read_image(path)
        if pixels is not None and self.rig is not None and pixels.shape[:2] != (self.rig.height, self.rig.width):
            said = f"has {pixels.shape[1]} x {pixels.shape[0]} px"
            raise bad_input(path, said, f"the camera's {self.rig.width} x {self.rig.height}")
        return pixels


def to_json(image: ImageReference, store: Path) -> dict[str, Any]:
    """Describe a reference for a store's attributes, the path also from the store's place on.

    Parameters
    ----------
    image : ImageReference
        The reference.
    store : Path
        Where the store will lie.

    Returns
    -------
    dict
    """
    place = os.path.abspath(image.path)
    try:
        relative = os.path.relpath(place, os.path.abspath(store))
    except ValueError:  # on another drive
        relative = place
    rig = None
    if image.rig is not None:
        rig = {name: value for name, value in vars(image.rig).items() if isinstance(value, int | float)}
    return {
        "path": place,
        "relative": relative,
        "rig": rig,
        "T_world_camera": image.pose.tolist() if rig else None,
        "origin": image.corner.tolist() if rig is None else None,
    }


def from_json(values: dict[str, Any]) -> ImageReference:
    """Make a reference of what `to_json` gave.

    Parameters
    ----------
    values : dict
        Its description.

    Returns
    -------
    ImageReference
    """
    rig = None if values["rig"] is None else Rig(**values["rig"])
    origin = None if values["origin"] is None else (float(values["origin"][0]), float(values["origin"][1]))
    return ImageReference(values["path"], rig, values["T_world_camera"], origin)
