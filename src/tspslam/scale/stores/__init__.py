"""Clouds larger than the memory: a mesh in chunks on disk, filtered tile by tile."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
