"""Arrays only, no camera: a torus from NumPy, a complex, signals of any image at given uv, responses."""

import time

import numpy as np

from tspslam import build_complex, sample_signals, tmahf


def torus(rings: int, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and triangles (F, 3) of a torus, R = 1, r = 0.4, on a regular grid."""
    i, j = (axis.ravel() for axis in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij"))
    a, b = 2 * np.pi * i / rings, 2 * np.pi * j / sides
    xyz = np.column_stack([(1 + 0.4 * np.cos(b)) * np.cos(a), (1 + 0.4 * np.cos(b)) * np.sin(a), 0.4 * np.sin(b)])
    corner = i * sides + j
    right, down = (i + 1) % rings * sides + j, i * sides + (j + 1) % sides
    across = (i + 1) % rings * sides + (j + 1) % sides
    return xyz, np.concatenate([np.column_stack([corner, right, across]), np.column_stack([corner, across, down])])


# Any uv will do: here the torus seen from above, its centre at the centre of the image.
xyz, faces = torus(200, 100)
uv = 256 + 180 * xyz[:, :2]
v, u = np.mgrid[:513, :513] / 512
image = np.stack([u, v, np.full_like(u, 0.5)], axis=2)  # red grows with u, green with v, blue is constant

complex_ = build_complex(faces, len(xyz))
around = complex_.neighbours()
print(f"torus: N={complex_.n} E={len(complex_.edges)} F={len(complex_.faces)}, Euler {complex_.euler}")
print(f"B1 B2: largest entry {abs(complex_.B1 @ complex_.B2).max()}")
print("neighbours of vertex 0:", *(f"{matrix[[0]].sum()} {name}" for name, matrix in around._asdict().items()))

signals = sample_signals(image, uv, complex_)  # luminance
for order in range(4):
    response = tmahf(complex_, uv, signals, order=order)
    print(f"order {order}: median |r| {np.median(response.magnitude[response.defined]):.5f}")

# Several channels at once: signals are (n, C), and so are the responses.
colour = sample_signals(image, uv, complex_, channels="all")
response = tmahf(complex_, uv, colour, order=1, centering="plane")
red, green, blue = response.z[response.defined].T
print(f"phase: red {np.degrees(np.median(np.angle(red))):.2f}, green {np.degrees(np.median(np.angle(green))):.2f} deg")
print(f"slope: red {np.median(np.abs(red)):.6f} per px (1/512), blue {np.abs(blue).max():.0e}")

started = time.perf_counter()
again = build_complex(faces, len(xyz))
tmahf(again, uv, sample_signals(image[:, :, 0], uv, again))
print(f"time: {1e6 * (time.perf_counter() - started) / len(xyz):.2f} us per vertex for complex, signals and response")
