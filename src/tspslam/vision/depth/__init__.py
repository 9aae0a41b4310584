"""Depth cameras: how their depths scatter, which belong to no surface, and how another camera sees them."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
