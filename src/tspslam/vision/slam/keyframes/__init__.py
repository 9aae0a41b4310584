"""The map: keyframes, their images, and landmarks."""

from ...._lazy import load_files

__getattr__ = load_files(__name__)
