"""The errors that tspslam raises. Each carries one line: what was wrong, where, what was expected."""


class TspSlamError(Exception):
    """Base of every error that tspslam raises on purpose."""


class InputError(TspSlamError):
    """A file, an array or a setting that the caller gave is not usable."""


class GeometryError(InputError):
    """The input is well-formed, but its geometry admits no result (too few, collinear or coincident points)."""


class OutputError(TspSlamError):
    """A result could not be written; nothing half-written is left behind."""
