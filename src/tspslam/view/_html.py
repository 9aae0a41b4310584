"""Pieces of the report's page: numbers in tiles, pictures that are part of the file."""

from __future__ import annotations

import base64
import html
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image as PillowImage

from .. import __version__
from ..errors import InputError
from ._page import STYLE

CITATION = (
    "Method: Topological Signal Processing from Stereo Visual SLAM, Sensors 2025, 25, 6103, doi:10.3390/s25196103."
)
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'"
)
# Control characters, marks that turn the direction of writing, and halves of characters: shown, never obeyed.
_OBEYED = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u202a-\u202e\u2060-\u206f\ufeff\ud800-\udfff]"
)


def page_of(title: str, sections: Sequence[str]) -> str:
    """One page of sections, with its style; nothing is loaded from anywhere."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n'
        f"<title>{text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        '<a class="skip" href="#main">Skip to the content</a>\n<main id="main" tabindex="-1">\n'
        + "\n".join(section for section in sections if section)
        + f"\n</main>\n<footer><p>tspslam {text(__version__)}</p><p>{CITATION}</p></footer>\n</body>\n</html>\n"
    )


def contents(sections: Sequence[str]) -> str:
    """Links to the sections of a page, by their headings; nothing where there are few."""
    found = [re.search(r'<h2 id="([a-z]+)">(.*?)</h2>', section) for section in sections]
    links = [f'<li><a href="#{each[1]}">{each[2]}</a></li>' for each in found if each]
    return f'<nav aria-label="On this page"><ul>{"".join(links)}</ul></nav>' if len(links) > 2 else ""


def tiles(numbers: Sequence[tuple[str, Any]]) -> str:
    """Numbers, large, each over its name."""
    cells = "".join(f'<div class="tile"><b>{shown_value(v)}</b><span>{text(k)}</span></div>' for k, v in numbers)
    return f'<div class="tiles">{cells}</div>'


def figures(paths: Sequence[Path], captions: Mapping[str, tuple[str, str]], *, is_small: bool = False) -> str:
    """Pictures with what they show, inside the page; small ones are coarser in colour."""
    shown = []
    for path in paths:
        title, caption = captions.get(Path(path).stem, (Path(path).stem, ""))
        data, width, height = _embedded(Path(path), is_small)
        shown.append(
            f'<figure><img src="data:image/jpeg;base64,{data}" width="{width}" height="{height}" alt="{text(title)}">'
            f"<figcaption><b>{text(title)}.</b> {text(caption)}</figcaption></figure>"
        )
    return "".join(shown)


def shown_value(value: Any) -> str:
    """A value as the page writes it: thin spaces between thousands, a dash for what is not there."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\N{NARROW NO-BREAK SPACE}").replace("-", "\N{MINUS SIGN}")
    if isinstance(value, float):
        return f"{value:.6g}".replace("-", "\N{MINUS SIGN}")
    if isinstance(value, list | tuple):
        return ", ".join(shown_value(v) for v in value) or "–"
    return text(value)


def text(value: Any) -> str:
    r"""Anything as text of the page; characters that a page would obey, and not show, as their escapes.

    Examples
    --------
    >>> text("<b>\u202etxt.exe")
    '&lt;b&gt;\\u202etxt.exe'
    """
    return html.escape(plain(value))


def plain(value: Any) -> str:
    """Anything as text that a script of the page shows."""
    return _OBEYED.sub(lambda found: f"\\u{ord(found[0]):04x}", str(value))


def data_of(values: Any) -> str:
    r"""Plain values as JSON within a script of the page, which no text in them can close.

    Examples
    --------
    >>> data_of({"name": "</script>"})
    '{"name":"\\u003c/script\\u003e"}'
    """
    said = json.dumps(values, separators=(",", ":"), allow_nan=False)
    return said.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _embedded(path: Path, is_small: bool) -> tuple[str, int, int]:
    """A picture as base64 JPEG, a third of the PNG's size, with its width and height, px."""
    buffer = io.BytesIO()
    try:
        with PillowImage.open(path) as picture:
            width, height = picture.size
            picture.convert("RGB").save(
                buffer, "JPEG", quality=80 if is_small else 90, subsampling=2 if is_small else 0
            )
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(f"report: {path} is not a picture that can be read ({error})") from error
    return base64.b64encode(buffer.getvalue()).decode("ascii"), width, height
