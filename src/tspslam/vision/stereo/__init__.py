"""A pair of images to points: matching along rows, disparity maps, triangulation."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
