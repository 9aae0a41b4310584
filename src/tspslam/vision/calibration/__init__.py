"""Calibration files of all kinds, lenses, and the rectification of raw pairs."""
