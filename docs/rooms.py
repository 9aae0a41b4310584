"""The drawing of the package's rooms and the arrows between them, from the tables of the architecture page."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.patches import FancyBboxPatch

PAGE = Path(__file__).with_name("architecture.rst")
TOPOLOGY = Path(__file__).parents[1] / "src" / "tspslam" / "topology"
ROW = re.compile(r"^ +(\w+) {2,}(\S.*?) +->(.*(?:\n {20,}\S.*)*)$", re.MULTILINE)
WINGS = {"vision": (0.2, 6.6), "topology": (7.4, 11.8)}  # from left to right
ACROSS = {  # middle of a room; how high it stands follows from the arrows
    "cli": 5.6, "scale": 5.6, "printing": 9.2, "run": 5.6, "interop": 5.6, "datasets": 5.6, "session": 1.2,
    "settings": 3.4, "io": 6.6, "view": 8.9, "slam": 2.9, "stereo": 2.9, "features": 2.9,
    "calibration": 1.1, "visibility": 5.7, "evaluate": 4.4, "depth": 1.1, "frame": 7.1,
    "mapping": 3.3, "topological_map": 9.1, "apps": 11.0,
}  # fmt: skip
BESIDE = {"printing": "run", "depth": "stereo"}  # at whose height a room stands that imports no other
FLOOR, STEP = 3.5, 1.1  # height of the wings, and from one level of rooms to the next
INNER_FLOOR, INNER_STEP = 0.95, 0.65


def read_tables() -> list[dict[str, tuple[str, set[str]]]]:
    """Rooms of the package, then those of `vision`: what each is for, and which it may import."""
    blocks = PAGE.read_text(encoding="utf-8").split(".. code-block:: text\n")[1:3]
    return [
        {name: (purpose, set(re.findall(r"\w+", below))) for name, purpose, below in ROW.findall(block)}
        for block in blocks
    ]


def draw(path: Path) -> None:
    """Draw both tables; an arrow that others imply is left out."""
    rooms, inner = read_tables()
    spots = {name: (ACROSS[name], FLOOR + STEP * (level(name, rooms) - 1.35)) for name in rooms.keys() - WINGS.keys()}
    nested = {name: (ACROSS[name], INNER_FLOOR + INNER_STEP * level(name, inner)) for name in inner}
    figure, ax = plt.subplots(figsize=(11.5, 8.4), layout="constrained")
    box(ax, (0.2, 0), 11.6, 0.6, "0.88", "types, errors and what else all rooms stand on")
    for name in WINGS:
        wing(ax, name, rooms[name][0])
    box(ax, (0.5, 0.95), 5.8, 0.35, "0.88", "rig, se3, images")
    for name, (x, y) in spots.items():
        box(ax, (x - 0.95, y - 0.33), 1.9, 0.66, "white", name, rooms[name][0])
    for name, (x, y) in nested.items():
        box(ax, (x - 0.58, y - 0.2), 1.16, 0.4, "white", name)
    arrows(ax, rooms, spots, 0.33)
    arrows(ax, inner, nested, 0.2)
    ax.set(xlim=(0, 12), ylim=(-0.1, max(y for _, y in spots.values()) + 0.5))
    ax.axis("off")
    figure.savefig(path)
    plt.close(figure)


def level(name: str, rooms: dict) -> int:
    """1 for a room that imports no other, else one above the highest that it imports."""
    return 1 + max((level(other, rooms) for other in rooms[BESIDE.get(name, name)][1] - BESIDE.keys()), default=0)


def direct(name: str, rooms: dict) -> set[str]:
    """What a room may import, but for what it reaches through the others."""
    below = rooms[name][1]
    return below - {far for near in below for far in reachable(near, rooms)}


def reachable(name: str, rooms: dict) -> set[str]:
    return rooms[name][1] | {far for near in rooms[name][1] for far in reachable(near, rooms)}


def wing(ax: plt.Axes, name: str, purpose: str) -> None:
    """A wing, and in that of the topology the files that it has."""
    left, right = WINGS[name]
    box(ax, (left, 0.8), right - left, FLOOR - 0.8, "0.95")
    ax.text(left + 0.2, FLOOR - 0.15, name, weight="bold", va="top", size=11)
    ax.text(left + 0.2, FLOOR - 0.43, purpose, va="top", size=8.5)
    if name == "topology":
        for k, file in enumerate(sorted(path.stem for path in TOPOLOGY.glob("[a-z]*.py"))):
            ax.text(left + 0.2 + 1.4 * (k // 6), FLOOR - 0.95 - 0.3 * (k % 6), file, va="top", size=9)


def box(ax: plt.Axes, corner, width: float, height: float, colour: str, name: str = "", purpose: str = "") -> None:
    style = "round,pad=0,rounding_size=0.08"
    ax.add_patch(FancyBboxPatch(corner, width, height, boxstyle=style, fc=colour, ec="0.35", lw=0.8))
    x, y = corner[0] + width / 2, corner[1] + height / 2
    weight = "bold" if colour == "white" else "normal"
    ax.text(x, y + (0.12 if purpose else 0), name, ha="center", va="center", weight=weight, size=10)
    ax.text(x, y - 0.16, purpose, ha="center", va="center", size=7.5)


def arrows(ax: plt.Axes, rooms: dict, spots: dict[str, tuple[float, float]], half: float) -> None:
    line = {"arrowstyle": "-|>", "color": "0.25", "shrinkA": 0, "shrinkB": 0}
    for name, (x, y) in spots.items():
        for other in direct(name, rooms):
            left, right = WINGS.get(other, (0, 0))
            u, v = (min(max(x, left + 0.4), right - 0.4), FLOOR - half) if other in WINGS else spots[other]
            ax.annotate("", (u, v + half), (x + min(max(u - x, -0.8), 0.8), y - half), arrowprops=line)
