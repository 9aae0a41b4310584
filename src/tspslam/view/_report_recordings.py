"""The recordings of a run of several: where the frames of each stand, and what joined it to the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ._html import shown_value, text

_COLUMNS = "Recording", "Frames", "Tracked", "Keyframes", "How it was joined", "Its own path"
_ERROR = "ATE [m]"


def recordings_section(recordings: Any) -> str:
    """Make the section of the recordings, as ``run.json`` has them; nothing of a run of one."""
    told = recordings_told(recordings)
    if not told:
        return ""
    has_errors = any(isinstance(one.get("evaluation"), Mapping) for one in told)
    head = "".join(f'<th scope="col">{name}</th>' for name in (*_COLUMNS, *([_ERROR] if has_errors else [])))
    body = "".join(_row(one, has_errors=has_errors) for one in told)
    return (
        '<section aria-labelledby="recordings"><h2 id="recordings">Recordings</h2><p class="quiet">One map and one '
        "path of all that were joined, in the frame of the first; frames are counted on from one to the next.</p>"
        '<div class="card wide"><div class="scroll" role="region" tabindex="0" aria-label="Table: recordings">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></div></section>"
    )


def recordings_told(recordings: Any) -> list[Mapping[str, Any]]:
    """Recordings of which name, first frame and number of frames are there; none where they are not what a run writes.

    Examples
    --------
    >>> len(recordings_told([{"name": "monday", "first": 0, "frames": 12}]))
    1
    >>> recordings_told("monday")
    []
    """
    given = recordings if isinstance(recordings, list | tuple) else []
    kinds = {"name": str, "first": int, "frames": int}
    are_whole = all(
        isinstance(one, Mapping) and all(isinstance(one.get(k), t) for k, t in kinds.items()) for one in given
    )
    return list(given) if are_whole else []


def _row(one: Mapping[str, Any], *, has_errors: bool) -> str:
    first, frames = one["first"], one["frames"]
    cells = [f"{first} to {first + frames - 1}" if frames else "none", f"{one.get('tracked')} of {frames}"]
    cells += [shown_value(one.get("keyframes")), text(_joined(one)), text(one.get("trajectory") or "–")]
    if has_errors:
        error = (one.get("evaluation") or {}).get("ate_rmse_m")
        cells.append(shown_value(float(f"{error:.3g}") if isinstance(error, float) else error))
    return f"<tr><td><b>{text(one['name'])}</b></td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _joined(one: Mapping[str, Any]) -> str:
    """Words for what joined a recording to the others."""
    by, loops = one.get("joined_by"), one.get("loops_to_others")
    if one["first"] == 0:
        return "the map begins with it"
    if not isinstance(by, Mapping):
        return "was not found: it is not in the map"
    more = f", and {loops} loop{'' if loops == 1 else 's'}" if loops else ""
    return f"to {by.get('recording')} at frame {by.get('frame')}, by {by.get('landmarks')} landmarks{more}"


def starts_of(recordings: Any) -> Sequence[tuple[int, str]]:
    """First frame and name of each recording but the first."""
    return [(one["first"], one["name"]) for one in recordings_told(recordings)[1:]]
