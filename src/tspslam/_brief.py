"""What holds arrays prints their shapes and types in a line, not their numbers."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

_LONGEST = 60  # characters of a part; what is longer is named by its type
_MOST = 8  # members of a tuple that is printed


def brief(value: Any) -> str:
    """Return a data class or named tuple in a line: arrays as shape and type, plain values as they are."""
    names = getattr(value, "_fields", None) or [each.name for each in fields(value) if each.repr]
    return f"{type(value).__name__}({', '.join(f'{name}={_part(getattr(value, name))}' for name in names)})"


class Brief:
    """Base of frozen data classes that hold arrays; declare them with ``repr=False``, which leaves this one's."""

    __slots__ = ()

    def __repr__(self) -> str:
        return brief(self)


def _part(value: Any) -> str:
    if hasattr(value, "shape") and hasattr(value, "dtype"):  # an array, a sparse matrix, a tensor, a number of NumPy's
        return f"{tuple(value.shape)} {value.dtype}" if value.shape else repr(value)
    if isinstance(value, tuple | list | dict) and (len(value) > _MOST or not _is_plain(value)):
        return f"{type(value).__name__} of {len(value)}"
    text = repr(value)
    return text if len(text) <= _LONGEST and "\n" not in text else f"{type(value).__name__}(...)"


def _is_plain(values: tuple[Any, ...] | list[Any] | dict[Any, Any]) -> bool:
    members = values.values() if isinstance(values, dict) else values
    return all(isinstance(each, str | bool | int | float | None) for each in members)
