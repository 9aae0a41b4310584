"""Settings by name: every value, where it came from, and one clear line for a name or value that is wrong."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import yaml

from .errors import InputError
from .session import Settings
from .topology.harmonic import Tmahf
from .vision.reconstruct import PAPER_MATCHER

PRESETS = ("default", "paper")
_LARGEST = 1 << 20


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
        If a name is unknown (the nearest one is suggested) or a value has the wrong type.

    Examples
    --------
    >>> resolve(assignments=["filter.order=2"]).values["filter.order"]
    2
    """
    settings = _preset(preset)
    origin = dict.fromkeys(flatten(settings), "default")
    if preset != "default":
        plain = flatten(Settings())
        origin |= {name: f"preset {preset}" for name, value in flatten(settings).items() if value != plain[name]}
    given = [(str(file), name, value) for name, value in (_read(file) if file else {}).items()]
    given += [("--set", *_split(assignment)) for assignment in assignments]
    for source, name, value in given:
        settings = _assign(settings, name, value, source)
        origin[name] = source
    return Resolved(settings, origin)


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
    if not equals or not name.strip():
        raise InputError(f"--set {assignment!r}: expected key=value, such as detector.count=3000")
    try:
        return name.strip(), yaml.safe_load(text) if text.strip() else ""
    except yaml.YAMLError as error:
        raise InputError(f"--set {assignment!r}: the value is not plain YAML") from error


def _read(file: Path) -> dict[str, Any]:
    try:
        if file.stat().st_size > _LARGEST:
            raise InputError(f"{file}: {file.stat().st_size} bytes, expected settings of at most {_LARGEST}")
        text = file.read_text(encoding="utf-8")
        if any(isinstance(t, yaml.AliasToken | yaml.TagToken) for t in yaml.scan(text, Loader=yaml.SafeLoader)):
            raise InputError(f"{file}: has an alias or a tag, expected plain values")
        tree = yaml.safe_load(text)
    except OSError as error:
        raise InputError(f"{file}: cannot be read ({error.strerror})") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise InputError(f"{file}: not plain YAML ({' '.join(str(error).split())[:120]})") from error
    stages = {} if tree is None else tree
    if not isinstance(stages, Mapping):
        raise InputError(f"{file}: expected a mapping of stages")
    return dict(_leaves(stages))


def _leaves(tree: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _assign(settings: Settings, name: str, value: Any, source: str) -> Settings:
    known = flatten(settings)
    if name not in known:
        near = difflib.get_close_matches(name, known, 1, 0.5)
        hint = f"; did you mean {near[0]}?" if near else f"; known are {', '.join(known)}"
        raise InputError(f"{source}: unknown setting {name!r}{hint}")
    replaced: Settings = _replace(settings, name.split("."), value, f"{source}: {name}")
    return replaced


def _replace(part: Any, path: list[str], value: Any, where: str) -> Any:
    key, *deeper = path
    if deeper:
        return replace(part, **{key: _replace(getattr(part, key), deeper, value, where)})
    wanted = get_type_hints(type(part))[key]
    if not _fits(value, wanted):
        raise InputError(f"{where} is {value!r}, expected {_describe(wanted)}")
    return replace(part, **{key: float(value) if wanted is float else value})


def _fits(value: Any, wanted: Any) -> bool:
    if get_origin(wanted) in (Union, UnionType):
        return any(_fits(value, each) for each in get_args(wanted))
    if get_origin(wanted) is Literal:
        return value in get_args(wanted)
    if wanted in (None, NoneType):
        return value is None
    if wanted is float:
        return isinstance(value, float | int) and not isinstance(value, bool)
    return type(value) is wanted


def _describe(wanted: Any) -> str:
    if get_origin(wanted) in (Union, UnionType):
        return " or ".join(_describe(each) for each in get_args(wanted))
    if get_origin(wanted) is Literal:
        return "one of " + ", ".join(map(str, get_args(wanted)))
    if wanted in (None, NoneType):
        return "null"
    return {int: "an integer", float: "a number", bool: "true or false", str: "text"}.get(wanted, str(wanted))
