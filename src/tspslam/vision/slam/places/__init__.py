"""Places seen before: relocalisation and loop closing."""

from ...._lazy import load_files

__getattr__ = load_files(__name__)
