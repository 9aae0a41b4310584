"""What the panel says, as HTML: the legend of a layer, an element, what is missing."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from .._layers import Layer, table, ticks_of
from ._element import Element
from .world import World

_STOPS = 16  # of a colour bar
_BOX = '<div style="padding:0 1em;font-size:.85em;line-height:1.45;overflow-wrap:anywhere">'
_MOST = 12  # frames that are listed, faults that are named
_SHADE = "opacity:.75"


def legend(layer: Layer | None) -> str:
    """Colour bar with ticks, unit and a sentence; of plain colours the sentence."""
    if layer is None:
        return f"{_BOX}No values: shaded surface.</div>"
    bar = _bar(layer) if layer.scale != "rgb" else ""
    return f"{_BOX}{bar}<div style='{_SHADE}'>{escape(layer.note)} Pale blue: no value.</div></div>"


def _bar(layer: Layer) -> str:
    colours = table(layer.scale)
    rows = [round(k * (len(colours) - 1) / (_STOPS - 1)) for k in range(_STOPS)]
    stops = ",".join("#" + bytes(colours[row]).hex() for row in rows)
    ticks = "".join(_tick(place, words) for place, words in ticks_of(layer))
    scale = "logarithmic" if layer.is_log else ""
    unit = ", ".join(part for part in (layer.unit, scale) if part)
    return (
        f"<div>{escape(unit)}</div>"
        f'<div style="height:12px;border:1px solid #8888;background:linear-gradient(90deg,{stops})"></div>'
        f'<div style="position:relative;height:1.5em">{ticks}</div>'
    )


def _tick(place: float, words: str) -> str:
    """Words under their place; at the ends they stay inside."""
    shift = -100 * min(max(place, 0.0), 1.0)
    style = f"position:absolute;white-space:nowrap;left:{100 * place:.1f}%;transform:translateX({shift:.0f}%)"
    return f'<span style="{style}">{escape(words)}</span>'


def element_page(element: Element | None) -> str:
    """What is known of what was clicked."""
    if element is None:
        return f"{_BOX}Click on the surface or on a point.</div>"
    style = f"{_SHADE};padding-right:.8em;vertical-align:top"
    rows = "".join(
        f"<tr><td style='{style}'>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in element.facts
    )
    frames = ", ".join(str(each.number) for each in element.sightings[:_MOST])
    more = len(element.sightings) - _MOST
    whole = "matched" if element.level == "vertex" else "with all its vertices matched"
    seen = f"{whole} in {len(element.sightings)} frame(s): {frames}{f' and {more} more' if more > 0 else ''}"
    return f"{_BOX}<b>{element.level} {element.number}</b><table>{rows}</table><div>{seen}</div></div>"


def status_page(world: World, faults: Sequence[str]) -> str:
    """Name of the run, how far it is, and what is missing."""
    dot = "#2b8a3e" if world.is_live else "#868e96"
    head = f"<b>{escape(world.name)}</b><div><span style='color:{dot}'>&#9679;</span> {escape(world.said)}</div>"
    lines = [*world.missing, *faults]
    named = "".join(f"<li>{escape(line[:300])}</li>" for line in lines[:_MOST])
    more = f"<li>and {len(lines) - _MOST} more</li>" if len(lines) > _MOST else ""
    missing = f"<div style='color:#c92a2a'>Not shown:<ul>{named}{more}</ul></div>" if lines else ""
    return f"{_BOX}{head}{missing}</div>"
