"""Settings by name: every value, where it came from, and one clear line for a name or value that is wrong."""

from __future__ import annotations

import contextlib
import difflib
import json
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

from .._checks import require
from .._files import PathLike, one_line
from .._settings import YAML_WORDS, describe_range, describe_type, is_within
from .._yaml import parse_yaml, read_yaml
from ..errors import InputError
from ..settings import KINDS, Setting, Settings, find_kind, find_preset, list_settings

RENAMED = {
    "matcher.windows": "matcher.patches",
    "matcher.back_windows": "matcher.back_patches",
}
"""Settings, and groups of them, by their old names, and what they are called now."""
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


def as_resolved(given: Resolved | Settings) -> Resolved:
    """Settings with the origin of each value, if they have none: they were given.

    Parameters
    ----------
    given : Resolved or Settings
        The settings.

    Returns
    -------
    Resolved

    Raises
    ------
    InputError
        If they are neither.

    Examples
    --------
    >>> as_resolved(Settings()).origin["filter.order"]
    'given'
    """
    if isinstance(given, Resolved):
        return given
    require(given, Settings, "settings")
    return Resolved(given, dict.fromkeys(flatten(given), "given"))


def resolve(preset: str = "default", file: PathLike | None = None, assignments: Iterable[str] = ()) -> Resolved:
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
    if isinstance(assignments, str):
        raise InputError(f"assignments is the text {assignments!r:.80}, expected a list of such")
    given = [(str(file), name, value) for name, value in (_read(file) if file else {}).items()]
    given += [("--set", *_split(assignment)) for assignment in assignments]
    start = _with_kinds(find_preset(preset), given)
    values, known = flatten(start), {row.name: row for row in list_settings(start)}
    plain, chosen = flatten(Settings()), flatten(find_preset(preset))
    from_preset = {name for name, value in chosen.items() if value != plain.get(name) and value == values.get(name)}
    origin = {name: f"preset {preset}" if name in from_preset else "default" for name in values}
    for source, name, value in given:
        if value == {} and any(each.startswith(f"{name}.") for each in known):
            continue  # a group of which nothing is said
        values[name] = _checked(name, value, known, source)
        origin[name] = source
    return Resolved(_rebuilt(start, values, origin), origin)


def flatten(settings: Settings) -> dict[str, Any]:
    """Each value of the settings by its dotted name; ``stage.kind`` is what the stage is.

    Parameters
    ----------
    settings : Settings
        The stages.

    Returns
    -------
    dict of str to plain values
    """
    flat: dict[str, Any] = {}
    for stage in KINDS:
        flat[f"{stage}.kind"] = find_kind(settings, stage)
        flat |= _flatten(getattr(settings, stage), f"{stage}.")
    return flat


def describe(resolved: Resolved | Settings, names: Iterable[str] = ()) -> dict[str, dict[str, Any]]:
    """All that is known of each setting, by its dotted name.

    Parameters
    ----------
    resolved : Resolved or Settings
        The settings.
    names : iterable of str
        Settings, groups of them or stages, such as ``"matcher.patches"``; else all.

    Returns
    -------
    dict of dict
        ``value``, ``origin`` (where it came from), ``default``, ``unit``, ``low``, ``high``, ``range``, ``source``
        (where the default came from), ``meaning``: as JSON has them.

    Raises
    ------
    InputError
        If a name is unknown.

    Examples
    --------
    >>> describe(resolve(), ["filter.order"])["filter.order"]["range"]
    '0 to 1000'
    """
    resolved = as_resolved(resolved)
    known, values = {row.name: row for row in list_settings(resolved.settings)}, resolved.values
    wanted = [name.rstrip(".") for name in names]
    for name in wanted:
        if not any(each.startswith(f"{name}.") for each in known):
            find_setting(name, known, "config show")
    chosen = [name for name in known if not wanted or any(f"{name}.".startswith(f"{each}.") for each in wanted)]
    told = ("default", "unit", "low", "high", "range", "source", "meaning")
    return {
        name: {"value": values[name], "origin": resolved.origin[name]}
        | {each: getattr(known[name], each) for each in told}
        for name in chosen
    }


def tabulate(rows: Mapping[str, Mapping[str, Any]], *, has_notes: bool = False) -> list[str]:
    """Lines of a table of what `describe` gave.

    Parameters
    ----------
    rows : dict of dict
        As `describe` gives them.
    has_notes : bool
        Whether to say below each setting what it means, and where its default comes from.

    Returns
    -------
    list of str
    """
    cells = [("setting", "value", "unit", "range", "from")]
    cells += [
        (name, json.dumps(row["value"]), row["unit"] or "", row["range"], row["origin"]) for name, row in rows.items()
    ]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    lines = ["  ".join(text.ljust(width) for text, width in zip(line, widths, strict=True)).rstrip() for line in cells]
    if not has_notes:
        return lines
    return [
        lines[0],
        *(note for line, row in zip(lines[1:], rows.values(), strict=True) for note in (line, *_notes(row))),
    ]


def _notes(row: Mapping[str, Any]) -> list[str]:
    notes = (row["meaning"].replace("`", ""), f"Default {json.dumps(row['default'])}: {row['source']}")
    return [
        line for note in notes for line in textwrap.wrap(note, 112, initial_indent="    ", subsequent_indent="    ")
    ]


def _flatten(part: Any, prefix: str) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for each in fields(part):
        value, name = getattr(part, each.name), prefix + each.name
        flat |= _flatten(value, f"{name}.") if is_dataclass(value) else {name: value}
    return flat


