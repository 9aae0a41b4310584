"""A page with nothing but a mesh or a map in space, to turn."""

from __future__ import annotations

from pathlib import Path

from .._atomic import make_folder, write_bytes
from .._checks import told
from ..errors import InputError
from ..frame import Frame
from ..topological_map import TopologicalMap
from ._frame import check_frame
from ._html import page_of, text
from ._map import check_map
from ._turning import frame_to_turn, map_to_turn


def write_scene(shown: Frame | TopologicalMap, path: str | Path) -> Path:
    """Write the mesh of a frame, or a map with its path, as one HTML file to turn; it loads nothing from anywhere.

    Parameters
    ----------
    shown : Frame or TopologicalMap
        What to show; a frame with its image.
    path : path
        The HTML file.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    InputError
        If it is neither, or its parts do not belong together.
    OutputError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from tspslam import Cloud, Response, Rig, Surface, build_complex, sample_signals
    >>> uv, faces, image = np.array([[1.0, 1], [8, 2], [3, 7]]), np.array([[0, 1, 2]], np.int32), np.eye(10)
    >>> rig, complex_ = Rig(10, 10, 5, 5, width=10, height=10), build_complex(faces, 3)
    >>> cloud = Cloud(np.insert(uv / 10, 2, 5.0, axis=1), uv, np.ones(3))
    >>> signals, response = sample_signals(image, uv, complex_), Response(np.ones(3, complex), 1, np.ones(3, bool))
    >>> frame = Frame(0, 0.0, "toy", rig, cloud, Surface(faces), complex_, signals, response, image=image)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_scene(frame, f"{folder}/mesh.html").name
    'mesh.html'
    """
    if isinstance(shown, TopologicalMap):
        check_map(shown)
        name = f"map of {len(shown.keyframes)} keyframes"
        section = f'<section class="scene"><h2>The map in space</h2>{map_to_turn(shown)}</section>'
    elif isinstance(shown, Frame):
        check_frame(shown)
        name, section = shown.name, frame_to_turn(shown)
    else:
        raise InputError(f"scene: what to show is {told(shown)}, expected a Frame or a TopologicalMap")
    page = page_of(f"TSP-SLAM: {name}", [f"<h1>{text(name)}</h1>", section])
    make_folder(Path(path).parent)
    write_bytes(path, page.encode("utf-8", "replace"))
    return Path(path)
