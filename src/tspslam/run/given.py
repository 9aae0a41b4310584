"""What a use works on: the map or a frame of a run folder, a file of either, or a mesh, with a posed photo or alone."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._brief import Brief
from .._files import PathLike, bad_input
from ..errors import InputError
from ..frame import Frame
from ..interop.meshes import from_file
from ..io import RunFolder, read_frame, write_frame
from ..io.maps import write_map_ply, write_map_vtu
from ..io.textured import TexturedMesh, read_textured
from ..io.topological import load_map, read_map, write_map
from ..mapping.build import map_of_frame
from ..topological_map import TopologicalMap
from ..topology.complex import Complex
from ..types import FloatArray, Signals
from .guard import MAPS, Kind, check_place

Shown = Frame | TopologicalMap | TexturedMesh


@dataclass(frozen=True, repr=False)
class Given(Brief):
    """A complex with places and signals, whatever it came from.

    Attributes
    ----------
    path : Path
        The run folder or the file.
    shown : Frame or TopologicalMap or TexturedMesh
        What it holds.
    photo : tuple of Path
        The photo of a mesh and the calibration of its camera, where they were read.
    """

    path: Path
    shown: Shown
    photo: tuple[Path, ...] = ()

    @property
    def xyz(self) -> FloatArray:
        """Places, (N, 3), m; of a frame in the camera's frame."""
        return self.shown.cloud.xyz if isinstance(self.shown, Frame) else self.shown.xyz

    @property
    def faces(self) -> NDArray[np.int32]:
        """Triangles, (F, 3), winding kept."""
        return self.shown.faces if isinstance(self.shown, TexturedMesh) else self.shown.surface.faces

    @property
    def complex_(self) -> Complex:
        """Their complex."""
        return self.shown.complex_

    @property
    def signals(self) -> Signals:
        """What is known of luminance."""
        return self.shown.signals

    @property
    def covariance(self) -> FloatArray | None:
        """Covariances of the places, (N, 3, 3), m²; None where they are not known."""
        if isinstance(self.shown, TexturedMesh):
            return None
        return self.shown.cloud.covariance if isinstance(self.shown, Frame) else self.shown.covariance

    @property
    def has_camera(self) -> bool:
        """Whether it can be drawn: it is no mesh without a camera."""
        return not isinstance(self.shown, TexturedMesh)

    @property
    def inputs(self) -> tuple[Path, ...]:
        """All that was read: none of it is written to."""
        return (self.path, *self.photo)

    def as_map(self) -> TopologicalMap | None:
        """Take it as a map.

        Returns
        -------
        TopologicalMap or None
            The map, or the frame as one of a single keyframe; None of a mesh without a camera.
        """
        if isinstance(self.shown, Frame):
            pose = self.shown.T_world_camera
            return map_of_frame(self.shown, self.shown.rig, np.eye(4) if pose is None else pose)
        return None if isinstance(self.shown, TexturedMesh) else self.shown


def open_given(
    source: PathLike, image: PathLike | None = None, calibration: PathLike | None = None,
    *, frame: int | None = None, bits: int | None = None,
) -> Given:  # fmt: skip
    """Read what a use is to work on.

    Parameters
    ----------
    source : path
        A run folder (its map, or the frame of a run of one; with `frame`, that keyframe), a map's or a frame's .npz,
        or a mesh: .vtu and .ply with the signals that they carry, others that `read_mesh` takes without.
    image, calibration : path, optional
        A photo and its camera, for a mesh in the camera's frame.
    frame : int, optional
        Index of a keyframe of a run folder.
    bits : int, optional
        How many bits the image's pixels use if they have 16.

    Returns
    -------
    Given

    Raises
    ------
    InputError
        If something cannot be read, or the arguments do not go together.
    """
    path = Path(source)
    if (image is None) != (calibration is None):
        raise InputError(f"{path}: a photo and the calibration of its camera go together, expected both or neither")
    if image is not None and calibration is not None:
        if path.is_dir():
            raise bad_input(path, "is a folder", "a mesh file to go with a photo")
        seen = from_file(path, image, calibration, bits=bits)
        return Given(path, seen, (Path(image), Path(calibration)))
    if path.is_dir() or not path.suffix:
        if not path.exists():
            raise bad_input(
                path,
                "is not there",
                "a run folder, a map or a frame (.npz), or a mesh (.vtu, .ply, .obj, ...)",
            )
        return Given(path, shown_of_run(path, frame)[1])
    if frame is not None:
        raise bad_input(path, "is a file", "a run folder to go with a frame's index")
    return Given(path, _of_npz(path) if path.suffix.lower() == ".npz" else read_textured(path))


def shown_of_run(run: Path, frame: int | None = None) -> tuple[str, Frame | TopologicalMap]:
    """Read the map of a run, of a run of one frame that frame, or one keyframe; and how files call it.

    Parameters
    ----------
    run : path
        The run folder.
    frame : int, optional
        Index of a keyframe; by default the map.

    Returns
    -------
    str
        ``map``, or the name of the frame's file.
    Frame or TopologicalMap
        What was read.

    Raises
    ------
    InputError
        If it is no run folder, has no such frame, or of several frames no map.
    """
    folder = RunFolder.open(run)
    made = load_map(run) if frame is None and has_map(folder) else None
    if made is not None and len(made.keyframes) > 1:
        return "map", made
    if frame is None and len(folder.stored_frames) > 1:
        raise bad_input(run, "has no map of its keyframes", f"--frame N, such as {folder.stored_frames[0]}")
    first = folder.stored_frames[0] if folder.stored_frames else 0
    stored = folder.finished_frame(first if frame is None else frame)
    return stored.stem, read_frame(stored)


