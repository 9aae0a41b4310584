"""What people use to recognise a place: binary words, tiny images, gradients, Gabor energies, histograms of shape.

And how all of it is measured. Each descriptor here is a plain reference, written for clarity.
"""

from __future__ import annotations

import cv2
import numpy as np

from tspslam import OrbDetector
from tspslam.vision.features.binary import binary_descriptors

SAMPLE, FARTHEST = 400, 64  # descriptors of a query, bits: the defaults of relocalisation (LoopSettings)


def votes(greys: list[np.ndarray], may_match: np.ndarray) -> np.ndarray:
    """Votes of ORB descriptors, as relocalisation counts them, over 400; (K, K), row q votes for columns.

    Each of a sample of an image's descriptors votes for the image with the nearest one, if that is within 64 bits, of
    those images that `may_match` (K, K) allows it. Votes are counted, not shares: an image of few corners gives few.
    """
    found = [binary_descriptors(OrbDetector()(grey).descriptor).view(np.uint8) for grey in greys]
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    counts = np.zeros((len(greys), len(greys)))
    for q, own in enumerate(found):
        sample = np.ascontiguousarray(own[:: max(1, len(own) // SAMPLE)])
        known = [k for k in np.flatnonzero(may_match[q]) if len(found[k])]
        if len(sample) == 0 or not known:
            continue
        bits = np.array([[one.distance for one in matcher.match(sample, found[k])] for k in known])
        best = bits.argmin(axis=0)[bits.min(axis=0) <= FARTHEST]
        counts[q, known] = np.bincount(best, minlength=len(known)) / SAMPLE
    return counts


def tiny_image(grey: np.ndarray) -> np.ndarray:
    """16 x 16 means, centred, of length 1."""
    return _unit(_centred(cv2.resize(grey.astype(np.float32), (16, 16), interpolation=cv2.INTER_AREA)))


def gradients(grey: np.ndarray) -> np.ndarray:
    """Histograms of oriented gradients of the image at 128 x 96."""
    from skimage.feature import hog

    small = cv2.resize(grey.astype(np.float32) / 255, (128, 96), interpolation=cv2.INTER_AREA)
    found = hog(small, orientations=9, pixels_per_cell=(16, 16), cells_per_block=(2, 2), feature_vector=True)
    return _unit(_centred(found))


def gabor_energies(grey: np.ndarray) -> np.ndarray:
    """Energies of Gabor filters, 4 scales by 8 directions, in 4 x 4 cells of the image at 128 x 128: like gist."""
    small = cv2.resize(grey.astype(np.float32) / 255, (128, 128), interpolation=cv2.INTER_AREA)
    local = small - cv2.GaussianBlur(small, (0, 0), 8)
    local /= 0.02 + np.sqrt(cv2.GaussianBlur(local * local, (0, 0), 8))
    spectrum = np.fft.fft2(local)
    fx, fy = np.meshgrid(np.fft.fftfreq(128), np.fft.fftfreq(128))
    found = []
    for scale in range(4):
        radius = 0.25 / 2**scale
        for turn in np.pi * np.arange(8) / 8:
            along, across = fx * np.cos(turn) + fy * np.sin(turn), fy * np.cos(turn) - fx * np.sin(turn)
            gain = np.exp(-(((along - radius) / (0.4 * radius)) ** 2 + (across / (0.3 * radius)) ** 2) / 2)
            energy = np.abs(np.fft.ifft2(spectrum * gain))
            found.append(energy.reshape(4, 32, 4, 32).mean(axis=(1, 3)))
    return _unit(_centred(np.array(found)))


def shape_histogram(xyz: np.ndarray, faces: np.ndarray, bins: int = 11) -> np.ndarray:
    """Three angles between neighbours' normals, 11 bins each, after FPFH (Rusu 2009); over the complex's edges."""
    corners = xyz[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal *= np.where((normal * corners.mean(axis=1)).sum(axis=1) > 0, -1, 1)[:, None]
    at = np.zeros_like(xyz)
    np.add.at(at, faces.ravel(), np.repeat(normal, 3, axis=0))
    at /= np.linalg.norm(at, axis=1, keepdims=True) + 1e-12
    sides = np.unique(np.sort(faces[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2), axis=1), axis=0)
    i, j = np.concatenate([sides, sides[:, ::-1]]).T
    d = xyz[j] - xyz[i]
    d /= np.linalg.norm(d, axis=1, keepdims=True) + 1e-12
    u, v = at[i], np.cross(d, at[i])
    v /= np.linalg.norm(v, axis=1, keepdims=True) + 1e-12
    w = np.cross(u, v)
    angles = (
        (v * at[j]).sum(axis=1), (u * d).sum(axis=1),
        np.arctan2((w * at[j]).sum(axis=1), (u * at[j]).sum(axis=1)) / np.pi,
    )  # fmt: skip
    whole = [np.histogram(angle, bins, (-1, 1))[0] / max(1, len(i)) for angle in angles]
    return _unit(np.sqrt(np.concatenate(whole)))


def recall_at_full_precision(similarity: np.ndarray, same: np.ndarray, other: np.ndarray) -> float:
    """Share of the true pairs that score above every wrong one. Pairs neither same nor other do not count."""
    return float((similarity[same] > similarity[other].max(initial=-np.inf)).mean())


def recalled_keyframes(similarity: np.ndarray, same: np.ndarray, other: np.ndarray) -> float:
    """Share of the rows with a true pair whose best candidate is right and scores above every wrong best one."""
    counts = same | other
    best = np.where(counts, similarity, -np.inf).argmax(axis=1)
    rows = np.arange(len(best))
    right = same[rows, best]
    score = similarity[rows, best]
    wrong = score[counts.any(axis=1) & ~right].max(initial=-np.inf)
    return float((right & (score > wrong))[same.any(axis=1)].mean())


def average_precision(similarity: np.ndarray, same: np.ndarray, other: np.ndarray) -> float:
    """Mean over the true pairs of the precision at their score; ties count against."""
    counts = same | other
    score, truth = similarity[counts], same[counts]
    order = np.lexsort((truth, -score))
    hits = truth[order]
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    return float(precision[hits].mean())


def _centred(values: np.ndarray) -> np.ndarray:
    flat = np.asarray(values, np.float64).ravel()
    return flat - flat.mean()


def _unit(values: np.ndarray) -> np.ndarray:
    return values / (np.linalg.norm(values) + 1e-12)
