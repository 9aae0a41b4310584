"""Keypoints and their descriptors."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
