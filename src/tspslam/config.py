"""Settings by name: every value, where it came from, and one clear line for a name or value that is wrong."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ._files import one_line
from ._yaml import parse_yaml, read_yaml
from .errors import InputError
from .session import Settings
from .topology.harmonic import Tmahf
from .vision.reconstruct import PAPER_MATCHER

PRESETS = ("default", "paper")
_TOO_LARGE = 1 << 63


@dataclass(frozen=True)
class Resolved:
    """Settings, and the origin of each value by its dotted name."""

    settings: Settings
    origin: dict[str, str]

    @property
    def values(self) -> dict[str, Any]:
        """Each value by its dotted name."""
        return flatten(self.settings)

    @property
    def nested(self) -> dict[str, Any]:
        """The values as ``config.yaml`` holds them."""
        tree: dict[str, Any] = {}
        for name, value in self.values.items():
            *path, key = name.split(".")
            branch = tree
            for part in path:
                branch = branch.setdefault(part, {})
            branch[key] = value
        return tree


def resolve(preset: str = "default", file: Path | None = None, assignments: Iterable[str] = ()) -> Resolved:
    """Settings from a preset, then a YAML file, then ``key=value`` assignments; the later wins.

    Parameters
    ----------
    preset : {"default", "paper"}
        Where to start.
    file : path, optional
        YAML: ``stage: {key: value}``, as `Resolved.nested` has it.
    assignments : iterable of str
        Such as ``"detector.count=3000"``.

    Returns
    -------
    Resolved

    Raises
    ------
    InputError
        If a name is unknown (the nearest one is suggested), or a value has the wrong type or is out of its range.

    Examples
    --------
    >>> resolve(assignments=["filter.order=2"]).values["filter.order"]
    2
    """
    start = _preset(preset)
    values = flatten(start)
    origin = dict.fromkeys(values, "default")
    if preset != "default":
        plain = flatten(Settings())
        origin |= {name: f"preset {preset}" for name, value in values.items() if value != plain[name]}
    kinds = _kinds(start)
    given = [(str(file), name, value) for name, value in (_read(file) if file else {}).items()]
    given += [("--set", *_split(assignment)) for assignment in assignments]
    for source, name, value in given:
        values[name] = _checked(name, value, kinds, source)
        origin[name] = source
    return Resolved(_rebuilt(start, values, origin), origin)


def flatten(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Each value of the settings by its dotted name."""
    flat: dict[str, Any] = {}
    for part in fields(settings):
        value, name = getattr(settings, part.name), prefix + part.name
        flat |= flatten(value, f"{name}.") if is_dataclass(value) else {name: value}
    return flat


def _preset(name: str) -> Settings:
    if name not in PRESETS:
        raise InputError(f"preset is {name!r}, expected one of {', '.join(PRESETS)}")
    if name == "paper":
        return Settings(matcher=PAPER_MATCHER, filter=Tmahf(centering="none"))
    return Settings()


def _split(assignment: str) -> tuple[str, Any]:
    name, equals, text = assignment.partition("=")
    shown = repr(assignment if len(assignment) < 100 else assignment[:97] + "...")
    if not equals or not name.strip():
        raise InputError(f"--set {shown}: expected key=value, such as detector.count=3000")
    try:
        return name.strip(), parse_yaml(text) if text.strip() else ""
    except ValueError as error:
        raise InputError(f"--set {shown}: the value is not plain YAML ({error})") from error


def _read(file: Path) -> dict[str, Any]:
    tree = read_yaml(file, "a YAML file of settings")
    stages = {} if tree is None else tree
    if not isinstance(stages, Mapping):
        raise InputError(f"{file}: expected a mapping of stages")
    # A run's own config.yaml will do: what it was made of is no setting.
    return dict(_leaves({name: stage for name, stage in stages.items() if name != "source"}))


def _leaves(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _kinds(settings: Any, prefix: str = "") -> dict[str, Any]:
    """Type of each value by its dotted name."""
    kinds: dict[str, Any] = {}
    hints = get_type_hints(type(settings))
    for part in fields(settings):
        value, name = getattr(settings, part.name), prefix + part.name
        kinds |= _kinds(value, f"{name}.") if is_dataclass(value) else {name: hints[part.name]}
    return kinds


def _checked(name: str, value: Any, kinds: dict[str, Any], source: str) -> Any:
    if name not in kinds:
        near = difflib.get_close_matches(name, kinds, 1, 0.5)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(kinds)}"
        raise InputError(f"{source}: unknown setting {one_line(repr(name))[:80]}; {hint}")
    try:
        return _fitted(value, kinds[name])
    except TypeError as error:
        is_huge = isinstance(value, int) and abs(value) >= _TOO_LARGE
        shown = "a number too large" if is_huge else one_line(repr(value))[:80]
        raise InputError(f"{source}: {name} is {shown}, expected {_describe(kinds[name])}") from error


def _rebuilt(part: Any, values: dict[str, Any], origin: dict[str, str], prefix: str = "") -> Any:
    """`part` with the values of these names, all at once: what is in range may depend on more than one."""
    changed = {}
    for each in fields(part):
        value, name = getattr(part, each.name), prefix + each.name
        changed[each.name] = _rebuilt(value, values, origin, f"{name}.") if is_dataclass(value) else values[name]
    try:
        return replace(part, **changed)
    except InputError as error:
        sources = {origin[prefix + key]: None for key in changed if prefix + key in values}
        raise InputError(f"{', '.join(s for s in sources if s != 'default')}: {error}") from error


def _fitted(value: Any, wanted: Any) -> Any:
    """`value` as the type `wanted`; TypeError if it is none."""
    if get_origin(wanted) in (Union, UnionType):
        for each in get_args(wanted):
            with contextlib.suppress(TypeError):
                return _fitted(value, each)
    elif get_origin(wanted) is Literal:
        if value in get_args(wanted):
            return value
    elif isinstance(value, int) and not isinstance(value, bool) and wanted in (int, float):
        if abs(value) < _TOO_LARGE:
            return wanted(value)
    elif type(value) is wanted:
        return value
    raise TypeError


def _describe(wanted: Any) -> str:
    if get_origin(wanted) in (Union, UnionType):
        return " or ".join(_describe(each) for each in get_args(wanted))
    if get_origin(wanted) is Literal:
        return "one of " + ", ".join(map(str, get_args(wanted)))
    if wanted in (None, NoneType):
        return "null"
    return {int: "an integer", float: "a number", bool: "true or false", str: "text"}.get(wanted, str(wanted))
