"""Points and an image to a complex, signals on its vertices, edges and faces, and their harmonic response."""

from .._lazy import load_files

__getattr__ = load_files(__name__)
