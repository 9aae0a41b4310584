"""Plain YAML: text, numbers, true, false, null, lists and mappings; nothing that expands, runs or repeats."""

from __future__ import annotations

import re
from typing import Any, ClassVar

import yaml

from ._files import PathLike, bad_input, one_line
from ._text import read_text

LARGEST_FILE = 1 << 20  # bytes
_DEEPEST = 21
_MOST = 20_000  # values: PyYAML takes about 0.1 ms for one
_HEADER = re.compile(r"\A((?:[ \t]*(?:#[^\n]*)?\n)*)%YAML[: ][ \t]*1\.[0-9][^\n]*")
# What plain words mean, YAML 1.2's core: no dates, no 1:30 for 90, no <<, no yes and no.
_WORDS = {
    "null": r"~|null|Null|NULL|",
    "bool": r"true|True|TRUE|false|False|FALSE",
    "int": r"[-+]?[0-9]+",
    "float": r"[-+]?(?:\.[0-9]+|[0-9]+\.[0-9]*|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?|[-+]?\.inf|\.nan",
}


class _Plain:
    """Rules that reading and writing share."""

    yaml_implicit_resolvers: ClassVar[dict[Any, Any]] = {
        None: [(f"tag:yaml.org,2002:{kind}", re.compile(f"(?:{form})$")) for kind, form in _WORDS.items()]
    }


class PlainLoader(_Plain, yaml.SafeLoader):
    """PyYAML's safe loader without anchors, tags, merges, repeated keys, or too many levels."""

    _depth = _count = 0

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Refuse anchors, aliases, tags and too many levels."""
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise _refused("anchors and aliases are not allowed", event)
        if getattr(event, "tag", None) is not None:
            raise _refused(f"the tag {event.tag} is not allowed", event)
        self._count += 1
        if self._count > _MOST:
            raise _refused(f"there are more than {_MOST} values", event)
        if self._depth > _DEEPEST:
            raise _refused("too many levels", event)
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse keys that are there twice, or are no words."""
        names: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _refused("a key is a list or a mapping", key)
            if key.value in names:
                raise _refused(f"the key {key.value} is there twice", key)
            names.add(key.value)
        return super().construct_mapping(node, deep)


class _Dumper(_Plain, yaml.SafeDumper):
    pass


def _decimal(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int:
    return int(node.value)


PlainLoader.add_constructor("tag:yaml.org,2002:int", _decimal)


def _refused(problem: str, at: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=at.start_mark)


def without_header(text: str) -> str:
    r"""Return the text of a file with OpenCV's header ``%YAML:1.0``, if that is there, made a comment.

    With the colon it is no directive that YAML knows. Comments and blank lines may stand above it.

    Examples
    --------
    >>> without_header("# mine\n%YAML:1.0\nfx: 500")
    '# mine\n#\nfx: 500'
    """
    return _HEADER.sub(r"\1#", text, count=1)


def parse_yaml(text: str) -> Any:
    """Return what plain YAML says; ValueError with the reason, and the line where there are several, if it is not."""
    try:
        return yaml.load(text, Loader=PlainLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f" in line {mark.line + 1}" if mark is not None and "\n" in text.strip() else ""
        raise ValueError(one_line(f"{error.problem}{where}")[:160]) from error
    except (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ValueError(one_line(str(error))[:120] or type(error).__name__) from error


def read_yaml(path: PathLike, expected: str) -> Any:
    """Return the content of a plain YAML file of at most 1 MiB; anything else is an `InputError`."""
    text = without_header(read_text(path, expected, LARGEST_FILE))
    try:
        return parse_yaml(text)
    except ValueError as error:
        raise bad_input(path, f"is not plain YAML: {one_line(str(error))[:160]}", expected) from error


def dump_yaml(value: object) -> str:
    """Return plain values as YAML that `parse_yaml` reads back exactly; keys sorted, ASCII."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=True, allow_unicode=False, width=1000)
