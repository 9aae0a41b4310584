"""Settings of a stage: each value with its unit, its range, and where its default comes from."""

from __future__ import annotations

from dataclasses import field, fields
from functools import cache
from numbers import Integral, Real
from types import UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from .errors import InputError

_KINDS = {int: "an integer", float: "a number", bool: "True or False", str: "text"}


def setting(
    default: Any, low: float | None = None, high: float | None = None, *, unit: str = "", source: str = ""
) -> Any:
    """Make a field of a frozen data class that holds a setting.

    Parameters
    ----------
    default : object
        Its value where none is given.
    low, high : float, optional
        Smallest and largest value, both allowed.
    unit : str
        Such as ``"px"`` or ``"m per m of depth"``; empty for a plain number.
    source : str
        Where the default comes from: a reference, or what was measured on what.

    Returns
    -------
    dataclasses.Field
        With ``low``, ``high``, ``unit`` and ``source`` as its metadata.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Gate:
    ...     width: float = setting(3.5, 1, 10, unit="standard deviations")
    >>> Gate(2).width
    2
    """
    return field(default=default, metadata={"low": low, "high": high, "unit": unit, "source": source})


def check_settings(what: str, settings: Any) -> None:
    """Refuse a value of another type than its annotation, or out of its range.

    Parameters
    ----------
    what : str
        What to call the settings in the message.
    settings : dataclass
        Whose fields `setting` made; others are left alone.

    Raises
    ------
    InputError
        With the first value that is wrong.
    """
    hints = _hints(type(settings))  # type: ignore[arg-type]
    for each in fields(settings):
        if "low" not in each.metadata:
            continue
        value, kinds = getattr(settings, each.name), _kinds_of(hints[each.name])
        if not any(_is(value, kind) for kind in kinds):
            expected = " or ".join(_KINDS.get(kind, "None") for kind in kinds)
            raise InputError(f"{what}: {each.name} is {repr(value)[:40]}, expected {expected}")
        low, high = each.metadata["low"], each.metadata["high"]
        if isinstance(value, Real) and not ((low is None or value >= low) and (high is None or value <= high)):
            raise InputError(f"{what}: {each.name} is {value}, expected {_range(low, high)}")


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _kinds_of(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


def _is(value: Any, kind: Any) -> bool:
    if kind not in (int, float):
        return isinstance(value, kind)
    return isinstance(value, Integral if kind is int else Real) and not isinstance(value, bool)


def _range(low: float | None, high: float | None) -> str:
    if low is None or high is None:
        return f"at least {low:g}" if high is None else f"at most {high:g}"
    return f"{low:g} to {high:g}"
