"""Each stage by itself, then some of them exchanged: a stage is any callable of the same shape."""

import numpy as np

import tspslam
from tspslam.topology.texture import luminance

# The walk: a pair, points, a surface, a complex, signals on its vertices, edges and faces, a response.
pair = tspslam.datasets.motorcycle()
cloud = tspslam.reconstruct(pair)
surface = tspslam.delaunay_surface(cloud)
complex_ = tspslam.build_complex(surface.faces, len(cloud))
signals = tspslam.sample_signals(pair.left, cloud.uv, complex_)
response = tspslam.tmahf(complex_, cloud.uv, signals, order=1)  # centering="harmonic"

print(f"walk: {len(cloud)} points, {len(complex_.faces)} faces, {response.defined.sum()} responses")

# Exchange the detector, the surface and the filter of a session.
fewer = tspslam.Settings(
    detector=tspslam.OrbDetector(count=500),
    surface=lambda points: tspslam.delaunay_surface(points, max_depth_ratio=0.02),
    filter=tspslam.Tmahf(order=2),
)
frame = tspslam.Session(pair.rig, fewer).process(pair)
print(f"exchanged: {len(frame.cloud)} points, {len(frame.complex_.faces)} faces, order {frame.response.order}")


# A weight that falls off over two rings; the default is 1 up to d = 1, eq. (17).
def two_rings(d: int) -> float:
    return 0.5**d if d <= 2 else 0.0


wide = tspslam.tmahf(complex_, cloud.uv, signals, order=1, weight=two_rings)
turned = np.degrees(np.abs(np.angle(wide.z * response.z.conj())[wide.defined & response.defined]))
print(f"two rings: phase differs from one ring by {np.median(turned):.0f} degrees in the median")

# Does a filter answer to the texture, or to where the neighbours stand? A constant image has no texture.
grey = np.full(pair.left.shape[:2], luminance(pair.left).mean())
constant = tspslam.sample_signals(grey, cloud.uv, complex_)
for centering in ("none", "mean", "harmonic", "plane"):
    real = tspslam.tmahf(complex_, cloud.uv, signals, centering=centering)
    flat = tspslam.tmahf(complex_, cloud.uv, constant, centering=centering)
    ratio = np.median(flat.magnitude[real.defined]) / np.median(real.magnitude[real.defined])
    print(f"constant image, centering={centering}: {ratio:.2f} of the real image's median |r|")
