"""Whether the calibration fits the images, in plain words."""

from __future__ import annotations

from collections.abc import Sequence

from ._html import text
from ._report_parts import Finding, Verdict

MARKS: dict[Verdict, tuple[str, str]] = {
    "fine": ("good", "✓"),
    "look at it": ("note", "!"),
    "wrong": ("bad", "✗"),
    "not known": ("none", "?"),
}


def health_section(findings: Sequence[Finding]) -> str:
    """Make the section of the calibration; nothing where nothing was looked at."""
    if not findings:
        return ""
    items = []
    for what, verdict, words in findings:
        tone, mark = MARKS[verdict]
        badge = f'<span class="badge {tone}"><span aria-hidden="true">{mark}</span> {verdict}</span>'
        items.append(f"<li><p><b>{text(what)}</b> {badge}</p><p>{text(words)}</p></li>")
    return (
        '<section aria-labelledby="health"><h2 id="health">Does the calibration fit?</h2>'
        f'<ul class="card findings">{"".join(items)}</ul></section>'
    )
