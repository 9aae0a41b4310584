"""What a map is good for: a frame denoised, divided into regions, compared with what it was, and recognised."""

import numpy as np

import tspslam
from tspslam.datasets import synthetic

pair = synthetic.SyntheticSequence(synthetic.room(frames=40), faults=synthetic.Faults(noise=0.05))[3]
cloud = tspslam.reconstruct(pair)
surface = tspslam.delaunay_surface(cloud)
complex_ = tspslam.build_complex(surface.faces, len(cloud))
signals = tspslam.sample_signals(pair.left, cloud.uv, complex_)
bank = tspslam.tmahf_bank(complex_, cloud.uv, signals, orders=(1, 2, 3))

noise = tspslam.estimate_noise(pair.left)
clean = tspslam.denoise_signals(complex_, signals, uv=cloud.uv, noise=noise)
sharp = tspslam.denoise_cloud(cloud, surface, pair.left, rig=pair.rig)
moved = np.linalg.norm(sharp.xyz - cloud.xyz, axis=1)
changed = np.std(clean.vertex - signals.vertex)
print(f"noise of {noise:.3f}: signals changed by {changed:.3f}, points moved by {np.median(moved):.3f} m")

regions = tspslam.segment(complex_, signals, xyz=cloud.xyz, covariance=cloud.covariance)
cells = tspslam.merge_cells(complex_, tspslam.disc_labels(complex_, regions))
print(f"{len(regions)} faces in {regions.max() + 1} regions, the largest of {np.bincount(regions).max()}")
print(f"{len(cells.faces)} cells of a cell complex")

score, parts = tspslam.compare_quality((cloud.xyz, complex_, signals), (sharp.xyz, complex_, clean))
print(f"before and after differ by {score:.3f}, most in {max(parts, key=parts.get)}")

here = tspslam.describe(complex_, signals, bank)
print(f"a place in {len(here)} numbers")
