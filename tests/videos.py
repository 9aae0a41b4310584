"""Videos that the tests write, and what is done to their bytes."""

import struct

import cv2
import numpy as np

LOSSLESS = "FFV1"


def moving_frames(count, width=64, height=48, seed=0, *, colour=True):
    """Frames of a texture that moves by a pixel each, (height, width, 3) or (height, width) uint8."""
    rng = np.random.default_rng(seed)
    wide = rng.integers(0, 256, (height, width + count, 3), np.uint8)
    wide = cv2.GaussianBlur(wide, (0, 0), 1.5)
    frames = [np.ascontiguousarray(wide[:, k : k + width]) for k in range(count)]
    return frames if colour else [np.ascontiguousarray(frame[..., 0]) for frame in frames]


def write_video(path, frames, codec=LOSSLESS, fps=20.0):
    """Write RGB or grey frames; returns the path."""
    colour = frames[0].ndim == 3
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(
        str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*codec), fps, (width, height), isColor=colour
    )
    assert writer.isOpened()
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR) if colour else frame)
    writer.release()
    return path


def write_jpegs(path, frames):
    """Write frames as a stream of JPEG images; returns the path."""
    path.write_bytes(b"".join(cv2.imencode(".jpg", frame)[1].tobytes() for frame in frames))
    return path


def turn(path, degrees):
    """Have an MP4 say that its frames are to be turned, as a phone does."""
    one = 1 << 16
    matrix = {90: (0, one, 0, -one, 0), 180: (-one, 0, 0, 0, -one), 270: (0, -one, 0, one, 0)}[degrees]
    data = bytearray(path.read_bytes())
    place = data.index(b"tkhd") + 44
    data[place : place + 20] = struct.pack(">5i", *matrix)
    path.write_bytes(data)


def retime(path, shown):
    """Give the frames of an MP4, whose index comes last, durations in units of its own clock."""
    data = bytearray(path.read_bytes())
    table = struct.pack(">I4sII", 16 + 8 * len(shown), b"stts", 0, len(shown))
    table += b"".join(struct.pack(">II", 1, each) for each in shown)
    place = data.index(b"stts") - 4
    (before,) = struct.unpack_from(">I", data, place)
    data[place : place + before] = table
    for box in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        at = data.index(box) - 4
        struct.pack_into(">I", data, at, struct.unpack_from(">I", data, at)[0] + len(table) - before)
    path.write_bytes(data)
