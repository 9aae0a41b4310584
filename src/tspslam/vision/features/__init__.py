"""Keypoints and their descriptors."""
