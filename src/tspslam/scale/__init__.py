"""What is larger than one sequence or one machine: many recordings, huge clouds, on Dask."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .._lazy import load_files

if TYPE_CHECKING:
    from .stores.images import ImageReference as ImageReference
    from .stores.store import Store as Store
    from .stores.store import open_store as open_store
    from .stores.stored_response import StoredResponse as StoredResponse
    from .stores.writing import write_store as write_store

_HOMES = {
    "ImageReference": "stores.images",
    "Store": "stores.store",
    "StoredResponse": "stores.stored_response",
    "open_store": "stores.store",
    "write_store": "stores.writing",
}
_load = load_files(__name__)


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(importlib.import_module(f".{_HOMES[name]}", __name__), name)
    return _load(name)
