"""Where a frame was taken: near a motion or anywhere, which pose is believed, and how well it is known."""

from ...._lazy import load_files

__getattr__ = load_files(__name__)
