"""Robust to bad meshes? How far responses move when edges are flipped, faces deleted, keypoints jittered."""

import numpy as np

import tspslam
from tspslam.vision.rig import back_project

from .common import SEEDS, WONG, Result, Source, degrees_between, median_and_range, panels

TITLE = "Answer b: robust to bad meshes?"
SHARES, JITTERS = (0, 0.02, 0.05, 0.1, 0.2, 0.4), (0, 0.25, 0.5, 1, 2, 4)
KINDS = {"flip": SHARES, "delete": SHARES, "jitter": JITTERS}
FILTERS = ("T-MAHF none", "T-MAHF harmonic", "MAHF conformal", "MAHF robust", "MAHF graph")


def flip(faces: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Turn the diagonal of a share of the edges with two faces; no face is touched twice, no edge made twice."""
    complex_ = tspslam.build_complex(faces, int(faces.max()) + 1)
    sides = complex_.face_edges.ravel()
    order, count = np.argsort(sides, kind="stable"), np.bincount(sides)
    first = np.cumsum(count) - count
    inner = np.flatnonzero(count == 2)
    known, touched, flipped = {*map(tuple, complex_.edges.tolist())}, set(), complex_.faces.copy()
    wanted = round(share * len(inner))
    for edge in rng.permutation(inner):
        f, g = (order[first[edge] + k] // 3 for k in (0, 1))
        i, j = complex_.edges[edge]
        a, b = (int(complex_.faces[face].sum() - i - j) for face in (f, g))
        if wanted == 0 or {f, g} & touched or (min(a, b), max(a, b)) in known:
            continue
        flipped[f], flipped[g] = (a, b, i), (a, b, j)
        touched |= {f, g}
        known.add((min(a, b), max(a, b)))
        wanted -= 1
    return flipped


def damaged(frame, kind: str, amount: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Faces and keypoints after the damage."""
    faces, uv = frame.surface.faces, frame.cloud.uv
    if kind == "flip":
        return flip(faces, amount, rng), uv
    if kind == "delete":
        return faces[np.sort(rng.permutation(len(faces))[round(amount * len(faces)) :])], uv
    return faces, np.clip(uv + rng.normal(0, amount, uv.shape), 0, (frame.rig.width - 1, frame.rig.height - 1))


def responses(frame, faces: np.ndarray, uv: np.ndarray) -> dict[str, tspslam.Response | None]:
    complex_ = tspslam.build_complex(faces, len(uv))
    signals, xyz = (
        tspslam.sample_signals(frame.pair.left, uv, complex_),
        back_project(frame.rig, uv, frame.cloud.disparity),
    )
    found: dict[str, tspslam.Response | None] = {}
    for name in FILTERS:
        kind, choice = name.split()
        try:
            if kind == "T-MAHF":
                found[name] = tspslam.tmahf(complex_, uv, signals, centering=choice)
            else:
                found[name] = tspslam.mahf(faces, xyz, signals.vertex, laplacian=choice, ok=signals.vertex_ok)
        except tspslam.GeometryError:
            found[name] = None
    return found


def moved(before: tspslam.Response | None, after: tspslam.Response | None) -> tuple[float, float]:
    """Median |r' - r| over the median |r|, and median change of phase, degrees."""
    if before is None or after is None:
        return np.nan, np.nan
    both = before.defined & after.defined
    step = np.abs(after.z - before.z)[both]
    return np.median(step) / np.median(before.magnitude[both]), np.median(degrees_between(after.z, before.z)[both])


def run(source: Source) -> Result:
    frame, seeds = source.frames(1)[0], SEEDS[:1] if source.small else SEEDS
    before = responses(frame, frame.surface.faces, frame.cloud.uv)
    table = {key: [] for key in ("damage", "amount", "filter", "move", "move_low", "move_high", "phase_deg", "refused")}
    for kind, amounts in KINDS.items():
        for amount in amounts[::2] if source.small else amounts:
            after = [responses(frame, *damaged(frame, kind, amount, np.random.default_rng(seed))) for seed in seeds]
            for name in FILTERS:
                move, phase = np.array([moved(before[name], one[name]) for one in after]).T
                row = (
                    kind,
                    amount,
                    name,
                    *median_and_range(move),
                    median_and_range(phase)[0],
                    int(np.isnan(move).sum()),
                )
                for key, value in zip(table, row, strict=True):
                    table[key].append(value)
    return Result(draw(table), table, numbers(table))


def numbers(table: dict) -> dict[str, float]:
    rows = zip(table["damage"], table["amount"], table["filter"], table["move"], table["phase_deg"], strict=True)
    found = {}
    for kind, amount, name, move, phase in rows:
        if (kind, amount) in (("flip", 0.2), ("delete", 0.2), ("jitter", 1)):
            found[f"{kind} {amount}, {name}: |Δr| / |r|"] = move
            found[f"{kind} {amount}, {name}: phase, degrees"] = phase
    return found


def draw(table: dict):
    figure, axes = panels(2, 3, 6.6)
    columns = {key: np.array(column) for key, column in table.items()}
    labels = ("share of inner edges flipped", "share of faces deleted", "jitter of keypoints, px")
    for k, kind in enumerate(KINDS):
        for colour, name, marker in zip(WONG, FILTERS, "osv^D", strict=False):
            of = (columns["damage"] == kind) & (columns["filter"] == name)
            for ax, key in ((axes[0, k], "move"), (axes[1, k], "phase_deg")):
                ax.plot(columns["amount"][of], columns[key][of], marker=marker, ms=5, color=colour, label=name)
            axes[0, k].fill_between(
                columns["amount"][of], columns["move_low"][of], columns["move_high"][of], color=colour, alpha=0.2
            )
        axes[0, k].set(title=kind, ylabel="median |Δr| / median |r|")
        axes[1, k].set(xlabel=labels[k], ylabel="median |Δ phase|, degrees")
    axes[0, 0].legend(fontsize=8)
    return figure
