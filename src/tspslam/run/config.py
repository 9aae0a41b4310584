"""Settings by name: every value, where it came from, and one clear line for a name or value that is wrong."""

from __future__ import annotations

import contextlib
import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from .._files import one_line
from .._yaml import parse_yaml, read_yaml
from ..errors import InputError
from ..session import Settings
from ..topology.crust import Crust
from ..topology.harmonic import Tmahf
from ..topology.surface import DelaunaySurface
from ..vision.features.grid import GridDetector
from ..vision.features.onnx import OnnxDetector
from ..vision.features.orb import OrbDetector
from ..vision.features.sift_brisk import BriskDetector, SiftDetector
from ..vision.slam.odometry import Tracking
from ..vision.stereo.descriptor_matcher import DescriptorMatcher
from ..vision.stereo.reconstruct import PAPER_MATCHER
from ..vision.stereo.row_matcher import RowMatcher
from ..vision.stereo.sgbm import SgbmMatcher

PRESETS = ("default", "paper")
KINDS: dict[str, dict[str, type]] = {
    "detector": {
        "orb": OrbDetector,
        "sift": SiftDetector,
        "brisk": BriskDetector,
        "grid": GridDetector,
        "onnx": OnnxDetector,
    },
    "matcher": {"row": RowMatcher, "descriptors": DescriptorMatcher, "sgbm": SgbmMatcher},
    "tracking": {"stereo": Tracking},
    "surface": {"delaunay": DelaunaySurface, "crust": Crust},
    "filter": {"tmahf": Tmahf},
}
"""What each stage can be, by the name that its setting ``kind`` has."""
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
    given = [(str(file), name, value) for name, value in (_read(file) if file else {}).items()]
    given += [("--set", *_split(assignment)) for assignment in assignments]
    start = _with_kinds(_preset(preset), given)
    values = flatten(start)
    plain, chosen = flatten(Settings()), flatten(_preset(preset))
    from_preset = {name for name, value in chosen.items() if value != plain.get(name) and value == values.get(name)}
    origin = {name: f"preset {preset}" if name in from_preset else "default" for name in values}
    types = _types(start)
    for source, name, value in given:
        values[name] = _checked(name, value, types, source)
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
    for stage, kinds in KINDS.items():
        chosen = getattr(settings, stage)
        flat[f"{stage}.kind"] = next(name for name, kind in kinds.items() if kind is type(chosen))
        flat |= _flatten(chosen, f"{stage}.")
    return flat


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


def _types(settings: Settings) -> dict[str, Any]:
    """Type of each value by its dotted name."""
    types: dict[str, Any] = {}
    for stage in KINDS:
        types |= {f"{stage}.kind": str} | _part_types(getattr(settings, stage), f"{stage}.")
    return types


def _part_types(part: Any, prefix: str) -> dict[str, Any]:
    types: dict[str, Any] = {}
    hints = get_type_hints(type(part))
    for each in fields(part):
        value, name = getattr(part, each.name), prefix + each.name
        types |= _part_types(value, f"{name}.") if is_dataclass(value) else {name: hints[each.name]}
    return types


def _checked(name: str, value: Any, types: dict[str, Any], source: str) -> Any:
    if name not in types:
        near = difflib.get_close_matches(name, types, 1, 0.5)
        hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(types)}"
        raise InputError(f"{source}: unknown setting {one_line(repr(name))[:80]}; {hint}")
    try:
        return _fitted(value, types[name])
    except TypeError as error:
        is_huge = isinstance(value, int) and abs(value) >= _TOO_LARGE
        shown = "a number too large" if is_huge else one_line(repr(value))[:80]
        raise InputError(f"{source}: {name} is {shown}, expected {_describe(types[name])}") from error


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
