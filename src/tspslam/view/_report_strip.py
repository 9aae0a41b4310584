"""How each frame of a run went: a strip with one cell a frame, told apart by height and mark as well as by colour."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence

from ._html import shown_value, text
from ._report_parts import STATES, FrameState, State

MOST_CELLS = 400  # cells that a screen still shows; more frames share one
# Height of a cell in a hundred, and its mark; colours of Okabe and Ito, in the style sheet.
LOOK: dict[State, tuple[int, str]] = {
    "lost": (100, "cross"),
    "skipped": (100, "hollow"),
    "weak": (22, ""),
    "loop": (86, "dot"),
    "keyframe": (70, ""),
    "tracked": (45, ""),
}
_RANK = {state: place for place, state in enumerate(STATES)}
_LONGEST_LIST = 12  # spans of frames that are named


def strip_section(states: Sequence[FrameState], starts: Sequence[tuple[int, str]] = ()) -> str:
    """Make the section of a run of several frames, with lines where recordings begin; nothing of a run of one."""
    if len(states) < 2:
        return ""
    each = -(-len(states) // MOST_CELLS)
    cells = [states[k : k + each] for k in range(0, len(states), each)]
    said = f" Each cell is {each} frames, as the worst of them went." if each > 1 else ""
    bars = "".join(_cell(k, cell) for k, cell in enumerate(cells)) + _lines(cells, starts)
    said += "".join(f" The line at frame {first} is where {text(name)} begins." for first, name in starts)
    return (
        '<section class="strip" aria-labelledby="strip"><h2 id="strip">Frame by frame</h2>'
        f'<p class="quiet">From the first frame on the left to the last on the right. Each height stands for a '
        f"state; a frame of which two are true counts as the one that is named first below.{said}</p>"
        f'<svg class="cells" role="img" aria-label="{text(summary_of(states))}" viewBox="0 0 {10 * len(cells)} 100" '
        f'preserveAspectRatio="none">{bars}</svg>'
        f'<p class="ends"><span>frame {states[0].frame}</span><span>frame {states[-1].frame}</span></p>'
        f"{_legend(states)}{_where(states)}</section>"
    )


def summary_of(states: Sequence[FrameState]) -> str:
    """Say how many frames there are of each state.

    Examples
    --------
    >>> summary_of([FrameState(0, "a", 0.0, "keyframe", 90), FrameState(1, "b", 0.1, "tracked", 80)])
    '2 frames: 1 keyframe, 1 tracked'
    """
    count = Counter(one.state for one in states)
    return f"{len(states)} frames: " + ", ".join(f"{count[state]} {state}" for state in STATES if count[state])


def spans_of(indices: Sequence[int]) -> list[str]:
    """Write ascending numbers as spans.

    Examples
    --------
    >>> spans_of([3, 4, 5, 9])
    ['3 to 5', '9']
    """
    spans: list[tuple[int, int]] = []
    for index in indices:
        if spans and index == spans[-1][1] + 1:
            spans[-1] = (spans[-1][0], index)
        else:
            spans.append((index, index))
    return [str(first) if first == last else f"{first} to {last}" for first, last in spans]


def _cell(place: int, frames: Sequence[FrameState]) -> str:
    """One bar from the ground up, as the worst of its frames."""
    worst = min(frames, key=lambda one: _RANK[one.state])
    height, mark = LOOK[worst.state]
    x, y = 10 * place, 100 - height
    span = f"frame {worst.frame}" if len(frames) == 1 else f"frames {frames[0].frame} to {frames[-1].frame}"
    seen = "" if worst.landmarks is None else f", {worst.landmarks} landmarks"
    title = f"{span}: {worst.state}{'' if len(frames) == 1 else f' in frame {worst.frame}'}{seen} ({worst.name})"
    return f'<g class="{worst.state}"><title>{text(title)}</title>{_bar(x, y, height, mark)}</g>'


def _lines(cells: Sequence[Sequence[FrameState]], starts: Sequence[tuple[int, str]]) -> str:
    """A line before the cell in which each further recording begins."""
    lasts = [cell[-1].frame for cell in cells]
    return "".join(
        f'<path class="begin" d="M{10 * bisect_left(lasts, first) - 0.5:g} 0V100"><title>{text(name)}</title></path>'
        for first, name in starts
    )


def _bar(x: float, y: float, height: float, mark: str) -> str:
    """A bar of a cell 10 wide, with its mark."""
    if mark == "hollow":
        return f'<rect x="{x + 1.5:g}" y="2" width="7" height="96" class="open"/>'
    bar = f'<rect x="{x}" y="{y}" width="9" height="{height}"/>'
    if mark == "cross":
        return f'{bar}<path d="M{x} 0L{x + 9} 100M{x + 9} 0L{x} 100" class="mark"/>'
    return f'{bar}<rect x="{x + 1.5:g}" y="{y - 12}" width="6" height="8"/>' if mark == "dot" else bar


def _legend(states: Sequence[FrameState]) -> str:
    """Each state that occurs, with its sign, how often, and what it means."""
    count = Counter(one.state for one in states)
    rows = []
    for state, meaning in STATES.items():
        if count[state]:
            sign = f'<svg viewBox="0 0 10 100" preserveAspectRatio="none" aria-hidden="true">{_sign(state)}</svg>'
            rows.append(f"<li>{sign}<span><b>{shown_value(count[state])} {state}</b>: {meaning}</span></li>")
    return f'<ul class="signs">{"".join(rows)}</ul>'


def _sign(state: State) -> str:
    height, mark = LOOK[state]
    return f'<g class="{state}">{_bar(0, 100 - height, height, mark)}</g>'


def _where(states: Sequence[FrameState]) -> str:
    """Which frames did not go well, in words."""
    lines = []
    for state in ("lost", "skipped", "weak", "loop"):
        spans = spans_of([one.frame for one in states if one.state == state])
        if spans:
            more = f" and {len(spans) - _LONGEST_LIST} more" if len(spans) > _LONGEST_LIST else ""
            plural = "" if len(spans) == 1 and spans[0].isdigit() else "s"
            lines.append(f"<li>{state}: frame{plural} {text(', '.join(spans[:_LONGEST_LIST]))}{more}</li>")
    return f'<ul class="quiet where">{"".join(lines)}</ul>' if lines else ""
