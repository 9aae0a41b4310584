"""A store opened: its mesh, its responses, and the filter over it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..._brief import Brief
from ..._files import PathLike
from ...topology.harmonic import Centering, Weight
from .filtering import Place, filter_mesh
from .images import ImageReference
from .mesh import StoredMesh, open_mesh
from .stored_response import StoredResponse, names_of, open_response
from .tiled_filter import Options
from .tiles import checked_memory


@dataclass(frozen=True, repr=False)
class Store(Brief):
    """A mesh on disk, larger than the memory perhaps, and its responses. Open it with `open_store`.

    Vertices stand by image and place: *rows*. Their numbers, in which results are told, are those of the source;
    ``len(store)`` is how many there are.

    Attributes
    ----------
    mesh : StoredMesh
        Vertices, faces and images.
    """

    mesh: StoredMesh

    def __len__(self) -> int:
        return self.mesh.n

    @property
    def path(self) -> Path:
        """The folder."""
        return self.mesh.path

    @property
    def n(self) -> int:
        """Number of vertices."""
        return self.mesh.n

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return self.mesh.n_faces

    @property
    def images(self) -> tuple[ImageReference, ...]:
        """What the vertices are seen in."""
        return self.mesh.images

    @property
    def responses(self) -> tuple[str, ...]:
        """Names of the responses that are stored, finished or not."""
        return names_of(self.path)

    def read(self, column: str, first: int, last: int) -> NDArray[Any]:
        """Rows of a column, as `StoredMesh.read`.

        Parameters
        ----------
        column : str
            ``xyz``, ``id`` (the vertex's number), ``uv``, ``luminance``.
        first, last : int
            Which rows.

        Returns
        -------
        (n, k) or (n,) float64 or int64 array
        """
        return self.mesh.read(column, first, last)

    def response(self, name: str) -> StoredResponse:
        """Open responses that were finished.

        Parameters
        ----------
        name : str
            One of `responses`.

        Returns
        -------
        StoredResponse

        Raises
        ------
        InputError
            If there is none of that name, it was not finished, or its files are not whole.
        """
        return open_response(self.mesh, name)

    def filter(
        self, *, order: int = 1, centering: Centering | None = None, weight: Weight | None = None,
        occlusion: float | None = None, memory: float | str = "1.5 GB", workers: int = 0, client: Any = None,
        tile: int | None = None, on_tile: Callable[[int, int], None] | None = None,
    ) -> StoredResponse:  # fmt: skip
        """T-MAHF of every vertex in its image, tile by tile; the same bytes as `tspslam.tmahf` of the whole.

        Tiles that an earlier call has finished are not done again.

        Parameters
        ----------
        order : int
            Angular order m.
        centering : {"none", "mean", "harmonic", "plane"}, optional
            As `tspslam.tmahf`.
        weight : function of int, optional
            As there; it must end within 64 rings.
        occlusion : float, optional
            Share of its depth, 0 to below 1, by which a vertex may lie behind the nearest face before its camera and
            have a signal, as the tolerance of `tspslam.visible_uv`, 0.05 there. Without it no face hides anything.
        memory : float or str
            What a process may take, bytes, or such as "1.5 GB". Tiles are as large as that admits.
        workers : int
            Processes of a Dask cluster on this machine; 0, the default, is this process alone.
        client : distributed.Client, optional
            A cluster that runs already; the store must be visible to its workers by the same path.
        tile : int, optional
            Vertices of a tile, at most, whatever the memory.
        on_tile : callable, optional
            Called with the number of vertices that are done and of all, after each tile.

        Returns
        -------
        StoredResponse

        Raises
        ------
        InputError
            If a setting is not as described, the store has no faces or no luminance, none of its images is there or one
            is damaged, occlusion is asked for and none has a camera, or dask is not installed and asked for.
        OutputError
            If a result cannot be written.

        Examples
        --------
        >>> import tempfile
        >>> import numpy as np
        >>> from tspslam.scale import write_store
        >>> from tspslam.scale.stores.sources import of_arrays
        >>> xyz = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.0]])
        >>> source = of_arrays(xyz, [[0, 1, 2], [1, 2, 3]], uv=xyz[:, :2], luminance=xyz[:, 0])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     response = write_store(f"{folder}/a.zarr", source).filter(centering="plane").read()
        >>> abs(response.z).round(9).tolist()
        [1.0, 1.0, 1.0, 1.0]
        """
        options = Options.checked(order, centering, weight, occlusion)
        place = Place(workers, checked_memory(memory), client)
        return filter_mesh(self.mesh, options, place, tile=tile, on_tile=on_tile)


def open_store(path: PathLike, *, images: PathLike | None = None) -> Store:
    """Open a store that `tspslam.scale.write_store` made, after a look at all its files' sizes.

    Parameters
    ----------
    path : str or path
        The folder.
    images : str or path, optional
        The folder in which the images lie now. Without it they are looked for from the store's place on, then where
        they were.

    Returns
    -------
    Store

    Raises
    ------
    InputError
        If zarr is not installed, the folder is no store, of another version, half-written, or its parts do not fit
        each other.

    Examples
    --------
    >>> open_store("nowhere.zarr")
    Traceback (most recent call last):
    tspslam.errors.InputError: nowhere.zarr: is not there; expected a store: tspslam.scale.write_store makes one
    """
    return Store(open_mesh(path, images=images))
