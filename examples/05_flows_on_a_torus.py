"""A vector field becomes an edge flow in one line, and Hodge finds what of it runs around the holes of a torus."""

import numpy as np

from tspslam import betti_numbers, build_complex, edge_flow, harmonic_basis, hodge_decompose

# Two angles, positions, and triangles: along the ring, and around its tube.
rings, sides = 120, 60
i, j = (axis.ravel() for axis in np.meshgrid(np.arange(rings), np.arange(sides), indexing="ij"))
a, b = 2 * np.pi * i / rings, 2 * np.pi * j / sides
xyz = np.column_stack([(1 + 0.4 * np.cos(b)) * np.cos(a), (1 + 0.4 * np.cos(b)) * np.sin(a), 0.4 * np.sin(b)])
corner, right, down = i * sides + j, (i + 1) % rings * sides + j, i * sides + (j + 1) % sides
across = (i + 1) % rings * sides + (j + 1) % sides
complex_ = build_complex(np.concatenate([np.stack([corner, right, across], 1), np.stack([corner, across, down], 1)]))
print(f"torus: N={complex_.n} E={len(complex_.edges)} F={len(complex_.faces)}, {betti_numbers(complex_)}")

fields = {
    "along": np.column_stack([-np.sin(a), np.cos(a), 0 * a]),
    "around": np.column_stack([-np.sin(b) * np.cos(a), -np.sin(b) * np.sin(a), np.cos(b)]),
    "down": np.tile([0.0, 0.0, -1.0], (len(xyz), 1)),
}
harmonic = {}
for name, field in fields.items():
    flow = edge_flow(complex_, xyz, field)  # the integral of the field along each edge
    parts = hodge_decompose(complex_, flow)
    gradient, curl, harmonic[name] = parts
    shares = [100 * np.sum(part**2) / np.sum(flow**2) for part in parts]
    print(f"{name}: {shares[0]:.1f} % gradient, {shares[1]:.1f} % curl, {shares[2]:.1f} % harmonic")

# Both harmonic flows of the torus are there: the two that were found span all that there are.
found = np.column_stack([harmonic["along"], harmonic["around"]])
basis = harmonic_basis(complex_)
rest = basis - found @ np.linalg.lstsq(found, basis, rcond=None)[0]
print(f"rest of the basis: {np.abs(rest).max():.0e} of {basis.shape[1]} flows")
