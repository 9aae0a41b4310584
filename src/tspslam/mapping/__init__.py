"""Keyframes and landmarks to one topological map."""
