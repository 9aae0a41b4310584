"""What a map is good for: denoise, segment, compare, recognise. Each file is one use, on the public API alone."""

from .._lazy import load_files

__getattr__ = load_files(__name__)
