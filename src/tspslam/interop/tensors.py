"""Matrices and signals of a complex as PyTorch tensors: one by one, or as a dictionary for PyTorch Geometric."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..io.tensors import arrays_of_complex
from ..topology.complex import Complex
from ..types import Signals


def to_torch(matrix: Any, dtype: Any = None) -> Any:
    """Give a sparse matrix to PyTorch: an incidence matrix, a Laplacian, a neighbourhood.

    Parameters
    ----------
    matrix : (n, m) SciPy sparse array or matrix
        Of any format; real numbers.
    dtype : torch.dtype, optional
        Type of the values; ``torch.float32`` by default.

    Returns
    -------
    (n, m) torch.Tensor
        Sparse COO on the CPU, coalesced (rows ascending, columns ascending in a row); a copy.

    Raises
    ------
    InputError
        If PyTorch is not installed, or `matrix` or `dtype` is not as described.

    Examples
    --------
    With PyTorch installed::

        import torch
        from tspslam import build_complex
        from tspslam.interop.tensors import to_torch

        disc = build_complex([[0, 1, 2], [0, 2, 3]], 4)
        B1 = to_torch(disc.B1)  # (4, 5)
        flow = torch.ones(5, 1)
        divergence = B1 @ flow  # (4, 1)
        unsigned = B1.abs()
    """
    torch = _torch()
    entries = _entries(matrix)
    if dtype is not None and not isinstance(dtype, torch.dtype):
        raise InputError(f"dtype is {dtype!r}, expected a torch.dtype such as torch.float64")
    indices = torch.from_numpy(np.stack([entries.row, entries.col]).astype(np.int64))
    values = torch.from_numpy(entries.data.astype(np.float64)).to(dtype or torch.float32)
    return torch.sparse_coo_tensor(indices, values, entries.shape, check_invariants=True).coalesce()


def to_pyg(complex_: Complex, signals: Signals) -> dict[str, Any]:
    """Give a complex and its signals to PyTorch, under the names of PyTorch Geometric where that has one.

    ``torch_geometric.data.Data(**to_pyg(complex_, signals))`` is a graph for any of its layers; what belongs to edges
    and faces is there for layers that use them. PyTorch Geometric itself is not needed.

    Parameters
    ----------
    complex_ : Complex
        N vertices, E edges, F faces; polygons will do.
    signals : Signals
        Its signals, of C channels (C = 1 for signals of shape (n,)).

    Returns
    -------
    dict of str to torch.Tensor
        On the CPU, copies.

        x : (N, C) float32
            Vertex signals, the same tensor as ``x_0``.
        edge_index : (2, 2E) int64
            Both directions of every edge: column k is edge k from i to j > i, column E + k the same from j to i.
        edge_attr : (2E, C) float32
            Edge signals of those columns: ``x_1`` twice, for these signals have no direction.
        face : (3, F) int64
            Vertices of each triangle, ascending. Absent for polygons.
        x_0, x_1, x_2 : (N, C), (E, C), (F, C) float32
            Signals of vertices, edges and faces; 0 where there is none.
        ok_0, ok_1, ok_2 : (N,), (E,), (F,) bool
            False where there is no signal.
        incidence_1 : (N, E) float32, sparse COO, coalesced
            ``B1``, -1 and +1 at the ends of each edge. Its ``abs()`` is the incidence of unsigned signals.
        incidence_2 : (E, F) float32, sparse COO, coalesced
            ``B2``, ±1 at the edges of each face.

    Raises
    ------
    InputError
        If PyTorch is not installed, or the signals are not those of this complex.

    Notes
    -----
    A ``Batch`` of PyTorch Geometric moves ``edge_index`` and ``face`` along, but sets sparse matrices on a diagonal
    only if their name has "adj" in it: rename the incidence matrices before you batch.

    Examples
    --------
    With PyTorch installed, a step of messages from edges to vertices::

        import numpy as np
        from tspslam import build_complex, sample_signals
        from tspslam.interop.tensors import to_pyg

        disc = build_complex([[0, 1, 2], [0, 2, 3]], 4)
        image = np.random.default_rng(0).random((9, 9))
        signals = sample_signals(image, [[0, 0], [8, 0], [8, 8], [0, 8]], disc)
        data = to_pyg(disc, signals)
        messages = data["incidence_1"].abs() @ data["x_1"]  # (4, 1)
    """
    torch = _torch()
    _check_sizes(complex_, signals)
    arrays = arrays_of_complex(complex_, signals)
    data = {name: torch.from_numpy(values) for name, values in arrays.items() if not name.startswith("B")}
    data["x"] = data["x_0"]
    return data | {"incidence_1": to_torch(complex_.B1), "incidence_2": to_torch(complex_.B2)}


def _entries(matrix: Any) -> Any:
    """Rows, columns and values of a sparse matrix: SciPy's COO."""
    from scipy.sparse import issparse

    sparse: Any = matrix  # what issparse narrows has no shape
    if not issparse(matrix) or len(sparse.shape) != 2 or sparse.dtype.kind not in "biuf":
        found = f"{type(sparse).__name__} of shape {np.shape(sparse)}"
        raise InputError(f"matrix is {found}, expected a SciPy sparse matrix of real numbers")
    return sparse.tocoo()


def _masks(signals: Signals) -> tuple[NDArray[np.bool_], ...]:
    return signals.vertex_ok, signals.edge_ok, signals.face_ok


def _check_sizes(complex_: Complex, signals: Signals) -> None:
    expected = (complex_.n, len(complex_.edges), len(complex_.faces))
    found = (len(signals.vertex), len(signals.edge), len(signals.face))
    if found != expected or tuple(len(mask) for mask in _masks(signals)) != expected:
        raise InputError(f"signals are of {found} vertices, edges and faces, expected those of the complex, {expected}")


def _torch() -> Any:
    try:
        return importlib.import_module("torch")
    except ImportError as error:
        raise InputError("PyTorch is not installed, expected an installation of it: pip install torch") from error
