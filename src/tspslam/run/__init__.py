"""A source of pairs to a run folder."""

from .._lazy import load_files

__getattr__ = load_files(__name__)
