"""The heat kernel against the number of hops, with an exponential fitted by least squares on K itself.

Graph Laplacian with binary weights, t = 1, Chebyshev, all connected pairs. The paper says that K decays
exponentially, and gives no R². It does decay, and the fit explains most of the variance: that of the first three
rings, where K is large. On the logarithmic scale the decay is faster than any exponential (heat at a distance falls
like a Gaussian), and at the same number of hops K differs up to tenfold, which no weight of the hops alone can
follow. The band is the fitted curve's, 95 %; the bars are K's own, 5 to 95 %.
"""

import numpy as np
from scipy.optimize import curve_fit
from scipy.sparse.csgraph import shortest_path

import tspslam

from .common import Result, Source
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
    rest = ((K - decay(hops, *best)) ** 2).sum()
    return best, covariance, 1 - rest / ((K - K.mean()) ** 2).sum()


def run(source: Source) -> Result:
    hops, K = pairs(source.frames(1)[0].complex_)
    best, covariance, R2 = fit(hops, K)
    rings = np.arange(1, 9)
    low, middle, high = np.array([np.percentile(K[hops == h], [5, 50, 95]) for h in rings]).T
    figure, axes = panels(1, 2, 4.2)
    fine = np.linspace(1, 8, 200)
    slope = np.stack([np.exp(-best[1] * fine), -fine * decay(fine, *best)])
    band = 1.96 * np.sqrt(np.einsum("ik,ij,jk->k", slope, covariance, slope))
    chosen = np.random.default_rng(0).permutation(len(K))[:40_000]
    for ax, scale in zip(axes[0], ("linear", "log"), strict=True):
        near = chosen[hops[chosen] <= 8]
        jitter = np.random.default_rng(1).uniform(-0.18, 0.18, len(near))
        ax.plot(hops[near] + jitter, K[near], ".", ms=1.5, color=WONG[4], alpha=0.4, rasterized=True)
        ax.errorbar(
            rings, middle, (middle - low, high - middle), fmt="s", ms=4, color="k", capsize=3, label="median, 5 to 95 %"
        )
        ax.plot(fine, decay(fine, *best), color=WONG[5], label=f"{best[0]:.3f} exp(-{best[1]:.3f} hops), R² = {R2:.3f}")
        ax.fill_between(
            fine, decay(fine, *best) - band, decay(fine, *best) + band, color=WONG[5], alpha=0.4, label="95 %"
        )
        ax.set(xlabel="hops", ylabel="K(i, j)", yscale=scale, ylim=(1e-9, 1) if scale == "log" else (0, None))
    axes[0, 0].legend()
    numbers = {
        "pairs": len(K),
        "a": best[0],
        "b": best[1],
        "R² on K": R2,
        "b: half width of 95 %": 1.96 * covariance[1, 1] ** 0.5,
    }
    numbers |= {f"median K at {h} hops": m for h, m in zip((1, 2, 3), middle, strict=False)}
    return Result(figure, {"hops": rings, "K_5": low, "K_median": middle, "K_95": high}, numbers)
