"""The back end: what is adjusted together, and how the error of a loop is taken out of the map."""

from ...._lazy import load_files

__getattr__ = load_files(__name__)
