"""Settings of a stage: each value with its unit, its range, and where its default comes from."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Mapping
from dataclasses import field, fields
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

from .errors import InputError

PYTHON_WORDS = {int: "an integer", float: "a number", bool: "True or False", str: "text", NoneType: "None"}
YAML_WORDS = PYTHON_WORDS | {bool: "true or false", NoneType: "null"}
_LARGE = 10**30  # numbers beyond are not written out in messages
_ENTRY = re.compile(r"^(\w+(?:, \w+)*) : .*\n((?:[ ]+.*\n|\n(?=[ ]))+)", re.MULTILINE)


def setting(
    default: Any, low: float | None = None, high: float | None = None, *, unit: str | None = None, source: str = ""
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
        Where the default comes from: a reference, or what was measured on what. Of a group of settings: where those
        of its values come from that are not the group's own defaults.

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


def copy_setting(kind: type, name: str) -> Any:
    """Make a field with the default, range, unit and source of another class's: the same setting in two stages.

    Parameters
    ----------
    kind : type
        The other class.
    name : str
        Of its field.

    Returns
    -------
    dataclasses.Field
    """
    known = next(each for each in fields(kind) if each.name == name)
    return field(default=known.default, metadata=known.metadata)


def check_settings(what: str, settings: Any) -> None:
    """Refuse a value of another type than its annotation, or out of its range; numbers become of that very type.

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
    hints = hints_of(type(settings))  # type: ignore[arg-type]
    for each in fields(settings):
        if "low" not in each.metadata:
            continue
        value, hint = getattr(settings, each.name), hints[each.name]
        if not _is(value, hint):
            raise InputError(f"{what}: {each.name} is {repr(value)[:40]}, expected {describe_type(hint)}")
        low, high = each.metadata["low"], each.metadata["high"]
        if not is_within(value, low, high):
            shown = repr(value) if abs(value) < _LARGE else f"{repr(value)[:20]}..."
            raise InputError(f"{what}: {each.name} is {shown}, expected {describe_range(low, high)}")
        object.__setattr__(settings, each.name, _as(value, hint))  # equal settings are told alike


class Checked:
    """Base of frozen data classes of settings: a value of another type or out of its range is an `InputError`.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @dataclass(frozen=True)
    ... class Gate(Checked, what="gate"):
    ...     width: float = setting(3.5, 1, 10, unit="m")
    >>> Gate(0.5)
    Traceback (most recent call last):
    tspslam.errors.InputError: gate: width is 0.5, expected 1 to 10
    """

    _what: ClassVar[str]

    def __init_subclass__(cls, *, what: str = "") -> None:
        cls._what = what or cls._what

    def __post_init__(self) -> None:
        """Check the types and the ranges."""
        check_settings(self._what, self)


@cache
def hints_of(kind: type) -> Mapping[str, Any]:
    """Types of the fields of a data class.

    Parameters
    ----------
    kind : type
        The class.

    Returns
    -------
    dict of str to types
    """
    return get_type_hints(kind)


def is_within(value: Any, low: float | None, high: float | None) -> bool:
    """Whether a value is in its range; NaN is in none, what is no number in every one.

    Parameters
    ----------
    value : object
        The value.
    low, high : float or None
        Smallest and largest one, both allowed.

    Returns
    -------
    bool
    """
    if not isinstance(value, Real):
        return True
    number: Any = value
    return (low is None or number >= low) and (high is None or number <= high)


def describe_type(hint: Any, words: Mapping[Any, str] = PYTHON_WORDS) -> str:
    """Return in words what a type allows.

    Parameters
    ----------
    hint : object
        Annotation of a field.
    words : dict of types to str
        What to call plain types.

    Returns
    -------
    str

    Examples
    --------
    >>> describe_type(float | None)
    'a number or None'
    """
    if get_origin(hint) in (Union, UnionType):
        return " or ".join(describe_type(each, words) for each in get_args(hint))
    if get_origin(hint) is Literal:
        return "one of " + ", ".join(map(str, get_args(hint)))
    return words.get(hint, getattr(hint, "__name__", str(hint)))


def describe_range(low: float | None, high: float | None) -> str:
    """Return a range in words; empty where everything goes.

    Parameters
    ----------
    low, high : float or None
        Smallest and largest value, both allowed.

    Returns
    -------
    str

    Examples
    --------
    >>> describe_range(0, 1_000_000), describe_range(0.5, None)
    ('0 to 1000000', 'at least 0.5')
    """
    if low is None or high is None:
        return "" if low is high else f"at least {_plain(low)}" if high is None else f"at most {_plain(high)}"
    return f"{_plain(low)} to {_plain(high)}"


def read_meanings(kind: type) -> dict[str, str]:
    """What each parameter or attribute of a class means, from its docstring, in a line each.

    Parameters
    ----------
    kind : type
        The class.

    Returns
    -------
    dict of str to str

    Examples
    --------
    >>> class Gate:
    ...     '''A gate.
    ...
    ...     Parameters
    ...     ----------
    ...     width : float
    ...         How far
    ...         it opens, m.
    ...     '''
    >>> read_meanings(Gate)
    {'width': 'How far it opens, m.'}
    """
    text = inspect.cleandoc(kind.__doc__ or "") + "\n"
    found = ((names.split(", "), " ".join(meaning.split())) for names, meaning in _ENTRY.findall(text))
    return {name: meaning for names, meaning in found for name in names}


def _plain(number: float | None) -> str:
    return f"{number:.7g}"


def _as(value: Any, hint: Any) -> Any:
    """A number as the plain type that its annotation names: 1, np.float32(1) and 1.0 are one setting."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    is_whole = int in (get_args(hint) or (hint,))
    number: Any = value
    return int(number) if is_whole else float(number)


def _is(value: Any, hint: Any) -> bool:
    if get_origin(hint) in (Union, UnionType):
        return any(_is(value, each) for each in get_args(hint))
    if get_origin(hint) is Literal:
        return isinstance(value, str) and value in get_args(hint)
    if hint in (int, float):
        return isinstance(value, Integral if hint is int else Real) and not isinstance(value, bool)
    return isinstance(value, str | os.PathLike if hint is str else hint)