def has_map(folder: RunFolder) -> bool:
    """Tell whether a run has a map, or had one: then it is an error that it is not there.

    Parameters
    ----------
    folder : RunFolder
        The run folder.

    Returns
    -------
    bool
    """
    return folder.map_npz_path.exists() or folder.map_npz_path.name in folder.units


def _of_npz(path: Path) -> Frame | TopologicalMap:
    return read_map(path) if path.is_file() and MAPS["map"].fits(path) else read_frame(path)


def write_shown(
    shown: Shown, output: Path, kind: str, inputs: Iterable[Path],
    *, face: Mapping[str, ArrayLike] | None = None, is_forced: bool = False,
) -> Path:  # fmt: skip
    """Write a map, a frame or a mesh, where `check_place` lets it.

    Parameters
    ----------
    shown : Frame or TopologicalMap or TexturedMesh
        What is written.
    output : path
        The file.
    kind : str
        vtu, ply, or, of a map or a frame, npz.
    inputs : iterable of path
        What was read.
    face : dict of (F,) arrays, optional
        More columns of the faces; not in npz.
    is_forced : bool
        Whether a file of another kind may be overwritten.

    Returns
    -------
    Path
        `output`.

    Raises
    ------
    InputError
        As `check_place`; if a mesh is to go into npz.
    OutputError
        If it cannot be written.
    """
    check_place(output, file_kind(shown, output, kind), inputs, is_forced=is_forced)
    if isinstance(shown, TopologicalMap) and kind == "npz":
        write_map(output, shown)
    elif isinstance(shown, Frame) and kind == "npz":
        write_frame(output, shown)
    else:
        (write_map_vtu if kind == "vtu" else write_map_ply)(output, shown, face=face)
    return output


def file_kind(shown: Shown, output: Path, kind: str) -> Kind:
    """Look up how a file of ours begins.

    Parameters
    ----------
    shown : Frame or TopologicalMap or TexturedMesh
        What will be written.
    output : path
        The file.
    kind : str
        vtu, ply or npz.

    Returns
    -------
    Kind

    Raises
    ------
    InputError
        If it is npz, and a mesh that is neither map nor frame.
    """
    if kind == "npz" and isinstance(shown, TexturedMesh):
        raise bad_input(output, "is a name for a map or a frame alone", "one that ends with .vtu or .ply")
    return MAPS["map" if kind == "npz" and isinstance(shown, TopologicalMap) else kind]


def name_beside(source: PathLike, what: str, suffix: str) -> Path:
    """Name a result of a run folder or a file: its name, what was done, and a suffix, in the folder one is in.

    Parameters
    ----------
    source : path
        The run folder or the file.
    what : str
        What was done.
    suffix : str
        With its dot.

    Returns
    -------
    Path

    Examples
    --------
    >>> name_beside("meshes/part.obj", "denoised", ".vtu").name
    'part-denoised.vtu'
    """
    path = Path(source).resolve()
    stem = path.name if path.is_dir() else path.stem
    return Path(f"{stem}-{what}{suffix}")


def count_of(given: Given) -> dict[str, Any]:
    """Count the vertices, edges and faces of what was given.

    Parameters
    ----------
    given : Given
        What was read.

    Returns
    -------
    dict of str to int
    """
    complex_ = given.complex_
    return {"vertices": complex_.n, "edges": len(complex_.edges), "faces": len(complex_.faces)}


def draw_use(
    given: Given, plot: Path | None, report: Path | None, title: str, numbers: Sequence[tuple[str, Any]],
    *, after: Given | None = None, labels: NDArray[np.int32] | None = None,
) -> None:  # fmt: skip
    """Draw what was made of a map: as a picture, as a page with the map to turn, both, or not at all.

    Parameters
    ----------
    given : Given
        What it was made of.
    plot, report : path, optional
        The PNG and the HTML file.
    title : str
        Of the page.
    numbers : sequence of (name, value)
        For the page.
    after : Given, optional
        The denoised map.
    labels : (F,) int32, optional
        The regions.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    if not (plot or report):
        return
    from ..view.uses import write_denoised_picture, write_regions_picture, write_use_page

    before = given.as_map()
    shown = before if after is None else after.as_map()
    if before is None or shown is None:
        raise bad_input(given.path, "is a mesh without a camera", "a run, a map or a frame to draw")
    with tempfile.TemporaryDirectory() as folder:
        picture = plot or Path(folder) / "picture.png"
        if labels is not None:
            write_regions_picture(shown, labels, picture)
        else:
            write_denoised_picture(before, shown, picture)
        if report:
            write_use_page(
                shown, title, numbers, [picture], report, labels=labels, before=None if after is None else before
            )
