"""Files of OpenCV's FileStorage: XML, or YAML that is plain but for its header and the tag of matrices."""

from __future__ import annotations

import re
from typing import Any

import yaml

from ...._files import PathLike, bad_input, one_line
from ...._text import read_text
from ...._yaml import LARGEST_FILE, PlainLoader, without_header
from ._xml import is_xml, parse_opencv_xml

MATRIX_TAG = "tag:yaml.org,2002:opencv-matrix"
# OpenCV needs no blank after a colon; ORB-SLAM2's own settings have none before a list.
_TIGHT = re.compile(r"^([ ]*[A-Za-z_][\w.]*):(?=[-+.0-9\[{\"!])", re.ASCII | re.MULTILINE)


class _OpenCvLoader(PlainLoader):
    """Plain YAML in which a mapping may be tagged as a matrix; it is read as the mapping that it is."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.MappingStartEvent) and event.tag == MATRIX_TAG:
            event.tag = None
        return super().compose_node(parent, index)


def parse_opencv_yaml(text: str, path: PathLike, expected: str) -> Any:
    """Return what the text of a file says; an `InputError` that names the file if it is not such YAML."""
    try:
        return yaml.load(_as_yaml(text), Loader=_OpenCvLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = "" if mark is None else f" in line {mark.line + 1}"
        reason = one_line(f"{error.problem}{where}")
    except (yaml.YAMLError, ValueError, LookupError, TypeError, AttributeError) as error:
        reason = one_line(str(error)) or type(error).__name__
    raise bad_input(path, f"is not plain YAML: {reason[:160]}", expected)


def _as_yaml(text: str) -> str:
    plain = without_header(text)
    return plain if plain == text else _TIGHT.sub(r"\1: ", plain)


def read_mapping(path: PathLike, expected: str) -> dict[Any, Any]:
    """Return the mapping that a file of OpenCV's or plain YAML holds."""
    return parse_mapping(read_text(path, expected, LARGEST_FILE), path, expected)


def parse_mapping(text: str, path: PathLike, expected: str) -> dict[Any, Any]:
    """Return the mapping that the text of a file holds: OpenCV's XML, or its or plain YAML."""
    if is_xml(text):
        return parse_opencv_xml(text, path, expected)
    content = parse_opencv_yaml(text, path, expected)
    if not isinstance(content, dict):
        kind = "blank" if content is None else f"a {type(content).__name__}, not a mapping"
        raise bad_input(path, f"is {kind}", expected)
    return content
