"""Train a small simplicial network on a real pair: do the signals of edges and faces tell it more than the vertices'?

pip install torch, then: python examples/04_train_a_network.py (CPU, under a minute)

The label is synthetic: stripes of one contrast are painted over the real image, finer than the mesh in some regions and
coarser in others, and each vertex is to tell in which it lies. One vertex cannot: its value is as likely in both; nor,
at periods so close to the mesh's, do its neighbours tell much. Edges and faces are means over the pixels between, where
fine stripes cancel more. Same network, same complexes: with vertices only, the signals of edges and faces are 0. It
trains on the image's left half and is tested on the right.
"""

from itertools import pairwise

import numpy as np

import tspslam
from tspslam.interop.tensors import to_pyg
from tspslam.topology.texture import luminance

try:
    import torch
except ImportError:
    raise SystemExit("PyTorch is not installed: pip install torch") from None

SEEDS, PAINTINGS, EPOCHS, WIDTH, DEPTH = 5, 60, 5, 32, 4
FINE, COARSE, REGION = 7, 28, 250  # periods, px: half and twice the median edge of 14 px, and bands of 125 px
CONTRAST = 0.15

torch.set_num_threads(1)  # the same sums on any machine
torch.use_deterministic_algorithms(True)
pair = tspslam.datasets.motorcycle()
v, u = np.indices(pair.left.shape[:2])
middle = u.mean()
grey = 0.2 + 0.6 * luminance(pair.left)  # leaves room for the stripes


def half_complexes(low: float, high: float) -> list[tuple[np.ndarray, tspslam.Complex]]:
    """Pixels and complex of the points between two columns, by three detectors; the image is not painted yet."""
    found = []
    for count in (1000, 2000, 3000):
        cloud = tspslam.reconstruct(pair, detector=tspslam.OrbDetector(count=count))
        part = (cloud.uv[:, 0] >= low) & (cloud.uv[:, 0] <= high)
        cloud = tspslam.Cloud(cloud.xyz[part], cloud.uv[part], cloud.disparity[part])
        found.append((cloud.uv, tspslam.build_complex(tspslam.delaunay_surface(cloud).faces, len(cloud))))
    return found


def wave(rng: np.random.Generator, period: float) -> np.ndarray:
    """A sine of the image's size, in any direction."""
    angle, start = rng.uniform(0, 2 * np.pi, 2)
    return np.sin(2 * np.pi / period * (u * np.cos(angle) + v * np.sin(angle)) + start)


def painted(seed: int, half: list[tuple[np.ndarray, tspslam.Complex]]) -> tuple[dict, torch.Tensor]:
    """Tensors of one complex under new stripes, and the label of each vertex: 1 in the fine ones, 0 in the coarse."""
    rng = np.random.default_rng(seed)
    is_fine = wave(rng, REGION) > 0
    image = grey + CONTRAST * np.where(is_fine, wave(rng, FINE), wave(rng, COARSE))
    uv, complex_ = half[seed % len(half)]
    column, row = np.floor(uv + 0.5).astype(int).T
    label = torch.from_numpy(is_fine[row, column]).float()
    return to_pyg(complex_, tspslam.sample_signals(image, uv, complex_)), label


def mean_over(incidence: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
    """Mean of x over the elements at each row; 0 where there are none."""
    return incidence @ x / (incidence @ torch.ones(len(x), 1)).clamp(min=1)


class Network(torch.nn.Module):
    """In each layer an element takes in itself and the means of its neighbours one level below and one above."""

    def __init__(self) -> None:
        super().__init__()
        linear, listed, sizes = torch.nn.Linear, torch.nn.ModuleList, pairwise([1] + [WIDTH] * DEPTH)
        self.layers = listed(listed(linear(parts * n, m) for parts in (2, 3, 2)) for n, m in sizes)
        self.last = linear(WIDTH, 1)

    def forward(self, data: dict, levels: tuple[int, ...]) -> torch.Tensor:
        """Evidence for fine stripes at each vertex; the signals of other levels than the given ones are hidden."""
        B1, B2 = (data[f"incidence_{k}"].abs() for k in (1, 2))  # textures have no orientation
        v, e, f = ((data[f"x_{k}"] - 0.5) * data[f"ok_{k}"][:, None] * (k in levels) for k in range(3))
        for at_vertex, at_edge, at_face in self.layers:
            new_v = at_vertex(torch.cat([v, mean_over(B1, e)], 1)).relu()
            new_e = at_edge(torch.cat([e, mean_over(B1.T, v), mean_over(B2, f)], 1)).relu()
            f = at_face(torch.cat([f, mean_over(B2.T, e)], 1)).relu()
            v, e = new_v, new_e
        return self.last(v)[:, 0]


def train_and_test(seed: int, train: list, levels: tuple[int, ...]) -> float:
    """Train on the left half; the share of the right half's vertices that are then told right."""
    torch.manual_seed(seed)
    network = Network()
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    for data, label in train * EPOCHS:
        optimiser.zero_grad()
        torch.nn.functional.binary_cross_entropy_with_logits(network(data, levels), label).backward()
        optimiser.step()
    with torch.no_grad():
        right = [(network(data, levels) > 0) == (label > 0.5) for data, label in test]
    return torch.cat(right).float().mean().item()


left_half, right_half = half_complexes(0, middle - 5), half_complexes(middle + 5, np.inf)
test = [painted(10**6 + k, right_half) for k in range(12)]
tested, share = sum(len(y) for _, y in test), np.mean([y.mean() for _, y in test])
print(f"vertices: {tested} to test, {share:.0%} of them in fine stripes")
scores: dict[str, list[float]] = {"vertices only": [], "all levels": []}
for seed in range(SEEDS):
    train = [painted(PAINTINGS * seed + k, left_half) for k in range(PAINTINGS)]
    for name, levels in zip(scores, ((0,), (0, 1, 2)), strict=True):
        scores[name].append(train_and_test(seed, train, levels))
for name, found in scores.items():
    print(f"{name}: {np.mean(found):.1%} right, spread {np.std(found, ddof=1):.1%} over {SEEDS} seeds")
gain = np.subtract(scores["all levels"], scores["vertices only"])
print("gain of each seed, in points:", *(f"{100 * g:+.1f}" for g in gain))
beats = gain.min() > 0 and gain.mean() > gain.std(ddof=1)
print("all levels beat vertices only" if beats else "all levels do not beat vertices only")
