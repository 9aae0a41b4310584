"""Pieces of the report's page: numbers in tiles, pictures that are part of the file."""

from __future__ import annotations

import base64
import html
import io
import math
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
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'"
)


def page_of(title: str, sections: Sequence[str]) -> str:
    """One page of sections, with its style; nothing is loaded from anywhere."""
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n<link rel="icon" href="data:,">\n'
        f"<title>{text(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(section for section in sections if section)
        + f"\n</main>\n<footer><p>tspslam {text(__version__)}</p><p>{CITATION}</p></footer>\n</body>\n</html>\n"
    )


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
    """Anything as text of the page."""
    return html.escape(str(value))


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
