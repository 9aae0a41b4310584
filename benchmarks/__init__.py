"""Figures of tspslam beside named references measured in the same run: ``python -m benchmarks``."""
