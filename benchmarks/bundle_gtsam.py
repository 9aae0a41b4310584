"""Bundle adjustment and pose graphs beside GTSAM: the same windows, noise and Huber costs, and the same graphs.

Both search to the same relative decrease.

``python -m benchmarks.bundle_gtsam`` prints the figures; GTSAM (4.3) is not among the dependencies.
"""

from __future__ import annotations

from functools import partial

from tests.vision.slam import gtsam_oracle as oracle
from tests.vision.slam import test_pose_graph_gtsam as graphs
from tspslam.vision.slam.least_squares.pose_graph import optimise_poses

from .measure import median_seconds, paired

Figures = dict[str, float]
ENOUGH, STEPS = 1e-6, 20  # where `adjust` ends
RIVALS = {  # how held poses are held, and the elimination
    "GTSAM QR, held by equality": ("equality", "MULTIFRONTAL_QR"),
    "GTSAM QR, held by tight priors": ("prior", "MULTIFRONTAL_QR"),
    "GTSAM Cholesky, held by tight priors": ("prior", "MULTIFRONTAL_CHOLESKY"),
}


def window_figures(hold: str, solver: str, seed: int = 0, rounds: int = 5) -> Figures:
    """Time of `adjust` and of GTSAM from the same arrays; theirs with and without the making of the graph."""
    problem = oracle.window(seed)
    search = partial(oracle.solved, solver=solver, enough=ENOUGH, max_steps=STEPS)
    made = lambda: (oracle.graph_of(problem, hold=hold), oracle.start_of(problem))  # noqa: E731
    ready = made()
    ours, whole, ratio = paired(lambda: oracle.adjusted(problem, max_steps=STEPS), lambda: search(*made()), rounds)
    _, search_only, search_ratio = paired(
        lambda: oracle.adjusted(problem, max_steps=STEPS), lambda: search(*ready), rounds
    )
    found, (values, steps) = oracle.adjusted(problem, max_steps=STEPS), search(*ready)
    return {
        "points": len(problem.xyz), "observations": len(problem.seen.pose),
        "ms": 1e3 * ours, "gtsam_ms": 1e3 * whole, "gtsam_search_ms": 1e3 * search_only,
        "gtsam_graph_ms": 1e3 * median_seconds(made, rounds), "ratio": ratio, "search_ratio": search_ratio,
        "steps": found.steps, "gtsam_steps": steps, "cost_beyond": found.cost / (2 * ready[0].error(values)) - 1,
    }  # fmt: skip


def graph_figures(name: str, rounds: int = 3) -> Figures:
    """Time of `optimise_poses` and of GTSAM's search on a graph of its own, its factors made before."""
    *given, _ = graphs.GRAPHS[name]
    edges = graphs.read(*given)
    start = graphs.chained(edges)
    graph, values = graphs.graph_of(edges, start)
    search = lambda: oracle.solved(graph, values, solver="MULTIFRONTAL_CHOLESKY", enough=ENOUGH, max_steps=100)  # noqa: E731
    ours, theirs, ratio = paired(lambda: optimise_poses(start, edges), search, rounds)
    found, (best, steps) = optimise_poses(start, edges), search()
    return {
        "poses": len(start), "edges": len(edges.i), "ms": 1e3 * ours, "gtsam_search_ms": 1e3 * theirs, "ratio": ratio,
        "steps": found.steps, "gtsam_steps": steps, "cost_beyond": found.cost / (2 * graph.error(best)) - 1,
    }  # fmt: skip


FIGURES = {name: partial(window_figures, *how) for name, how in RIVALS.items()} | {
    f"pose graph {name}": partial(graph_figures, name) for name in graphs.GRAPHS
}


def main() -> None:
    for name, figure in FIGURES.items():
        print(name)
        for key, value in figure().items():
            print(f"  {key:<24} {value:>12.4g}")


if __name__ == "__main__":
    main()