def _with_kinds(settings: Settings, given: list[tuple[str, str, Any]]) -> Settings:
    """Settings whose stages are of the kinds asked for, with their defaults where that changes a stage."""
    for source, name, value in given:
        stage, _, key = name.partition(".")
        if key != "kind" or stage not in KINDS:
            continue
        if not isinstance(value, str) or value not in KINDS[stage]:
            shown = one_line(repr(value))[:80]
            raise InputError(f"{source}: {name} is {shown}, expected one of {', '.join(KINDS[stage])}")
        if type(getattr(settings, stage)) is not KINDS[stage][value]:
            settings = replace(settings, **{stage: KINDS[stage][value]()})
    return settings


def _split(assignment: str) -> tuple[str, Any]:
    name, equals, text = assignment.partition("=")
    shown = repr(assignment if len(assignment) < 100 else assignment[:97] + "...")
    if not equals or not name.strip():
        raise InputError(f"--set {shown}: expected key=value, such as detector.count=3000")
    try:
        return name.strip(), parse_yaml(text) if text.strip() else ""
    except ValueError as error:
        raise InputError(f"--set {shown}: the value is not plain YAML ({error})") from error


def _read(file: PathLike) -> dict[str, Any]:
    tree = read_yaml(file, "a YAML file of settings")
    stages = {} if tree is None else tree
    if not isinstance(stages, Mapping):
        raise InputError(f"{file}: expected a mapping of stages")
    # A run's own config.yaml will do: what it was made of is no setting.
    return dict(_leaves({name: stage for name, stage in stages.items() if name != "source"}))


def _leaves(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping) and value:
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def find_setting(name: str, known: Mapping[str, Setting], source: str) -> Setting:
    """The setting of a dotted name.

    Parameters
    ----------
    name : str
        Such as ``"matcher.patches.radius"``.
    known : dict of str to Setting
        All that there are, by name.
    source : str
        Who asks for it, for the message.

    Returns
    -------
    Setting

    Raises
    ------
    InputError
        If there is none, with its new name, the kind that it belongs to, the settings of the group that it is, the
        nearest name, or the groups that there are.
    """
    if name in known:
        return known[name]
    shown = one_line(repr(name))[:80]
    for old, new in RENAMED.items():
        if name == old or name.startswith(f"{old}."):
            raise InputError(f"{source}: the setting {shown} is now called {new}{one_line(name[len(old) :])[:80]}")
    _refuse_other_kind(name, known, source)
    inner, near = (
        [each for each in known if each.startswith(f"{name}.")],
        difflib.get_close_matches(name, known, 1, 0.5),
    )
    hint = f"did you mean {near[0]}?" if near else f"known are groups: {', '.join(_groups_near(name, known))}"
    hint = f"it is a group: {', '.join(inner)}" if inner else hint
    raise InputError(f"{source}: unknown setting {shown}; {hint}")


def _refuse_other_kind(name: str, known: Mapping[str, Setting], source: str) -> None:
    """Refuse what is a setting, or a group of them, of a kind that its stage is not."""
    stage, rows = name.partition(".")[0], list_settings()
    owners = {row.kind: None for row in rows if f"{row.name}.".startswith(f"{name}.") and row.kind}
    if not owners:
        return
    bare = set(KINDS[stage]) - {row.kind for row in rows if row.name.startswith(f"{stage}.")}  # without settings
    chosen = {row.kind for each, row in known.items() if each.startswith(f"{stage}.") and row.kind} or bare
    if not chosen & owners.keys():
        kinds = f"kind{'s' if len(owners) > 1 else ''} {', '.join(owners)}"
        raise InputError(f"{source}: {name} belongs to {kinds}; {stage}.kind is {' or '.join(sorted(chosen))}")


def _groups_near(name: str, known: Mapping[str, Setting]) -> list[str]:
    """Stages; of a stage that the name begins with, its settings and groups."""
    stage = name.partition(".")[0]
    inner = [each.split(".")[1] for each in known if each.startswith(f"{stage}.")]
    return list(dict.fromkeys(f"{stage}.{each}" for each in inner)) or list(KINDS)


def _checked(name: str, value: Any, known: Mapping[str, Setting], source: str) -> Any:
    """A value as the type of its setting, and in its range."""
    row = find_setting(name, known, source)
    try:
        fitted = _fitted(value, row.type)
    except TypeError as error:
        is_huge = isinstance(value, int) and abs(value) >= _TOO_LARGE
        shown = "a number too large" if is_huge else one_line(repr(value))[:80]
        raise InputError(f"{source}: {name} is {shown}, expected {describe_type(row.type, YAML_WORDS)}") from error
    if not is_within(fitted, row.low, row.high):
        raise InputError(f"{source}: {name} is {fitted}, expected {describe_range(row.low, row.high)}")
    return fitted


def _rebuilt(part: Any, values: dict[str, Any], origin: dict[str, str], prefix: str = "") -> Any:
    """`part` with the values of these names, all at once: what is in range may depend on more than one."""
    changed = {}
    for each in fields(part):
        value, name = getattr(part, each.name), prefix + each.name
        changed[each.name] = _rebuilt(value, values, origin, f"{name}.") if is_dataclass(value) else values[name]
    try:
        return replace(part, **changed)
    except InputError as error:
        sources = {origin[name]: None for name in values if name.startswith(prefix) and origin[name] != "default"}
        raise InputError(": ".join([*([", ".join(sources)] if sources else []), str(error)])) from error


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
