"""The tables of the page of settings, written from what the classes of the stages say of themselves."""

import json
import re
from itertools import groupby
from pathlib import Path

from tspslam.run.config import RENAMED, flatten
from tspslam.settings import KINDS, PRESETS, Setting, list_settings


def write(folder: Path) -> None:
    """``settings.inc`` in the folder; left alone if nothing has changed."""
    folder.mkdir(exist_ok=True)
    path, text = folder / "settings.inc", page()
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def page() -> str:
    parts = [part for _, rows in groupby(list_settings(), lambda row: row.name.split(".")[0]) for part in stage(rows)]
    return "\n".join([*parts, *presets(), *renamed()])


def stage(rows):
    """A section for a stage: the choice of its kind, then a table for each kind."""
    choice, *values = rows
    name = choice.name.split(".")[0]
    yield heading(name.capitalize(), "-")
    yield f"{choice.meaning} ``{choice.name}`` is one of {', '.join(f'``{kind}``' for kind in KINDS[name])}; "
    yield f"``{choice.default}`` where nothing is said ({escaped(choice.source)}).\n"
    for kind, settings in groupby(values, lambda row: row.kind):
        yield heading(f"{name.capitalize()} ``{kind}``: `{KINDS[name][kind].__name__}`", "^")
        head = ("setting", "default", "unit", "range", "what it does, and where the default comes from")
        yield table(head, [cells(row) for row in settings], (24, 9, 13, 14, 40))


def cells(row: Setting) -> tuple[str, ...]:
    said = f"{row.meaning}\n\n       *{escaped(row.source)}*" if row.source else row.meaning
    return f"``{row.name}``", f"``{json.dumps(row.default)}``", row.unit or "", row.range, said


def presets():
    """What the presets change."""
    yield heading("Presets", "-")
    yield "Where settings start: ``--preset NAME``.\n"
    plain = flatten(PRESETS["default"])
    rows = [
        (f"``{preset}``", f"``{name}``", f"``{json.dumps(value)}``", f"``{json.dumps(plain.get(name))}``")
        for preset, settings in PRESETS.items()
        for name, value in flatten(settings).items()
        if value != plain.get(name)
    ]
    yield table(("preset", "setting", "value", "instead of"), rows, (15, 40, 20, 25))


def renamed():
    """Old names, which are refused with the new one."""
    yield heading("Names from before", "-")
    rows = [(f"``{old}``", f"``{new}``") for old, new in RENAMED.items()]
    yield table(("was", "is now"), rows, (50, 50))


def heading(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}\n"


def table(head, rows, widths) -> str:
    lines = [".. list-table::", "   :header-rows: 1", f"   :widths: {' '.join(map(str, widths))}", ""]
    for row in (head, *rows):
        lines += [f"   {'* -' if not k else '  -'} {cell}" for k, cell in enumerate(row)]
    return "\n".join([*lines, ""])


def escaped(text: str) -> str:
    return re.sub(r"([*`|_\\])", r"\\\1", text)
