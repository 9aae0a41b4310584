"""Files of a package that are loaded when they are first asked for: ``tspslam.vision.se3`` after ``import tspslam``."""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable
from types import ModuleType


def load_files(package: str) -> Callable[[str], ModuleType]:
    """Make the ``__getattr__`` of a package whose public files can be asked for without an import of each."""

    def load(name: str) -> ModuleType:
        place = f"{package}.{name}"
        if name.startswith("_") or importlib.util.find_spec(place) is None:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return importlib.import_module(place)

    return load
