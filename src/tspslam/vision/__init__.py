"""Images to points: calibration, features, matching, triangulation."""

from .._lazy import load_files

__getattr__ = load_files(__name__)
