"""Many maps: finished runs of one place become one map, on Dask."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
