"""The camera's path: odometry against a map that grows, relocalisation, loop closing, bundle adjustment."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
