"""One call: a real stereo pair in, the harmonic response at every point out, and the pictures of it.

python examples/01_one_call.py [FOLDER]
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

from tspslam import Session, datasets
from tspslam.view import write_pictures

pair = datasets.motorcycle()
frame = Session(pair.rig).process(pair)

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp(prefix="tspslam-"))
pictures = write_pictures(frame, folder)

column, row = np.floor(frame.cloud.uv + 0.5).astype(int).T
error = np.abs(frame.cloud.disparity - datasets.motorcycle_truth()[row, column])
error = error[np.isfinite(error)]  # the truth has holes
defined = frame.response.defined

print(f"points: {len(frame.cloud)}")
print(f"disparity error: {np.median(error):.2f} px in the median, {np.mean(error < 1):.0%} below 1 px")
print(f"complex: {len(frame.complex_.edges)} edges, {len(frame.complex_.faces)} faces")
print(f"response: defined at {defined.sum()} vertices, median |r| {np.median(frame.response.magnitude[defined]):.2f}")
print(f"time: {1000 * sum(frame.seconds.values()):.0f} ms, pictures apart (kernels compile on the first run)")
print(f"pictures: {len(pictures)} in {folder}")
