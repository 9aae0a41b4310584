"""What surfaces of synthetic worlds look like: fallen leaves, or an image of one's own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._brief import Brief
from ...errors import InputError
from ...types import FloatArray, real_array
from ._checks import keep, number, whole

SIZE = 1024  # texels along a side of the leaves' tile
_FINER = 2  # painted so much larger, then averaged
_MIN, _LARGEST = 3.0, SIZE / 8  # texels, half length of a leaf
_COARSER = 4.3  # of the second layer


@dataclass(frozen=True, repr=False)
class Texture(Brief):
    """The look of a shape: a square tile laid over and over each of its sides.

    Leaves of random size, place and grey lie one over the other, two layers of them: the statistics of natural images
    (edges, corners, every scale). Shapes of different seeds show different parts of them; those of one seed, and the
    six sides of one shape, begin at the same place.

    Attributes
    ----------
    seed : int
        Which part of the leaves the shape shows; give each shape its own.
    texel : float
        Size of a texel, m; the finest leaves are about six texels wide.
    brightness : float
        Mean luminance, in full light (see `Shape`).
    contrast : float
        Share of the tile's contrast that is kept; 0 is a plain surface.
    image : (n, n) float32 or None
        A tile to show instead of the leaves, luminance in [0, 1]; n is a power of two, 2 to 4096. It is copied.

    Raises
    ------
    InputError
        If a value is out of its range.

    Examples
    --------
    >>> Texture(seed=3, contrast=0.5).texel
    0.01
    """

    seed: int = 0
    texel: float = 0.01
    brightness: float = 0.5
    contrast: float = 1.0
    image: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        keep(
            self,
            seed=whole(self.seed, "texture: seed", 0),
            texel=number(self.texel, "texture: texel", 1e-6, 1e6, "m"),
            brightness=number(self.brightness, "texture: brightness", 0, 1),
            contrast=number(self.contrast, "texture: contrast", 0, 4),
            image=None if self.image is None else _tile(self.image),
        )

    def tile(self, leaves_seed: int) -> NDArray[np.float32]:
        """Luminance of the texture: the image, or the leaves of a world.

        Parameters
        ----------
        leaves_seed : int
            Which leaves.

        Returns
        -------
        (n, n) float32
            In [0, 1].
        """
        return leaves(leaves_seed) if self.image is None else self.image

    def look(self, shade: float) -> FloatArray:
        """Numbers that the renderer needs for one side.

        Parameters
        ----------
        shade : float
            How brightly it is lit, 0 to 1.

        Returns
        -------
        (8,) float64
        """
        per_metre = 1 / self.texel
        fine_s, fine_t, coarse_s, coarse_t = np.random.default_rng((77, self.seed)).uniform(0, SIZE, 4)
        if self.image is not None:
            return np.array([per_metre, 0, 0, self.brightness * shade, self.contrast * shade, 0, 0, 0])
        # the mean of two layers has 1 / √2 of the contrast of one
        look = (self.brightness * shade, 2**0.5 * self.contrast * shade)
        return np.array([per_metre, fine_s, fine_t, *look, per_metre / _COARSER, coarse_s, coarse_t])


def _tile(values: Any) -> NDArray[np.float32]:
    image = real_array(values, "texture: image", "(n, n)")
    side = image.shape[0] if image.ndim == 2 else 0
    if image.ndim != 2 or image.shape != (side, side) or not 2 <= side <= 4096 or side & (side - 1):
        raise InputError(f"texture: image has shape {image.shape}, expected (n, n), n a power of two, 2 to 4096")
    if image.dtype.kind != "f" or not ((image >= 0) & (image <= 1)).all():
        span = f"{float(image.min()):g} to {float(image.max()):g}"
        raise InputError(f"texture: image is {image.dtype} from {span}, expected floats from 0 to 1")
    return image.astype(np.float32)


@lru_cache(maxsize=4)
def leaves(seed: int) -> NDArray[np.float32]:
    """Paint a tile of leaves that wraps around; the same for the same seed.

    Parameters
    ----------
    seed : int
        Which tile.

    Returns
    -------
    (1024, 1024) float32
        Luminance in [0, 1].
    """
    from ._kernels import paint

    side, count = SIZE * _FINER, 24_000
    rng = np.random.default_rng(seed)
    inverse_square = rng.uniform(_LARGEST**-2, _MIN**-2, count)  # density of sizes ~ size^-3
    size, angle = _FINER * inverse_square**-0.5, rng.uniform(0, np.pi, count)
    place, shape, grey = rng.uniform(0, side, (2, count)), rng.uniform(0.3, 1, count), rng.uniform(0.02, 0.98, count)
    is_round = rng.random(count) < 0.35
    drawn = np.stack([*place, size, size * shape, np.cos(angle), np.sin(angle), grey, is_round], axis=1)
    tile = np.full((side, side), 0.5, np.float32)
    paint(tile, np.concatenate([drawn[np.argsort(-size)[:200]], drawn]))
    mean = tile.reshape(SIZE, _FINER, SIZE, _FINER).mean(axis=(1, 3), dtype=np.float64).astype(np.float32)
    mean.flags.writeable = False
    return mean


def pyramid(tile: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """A tile and its halves, down to one texel: each texel the mean of four finer ones.

    Parameters
    ----------
    tile : (n, n) float32
        n is a power of 2.

    Returns
    -------
    list of (k, k) float32
        k = n, n / 2 and so on to 1.
    """
    levels = [tile]
    while levels[-1].shape[0] > 1:
        half = levels[-1].shape[0] // 2
        levels.append(levels[-1].reshape(half, 2, half, 2).mean(axis=(1, 3), dtype=np.float64).astype(np.float32))
    return levels
