"""Looking at results: pictures of a frame or a map, a report that needs nothing but a browser, a viewer of a run.

Names are loaded when they are first used, so importing this package does not import matplotlib.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._frame import phase_colours as phase_colours
    from ._report_parts import Finding as Finding
    from ._report_parts import FrameState as FrameState
    from ._report_parts import Shot as Shot
    from ._report_parts import WholeRun as WholeRun
    from .map_pictures import write_map_pictures as write_map_pictures
    from .paths import write_path_picture as write_path_picture
    from .paths import write_plan_picture as write_plan_picture
    from .pictures import write_pictures as write_pictures
    from .report import write_report as write_report
    from .scene import write_scene as write_scene

_HOME = {
    "Finding": "_report_parts",
    "FrameState": "_report_parts",
    "Shot": "_report_parts",
    "WholeRun": "_report_parts",
    "phase_colours": "_frame",
    "write_map_pictures": "map_pictures",
    "write_path_picture": "paths",
    "write_pictures": "pictures",
    "write_plan_picture": "paths",
    "write_report": "report",
    "write_scene": "scene",
}

__all__ = [
    "Finding",
    "FrameState",
    "Shot",
    "WholeRun",
    "phase_colours",
    "write_map_pictures",
    "write_path_picture",
    "write_pictures",
    "write_plan_picture",
    "write_report",
    "write_scene",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*globals(), *__all__]
