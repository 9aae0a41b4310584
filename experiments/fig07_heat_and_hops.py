"""The heat kernel against the number of hops, with an exponential fitted by least squares on K itself.

Graph Laplacian with binary weights, t = 1, Chebyshev, all connected pairs. The paper says that K decays
exponentially, and gives no R². K does decay, but faster than an exponential: up to eight hops the medians follow
A c^d / d! at d hops, as in a Poisson law, with c about 1.2. R² is 0.83 over 437 303 pairs, nearly all of them far apart
with K near 0; among the 21 614 pairs within three hops it is 0.58. No function of the hops alone can have more than
0.835 over all pairs, for at the same number of hops K differs: the bars, 5 to 95 %, span a factor of 3 at one hop and
of 11 to 18 at six to eight. The narrow band is the fitted curve's, 95 %; it takes the pairs for independent, which they
are not, so it says too little.
"""

import numpy as np
from scipy.optimize import curve_fit
from scipy.sparse.csgraph import shortest_path
from scipy.special import gammaln

import tspslam

from .common import Result, Source, explained
from .look import WONG, panels

TITLE = "Figure 7: heat and hops"


def decay(hops: np.ndarray, a: float, b: float) -> np.ndarray:
    return a * np.exp(-b * hops)


def pairs(complex_: tspslam.Complex) -> tuple[np.ndarray, np.ndarray]:
    """Hops and K of all connected pairs i < j."""
    L0 = complex_.L0.tocsr()
    kernel = tspslam.heat_kernel(L0, 1.0).rows(np.arange(complex_.n))
    hops = shortest_path(abs(L0), unweighted=True)
    i, j = np.triu_indices(complex_.n, 1)
    near = np.isfinite(hops[i, j])
    return hops[i, j][near].astype(int), kernel[i, j][near]


def fit(hops: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """(a, b), their covariance, and R² on K."""
    best, covariance = curve_fit(decay, hops, K, p0=(1.0, 2.0))
    return best, covariance, explained(K, decay(hops, *best))


def run(source: Source) -> Result:
    hops, K = pairs(source.frames(1)[0].complex_)
    best, covariance, R2 = fit(hops, K)
    rings = np.arange(1, 9)
    least, low, middle, high, most = np.array([np.percentile(K[hops == h], [0, 5, 50, 95, 100]) for h in rings]).T
    figure, axes = panels(1, 2, 4.2)
    fine = np.linspace(1, 8, 200)
    curve = decay(fine, *best)
    slope = np.stack([np.exp(-best[1] * fine), -fine * curve])
    band = 1.96 * np.sqrt(np.einsum("ik,ij,jk->k", slope, covariance, slope))
    chosen = np.random.default_rng(0).permutation(len(K))[:40_000]
    for ax, scale in zip(axes[0], ("linear", "log"), strict=True):
        near = chosen[hops[chosen] <= 8]
        jitter = np.random.default_rng(1).uniform(-0.18, 0.18, len(near))
        ax.plot(hops[near] + jitter, K[near], ".", ms=1.5, color=WONG[4], alpha=0.4, rasterized=True)
        bars = {"fmt": "s", "ms": 4, "color": "k", "capsize": 3, "label": "median, 5 to 95 %"}
        ax.errorbar(rings, middle, (middle - low, high - middle), **bars)
        ax.plot(fine, curve, color=WONG[5], label=f"{best[0]:.3f} exp(-{best[1]:.3f} hops), R² = {R2:.3f}")
        ax.fill_between(fine, curve - band, curve + band, color=WONG[5], alpha=0.4, label="95 %")
        ax.set(xlabel="hops", ylabel="K(i, j)", yscale=scale, ylim=(1e-9, 1) if scale == "log" else (0, None))
    axes[0, 0].legend()
    close, mean = hops <= 3, np.bincount(hops, K) / np.maximum(np.bincount(hops), 1)
    poisson = np.polyfit(rings, np.log(middle) + gammaln(rings + 1), 1)
    numbers = {
        "pairs": len(K), "a": best[0], "b": best[1], "R² on K": R2, "pairs within 3 hops": close.sum(),
        "R² on K within 3 hops": explained(K[close], decay(hops[close], *best)),
        "R² on K of the mean at each number of hops": explained(K, mean[hops]),
        "b: half width of 95 %, pairs taken for independent": 1.96 * covariance[1, 1] ** 0.5,
        "c of A c^d / d!, fitted to the medians' logarithms": np.exp(poisson[0]),
    }  # fmt: skip
    numbers |= {f"median K at {h} hops": m for h, m in zip((1, 2, 3), middle, strict=False)}
    numbers |= {f"K at {h} hops, 95 % over 5 %": high[h - 1] / low[h - 1] for h in (1, 6, 8)}
    numbers |= {f"K at {h} hops, largest over least": most[h - 1] / least[h - 1] for h in (1, 6, 8)}
    return Result(figure, {"hops": rings, "K_5": low, "K_median": middle, "K_95": high}, numbers)
