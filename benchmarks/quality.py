"""How right the results are: the cloud against true depth, the filter on constants and ramps."""

from __future__ import annotations

import numpy as np

import tspslam

from .measure import median_seconds

Figures = dict[str, float]


def motorcycle_cloud() -> Figures:
    """Points of the Motorcycle pair, scored by true disparity at the nearest pixel, where it is known."""
    cloud = tspslam.reconstruct(tspslam.datasets.motorcycle())
    truth = tspslam.datasets.motorcycle_truth()
    u, v = np.round(cloud.uv).astype(int).T
    error = np.abs(cloud.disparity - truth[v, u])
    error = error[np.isfinite(error)]
    return {
        "points": len(cloud),
        "scored": len(error),
        "share_within_1px": float((error <= 1).mean()),
        "median_error_px": float(np.median(error)),
    }


def filter_errors() -> Figures:
    """On the Motorcycle complex: the response of a constant, and phase errors on a luminance ramp, degrees."""
    pair = tspslam.datasets.motorcycle()
    cloud = tspslam.reconstruct(pair)
    complex_ = tspslam.build_complex(tspslam.delaunay_surface(cloud).faces, len(cloud))
    v, u = np.mgrid[: pair.rig.height, : pair.rig.width]
    figures: Figures = {}
    for centering in ("none", "mean", "harmonic", "plane"):
        constant = tspslam.sample_signals(np.full(u.shape, 0.5), cloud.uv, complex_)
        flat = tspslam.tmahf(complex_, cloud.uv, constant, centering=centering)  # type: ignore[arg-type]
        errors = [
            _phase_errors(complex_, cloud.uv, _ramp(u, v, a), a, centering) for a in np.arange(8) * np.pi / 4 + 0.1
        ]
        figures[f"constant_{centering}"] = float(flat.magnitude.max())
        figures[f"ramp_deg_{centering}"] = float(np.degrees(np.median(np.concatenate(errors))))
    return figures


def _ramp(u, v, angle):
    return 0.5 + (np.cos(angle) * (u - u.mean()) + np.sin(angle) * (v - v.mean())) / 1000


def _phase_errors(complex_, uv, image, angle, centering):
    response = tspslam.tmahf(complex_, uv, tspslam.sample_signals(image, uv, complex_), centering=centering)
    return np.abs(np.angle(response.z[response.defined] * np.exp(-1j * angle)))


def whole_pair() -> Figures:
    """Images to response of the Motorcycle pair, warm, ms; pictures not counted. Reference: ORB alone on one image."""
    import cv2

    pair = tspslam.datasets.motorcycle()
    session = tspslam.Session(pair.rig)
    grey = cv2.cvtColor(pair.left, cv2.COLOR_RGB2GRAY)
    orb = cv2.ORB_create(2000)
    return {
        "ms": median_seconds(lambda: session.process(pair)) * 1e3,
        "orb_one_image_ms": median_seconds(lambda: orb.detectAndCompute(grey, None)) * 1e3,
    }
