"""Least squares: bundle adjustment, and its kernels."""

from ...._lazy import load_files

__getattr__ = load_files(__name__)
