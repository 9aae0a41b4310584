"""What a person types: a thin parser around functions. Nothing heavy is imported before a command runs."""

from ._shared import BAD_INPUT, COMPLETE, DEGRADED, INTERNAL, INTERRUPTED, NOT_WRITTEN, USAGE, app
from .entry import exit_code, main

__all__ = [
    "BAD_INPUT", "COMPLETE", "DEGRADED", "INTERNAL", "INTERRUPTED", "NOT_WRITTEN", "USAGE", "app", "exit_code", "main",
]  # fmt: skip
