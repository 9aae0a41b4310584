"""Calibration files of all kinds, lenses, and the rectification of raw pairs."""

from ..._lazy import load_files

__getattr__ = load_files(__name__)
