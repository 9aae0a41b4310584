"""Rows on their way to a store: files of raw rows beside it, so that sorting takes the memory of one of them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._atomic import bad_output

BUCKETS = 256
"""Files that rows are sorted into: as many may be open at a time everywhere."""


class Buckets:
    """Rows in files by the number of a bucket, in the order in which they come."""

    def __init__(self, folder: Path, name: str, dtype: np.dtype[Any]) -> None:
        self._paths = [folder / f"{name}-{bucket:03d}.raw" for bucket in range(BUCKETS)]
        self._dtype = dtype

    def append(self, bucket: NDArray[Any], rows: NDArray[Any]) -> None:
        """Add rows (N,) of the structured type, each to its bucket (N,), below `BUCKETS`."""
        order = np.argsort(bucket.astype(np.uint16), kind="stable")
        ordered, start = rows[order], np.searchsorted(bucket[order], np.arange(BUCKETS + 1))
        for k in np.flatnonzero(np.diff(start)).tolist():
            append_rows(self._paths[k], ordered[start[k] : start[k + 1]])

    def drain(self) -> Iterator[NDArray[Any]]:
        """Give the rows of each bucket, an empty one too, and remove its file."""
        for path in self._paths:
            yield np.fromfile(path, self._dtype) if path.exists() else np.empty(0, self._dtype)
            path.unlink(missing_ok=True)


def append_rows(path: Path, rows: NDArray[Any]) -> None:
    """Add rows to a file of raw rows; `OutputError` where there is no room."""
    try:
        with open(path, "ab") as handle:
            handle.write(np.ascontiguousarray(rows).tobytes())
    except OSError as error:
        raise bad_output(path, error) from error


def blocks_of(path: Path, dtype: np.dtype[Any], rows: int) -> Iterator[NDArray[Any]]:
    """Read a file of raw rows, so many at a time."""
    if not path.exists():
        return
    with open(path, "rb") as handle:
        while len(block := np.fromfile(handle, dtype, rows)):
            yield block
