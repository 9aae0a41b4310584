"""What is larger than one sequence or one machine: many recordings, huge clouds, on Dask."""

from .._lazy import load_files

__getattr__ = load_files(__name__)
