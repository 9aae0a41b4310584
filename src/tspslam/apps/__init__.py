"""What a map is good for: denoising, segmentation, quality, recognition. Each file is one use, on the public API alone."""
