"""The responses of a tile: its piece of the mesh, the image of its vertices, signals, T-MAHF."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..._brief import brief
from ...errors import InputError
from ...topology.complex import Complex
from ...topology.harmonic import Centering, Tmahf, Weight, tmahf
from ...topology.spectral import checked_number
from ...topology.texture import sample_signals
from ...types import BoolArray, FloatArray, Signals
from ._last import LastMade
from .halo import Piece, load_piece
from .hidden import seen_places
from .mesh import StoredMesh

MOST_RINGS = 64
"""Topological distance at which a weight must have ended: a halo is as wide."""


@dataclass(frozen=True)
class Options:
    """What decides the responses of a store.

    Attributes
    ----------
    order : int
        Angular order m.
    centering : str
        What is taken out of the sums.
    weights : tuple of float or None
        g(0), g(1), ... up to the last above 0; None is the one-ring.
    occlusion : float or None
        Share of its depth by which a vertex may lie behind the nearest face; None: faces hide nothing.

    Examples
    --------
    >>> Options.checked(1, None, lambda d: (1, 0.5, 0)[d]).weights
    (1.0, 0.5)
    """

    order: int
    centering: str
    weights: tuple[float, ...] | None
    occlusion: float | None = None

    @classmethod
    def checked(
        cls, order: int, centering: Centering | None, weight: Weight | None, occlusion: float | None = None
    ) -> Options:
        """Check options as `tspslam.tmahf` does, and put numbers in the place of a function.

        Parameters
        ----------
        order : int
            Angular order m.
        centering : str, optional
            As `tspslam.tmahf`.
        weight : function of int, optional
            As there.
        occlusion : float, optional
            From 0 to below 1.

        Returns
        -------
        Options

        Raises
        ------
        InputError
            As there, or if the weight does not end within 64 rings, or `occlusion` is no share.
        """
        from ...topology.harmonic import _weights_by_distance

        Tmahf(order, centering)
        chosen = centering if centering is not None else ("harmonic" if order else "none")
        weights = None if weight is None else tuple(_weights_by_distance(weight, MOST_RINGS).tolist())
        if weights is not None and len(weights) > MOST_RINGS:
            raise InputError(f"weight({MOST_RINGS}) is {weights[-1]:g}, expected 0 there or before: a halo is as wide")
        share = None if occlusion is None else checked_number(occlusion, "occlusion", 0.0, 1.0) + 0.0  # no -0: one name
        return cls(int(order), chosen, weights, share)

    @classmethod
    def of(cls, values: Mapping[str, Any]) -> Options:
        """Make options of their JSON.

        Parameters
        ----------
        values : dict
            As ``vars`` gives them.

        Returns
        -------
        Options
        """
        weights = values["weights"]
        share = values.get("occlusion")
        return cls(
            int(values["order"]), str(values["centering"]), None if weights is None else tuple(weights),
            None if share is None else float(share),
        )  # fmt: skip

    @property
    def rings(self) -> int:
        """How far the filter looks, in topological distance."""
        return 1 if self.weights is None else len(self.weights) - 1

    @property
    def name(self) -> str:
        """What the responses are called in the store."""
        parts = [f"tmahf-{self.order}-{self.centering}"]
        if self.weights is not None:
            parts.append(hashlib.sha256(repr(self.weights).encode()).hexdigest()[:8])
        if self.occlusion is not None:
            parts.append(f"seen-{self.occlusion!r}")
        return "-".join(parts)


class Answer(NamedTuple):
    """Responses of a run of rows.

    Attributes
    ----------
    z : (n,) complex128
        In the order of the rows.
    defined : (n,) bool
        Where there is one.
    missing : tuple of int
        Images that are not there; vertices that are seen in them have no response.
    """

    z: NDArray[np.complex128]
    defined: BoolArray
    missing: tuple[int, ...]

    def __repr__(self) -> str:
        return brief(self)


def filter_rows(store: StoredMesh, options: Options, first: int, last: int, tile: int) -> Answer:
    """Filter a run of rows, so many at a time; the responses do not depend on how many.

    Parameters
    ----------
    store : StoredMesh
        The store.
    options : Options
        The filter.
    first, last : int
        Which rows.
    tile : int
        Vertices that are filtered at a time, at most.

    Returns
    -------
    Answer

    Raises
    ------
    InputError
        If a chunk or an image is damaged.
    """
    z, defined = np.zeros(last - first, np.complex128), np.zeros(last - first, bool)
    missing = []
    for low, high, image in image_parts(store, first, last, tile):
        pixels = _pixels(store, image) if image >= 0 else None
        if image >= 0 and pixels is None:
            missing.append(image)
        if pixels is None and (store.images or "luminance" not in store.arrays):
            continue
        piece = load_piece(store, low, high, options.rings, _columns(store, image))
        response = _respond(store, piece, pixels, image, options)
        z[low - first : high - first], defined[low - first : high - first] = response
    return Answer(z, defined, tuple(sorted(set(missing))))


def _columns(store: StoredMesh, image: int) -> tuple[str, ...]:
    """What is needed of the vertices that are seen in an image, or in none."""
    if image >= 0:
        return ("uv",) if store.images[image].rig is None else ("xyz",)
    return "luminance", "uv" if "uv" in store.arrays else "xyz"


def image_parts(store: StoredMesh, first: int, last: int, tile: int) -> Iterator[tuple[int, int, int]]:
    """Cut rows into runs of one image each.

    Parameters
    ----------
    store : StoredMesh
        The store.
    first, last : int
        Rows.
    tile : int
        Rows of a run, at most.

    Yields
    ------
    first, last : int
        Rows of a run.
    image : int
        Its image; -1 is none.
    """
    ends = [*store.image_start.tolist()]
    for image, end in enumerate(ends, start=-1):
        begin = ends[image] if image >= 0 else 0
        for low in range(max(begin, first), min(end, last), tile):
            yield low, min(low + tile, end, last), image


def _respond(
    store: StoredMesh, piece: Piece, pixels: NDArray[Any] | None, image: int, options: Options
) -> tuple[NDArray[np.complex128], BoolArray]:
    complex_ = piece.complex_
    if pixels is None:
        assert piece.luminance is not None
        uv = piece.uv if piece.xyz is None else plane_of(piece.xyz)
        assert uv is not None
        signals = spread_values(complex_, uv, piece.luminance)
    else:
        uv = _places(store, piece, image, options.occlusion)
        signals = sample_signals(pixels, uv, complex_)
    weights = options.weights
    weight = None if weights is None else (lambda d: weights[d] if d < len(weights) else 0.0)
    centering = cast(Centering, options.centering)
    response = tmahf(complex_, uv, signals, order=options.order, centering=centering, weight=weight)
    return response.z[piece.own], response.defined[piece.own]


def _places(store: StoredMesh, piece: Piece, image: int, occlusion: float | None) -> FloatArray:
    if occlusion is None or store.images[image].rig is None:
        return store.images[image].places(piece.xyz, piece.uv)
    assert piece.xyz is not None
    return seen_places(store, image, piece.xyz, occlusion)


def signals_of(store: StoredMesh, complex_: Complex, image: int, columns: Mapping[str, FloatArray]) -> Signals | None:
    """Signals of a part of a store in one image.

    Parameters
    ----------
    store : StoredMesh
        The store.
    complex_ : Complex
        The part.
    image : int
        The image; -1 is none, where the vertices' own luminance is taken.
    columns : dict of (N, k) or (N,) float64 arrays
        ``xyz``, ``uv`` and ``luminance`` of the part's vertices, as far as the store has them.

    Returns
    -------
    Signals or None
        None where there is no luminance, or the image is not there.
    """
    if image >= 0:
        pixels = _pixels(store, image)
        uv = store.images[image].places(columns["xyz"], columns.get("uv"))
        return None if pixels is None else sample_signals(pixels, uv, complex_)
    if store.images or "luminance" not in columns:
        return None
    return spread_values(complex_, columns.get("uv", plane_of(columns["xyz"])), columns["luminance"])


def plane_of(xyz: FloatArray) -> FloatArray:
    """Where vertices fall in the plane seen from above, z up: u is x, v is -y, m.

    Parameters
    ----------
    xyz : (N, 3) float64
        Vertices, m.

    Returns
    -------
    (N, 2) float64
    """
    return np.stack([xyz[:, 0], -xyz[:, 1]], axis=1)


def spread_values(complex_: Complex, uv: FloatArray, values: FloatArray) -> Signals:
    """Signals on all levels of values at the vertices: an edge and a face have the mean of their vertices.

    Parameters
    ----------
    complex_ : Complex
        Triangles.
    uv : (N, 2) float64
        Places of the vertices, any unit.
    values : (N,) float64
        NaN where there is none.

    Returns
    -------
    Signals

    Examples
    --------
    >>> from tspslam import build_complex
    >>> spread_values(build_complex([[0, 1, 2]], 3), np.eye(3)[:, :2], np.array([0, 3.0, 6])).face.tolist()
    [3.0]
    """
    ok = np.isfinite(values) & np.isfinite(uv).all(axis=1)
    known, places = np.where(ok, values, 0.0), np.where(ok[:, None], uv, 0.0)
    levels: dict[str, Any] = {"vertex": known, "vertex_ok": ok}
    for level, simplices in (("edge", complex_.edges), ("face", complex_.faces)):
        corners = simplices.T
        there = np.logical_and.reduce([ok[each] for each in corners])
        total, place = known[corners[0]].copy(), places[corners[0]].copy()
        for each in corners[1:]:  # one after another: the order of a sum is part of its value
            total += known[each]
            place += places[each]
        levels[level], levels[f"{level}_ok"] = np.where(there, total / len(corners), 0.0), there
        levels[f"{level}_uv"] = np.where(there[:, None], place / len(corners), 0.0)
        levels[f"{level}_pixels"] = np.zeros(len(simplices), np.int32)
    return Signals(**levels)


def _pixels(store: StoredMesh, image: int) -> NDArray[Any] | None:
    """The image's pixels; a thread keeps its last ones, since the tiles of an image follow each other."""
    path, reference = store.image_paths[image], store.images[image]
    try:
        status = path.stat()
    except OSError:
        return None
    key = (path, status.st_mtime_ns, status.st_size, reference.rig)
    return _kept.get(key, lambda: reference.load(path))


_kept: LastMade[NDArray[Any] | None] = LastMade()
