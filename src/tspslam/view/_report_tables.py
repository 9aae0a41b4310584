"""Numbers of a run as tables: short ones open, long ones folded; settings that are not the default."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ._html import shown_value, text

LONG_TABLE = 14  # rows; longer ones are folded
MOST_ROWS = 400  # of a table: a page of thousands is slow, and run.json has them
FOLDED = frozenset({"settings", "versions", "hashes", "seeds", "environment"})
TOLD = frozenset({"status", "warnings", "evaluation", "calibration", "loop_closures", "skipped", "recordings"})
"""What stands elsewhere on the page of a whole run."""
UNITS = {"px": "px", "m": "m", "m2": "m²", "s": "s", "ms": "ms", "deg": "°", "rad": "rad", "percent": "%", "mb": "MB"}
NAMES = {"n": "vertices", "euler": "Euler_characteristic"}

Table = tuple[str, list[list[Any]], list[str]]
"""Its name, its rows, and the names of its columns, if it has more than two."""


def numbers_section(run: Mapping[str, Any], *, folded: bool, told: frozenset[str]) -> str:
    """Make the section of the short tables of a run, or of those that are folded, without what is told elsewhere."""
    chosen = [table for table in _tables(run, told) if _is_folded(table[0], table[1]) == folded]
    chosen.sort(key=lambda table: bool(table[2]))
    cards = [_card(*table, folded=folded) for table in chosen]
    if not cards:
        return ""
    title = "Details" if folded else "Numbers"
    name = title.lower()
    cards_ = f'<div class="cards">{"".join(cards)}</div>'
    return f'<section aria-labelledby="{name}"><h2 id="{name}">{title}</h2>{cards_}</section>'


def settings_section(settings: Mapping[str, Mapping[str, Any]] | None) -> str:
    """Make the section of the settings that are not the default, or say that all are; nothing of unknown ones."""
    if settings is None:
        return ""
    head = '<section aria-labelledby="settings"><h2 id="settings">Settings</h2>'
    if not settings:
        return f'{head}<p class="quiet">All settings are the defaults.</p></section>'
    rows = [
        [
            name,
            row.get("value"),
            row.get("default"),
            row.get("unit") or "",
            str(row.get("meaning", "")).replace("`", ""),
        ]
        for name, row in settings.items()
    ]
    words = f"{len(rows)} of them {'differs' if len(rows) == 1 else 'differ'} from the default; config.yaml has all."
    columns = ["setting", "value", "default", "unit", "meaning"]
    return f'{head}<p class="quiet">{words}</p><div class="card">{_table("settings", rows, columns)}</div></section>'


def is_table(value: Any) -> bool:
    """Whether a value is a mapping, or a row of mappings."""
    rows = isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(row, Mapping) for row in value)
    return isinstance(value, Mapping) or rows


def _tables(run: Mapping[str, Any], told: frozenset[str]) -> list[Table]:
    """Plain values together, then each mapping, and each row of mappings."""
    shown = {key: value for key, value in run.items() if key not in told}
    plain = [[key, value] for key, value in shown.items() if not is_table(value)]
    tables: list[Table] = [("run", plain, [])] if plain else []
    for key, value in shown.items():
        if isinstance(value, Mapping) and value:
            tables.append((key, [[k, v] for k, v in _flat(value)], []))
        elif is_table(value) and value:
            columns = list(dict.fromkeys(str(k) for row in value for k in row))
            tables.append((key, [[row.get(c) for c in columns] for row in value], columns))
    return tables


def _is_folded(key: str, rows: list[list[Any]]) -> bool:
    return key in FOLDED or len(rows) > LONG_TABLE


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    pairs: list[tuple[str, Any]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{prefix}{key}.")
        else:
            pairs.append((f"{prefix}{key}", value))
    return pairs


def _card(key: str, rows: list[list[Any]], columns: list[str], *, folded: bool) -> str:
    table = _table(key, rows, columns)
    wide = " wide" if columns else ""
    if folded:
        head = f"<summary>{_label(key)} <small>{len(rows)}</small></summary>"
        return f'<details class="card{wide}">{head}{table}</details>'
    return f'<div class="card{wide}"><h3>{_label(key)}</h3>{table}</div>'


def _table(key: str, rows: list[list[Any]], columns: list[str]) -> str:
    """A table that scrolls by itself, by keyboard too, where it has many columns."""
    if not columns:
        body = "".join(f'<tr><th scope="row">{_label(k)}</th><td>{shown_value(v)}</td></tr>' for k, v in rows)
        return f'<div class="scroll"><table><tbody>{body}</tbody></table></div>'
    head = "".join(f'<th scope="col">{_label(c)}</th>' for c in columns)
    body = "".join("<tr>" + "".join(f"<td>{shown_value(v)}</td>" for v in row) + "</tr>" for row in rows[:MOST_ROWS])
    more = f'<p class="quiet">The first {MOST_ROWS} of {len(rows)} rows; run.json has all.</p>'
    return (
        f'<div class="scroll" role="region" tabindex="0" aria-label="Table: {_label(key)}"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>{more if len(rows) > MOST_ROWS else ''}"
    )


def _label(key: Any) -> str:
    """A key in words, with its unit: ``vertical_offset_px`` becomes "vertical offset [px]"."""
    words = NAMES.get(str(key), str(key)).split("_")
    unit = UNITS.get(words[-1].lower()) if len(words) > 1 else None
    return text(f"{' '.join(words[:-1])} [{unit}]" if unit else " ".join(words))
