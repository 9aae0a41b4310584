"""What a map is good for: denoise, segment, compare, recognise. Each file is one use, on the public API alone."""
