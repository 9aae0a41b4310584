"""A network tried out in a process of its own, since a hostile or damaged file can end the process that runs it."""

from __future__ import annotations

import functools
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._files import one_line

_LONGEST = 120.0  # s: a detector takes seconds on the slowest machine, loading included
_MAX_MEMORY = 8 << 30  # bytes
_DEEPEST = 100  # messages in each other; no protocol buffer goes deeper
# Where tensors are, by the kind of message and the number of its field; from ONNX's onnx.proto.
_PARTS: dict[str, dict[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14  # fields of a tensor


def load_network(model: bytes) -> Any:
    """OpenCV's network of an ONNX file's content; `cv2.error` if it cannot read it."""
    import cv2

    return cv2.dnn.readNetFromONNX(np.frombuffer(model, np.uint8))


def run_network(net: Any, grey: NDArray[np.uint8]) -> list[NDArray[Any]]:
    """All outputs of a network for a grey image (H, W); `cv2.error` if it cannot be run."""
    net.setInput(grey[None, None].astype(np.float32) / np.float32(255))
    return [np.array(each) for each in net.forward(net.getUnconnectedOutLayersNames())]


def trouble_of(model: bytes, shape: tuple[int, ...]) -> str:
    """Load a network in a process of its own and run it on an image of that shape: what is wrong with it, or nothing.

    Parameters
    ----------
    model : bytes
        Content of the ONNX file.
    shape : (H, W)
        Of the image, px.

    Returns
    -------
    str
        Empty, if it ran to its end.
    """
    if not sys.executable or getattr(sys, "frozen", False):
        return "cannot be tried out (no Python interpreter to do it in)"
    places = [str(Path(__file__).parents[3]), *filter(None, sys.path)]
    code = f"import sys; sys.path[:] = {places!r}; from {__name__} import main; main()"
    command = [sys.executable, "-P", "-c", code, *map(str, shape)]
    try:
        done = subprocess.run(command, input=model, capture_output=True, timeout=_LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return f"does not come to an end within {_LONGEST:g} s"
    except OSError as error:
        return f"cannot be tried out ({error.strerror})"
    return _verdict(done)


def _verdict(done: subprocess.CompletedProcess[bytes]) -> str:
    if done.returncode < 0:
        numbers = {each.value: each.name for each in signal.Signals}
        return f"crashes OpenCV ({numbers.get(-done.returncode, -done.returncode)})"
    try:
        return one_line(json.loads(done.stdout.splitlines()[-1])["trouble"])
    except (ValueError, LookupError, TypeError):
        said = one_line(done.stderr.decode("utf-8", "replace"))[-120:]
        return f"crashes OpenCV (exit code {done.returncode}{': ' * bool(said)}{said})"


def main() -> None:
    """Try out the network on stdin with an image of the shape in the arguments, and say on stdout what came of it."""
    _bound()
    model = sys.stdin.buffer.read()
    print("\n" + json.dumps({"trouble": _trouble(model, (int(sys.argv[1]), int(sys.argv[2])))}))


def _bound() -> None:
    """Take only so much memory; crash without a core file or a window."""
    if sys.platform == "win32":
        import ctypes

        ctypes.windll.kernel32.SetErrorMode(3)  # neither critical-error-handler nor fault-report boxes
        return
    import resource

    for kind, most in ((resource.RLIMIT_CORE, 0), (resource.RLIMIT_DATA, _MAX_MEMORY)):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


def _trouble(model: bytes, shape: tuple[int, int]) -> str:
    import cv2

    try:
        if keeps_data_outside(model):
            return "keeps weights in other files"
        net = load_network(model)
    except (cv2.error, ValueError, MemoryError) as error:
        return f"is no ONNX network that OpenCV reads ({one_line(str(error))[-120:]})"
    image = (np.arange(shape[0] * shape[1]) % 251).astype(np.uint8).reshape(shape)
    try:
        run_network(net, image)
    except (cv2.error, ValueError, MemoryError) as error:
        return f"cannot be run ({one_line(str(error))[-120:]})"
    return ""


def keeps_data_outside(model: bytes) -> bool:
    """Whether a tensor of an ONNX file names another file for its numbers; ValueError if its fields cannot be read.

    Examples
    --------
    >>> tensor = bytes([14 << 3, 1])  # data_location: EXTERNAL
    >>> keeps_data_outside(bytes([7 << 3 | 2, 4, 5 << 3 | 2, 2]) + tensor)  # a model's graph's initializer
    True
    """
    return _is_outside(memoryview(model), "model", 0)


def _is_outside(message: memoryview, kind: str, depth: int) -> bool:
    if depth > _DEEPEST:
        raise ValueError("messages in each other without end")
    for number, value in _fields(message):
        if kind == "tensor" and (number == _EXTERNAL_DATA or (number == _DATA_LOCATION and value != 0)):
            return True
        part = _PARTS[kind].get(number)
        if part and isinstance(value, memoryview) and _is_outside(value, part, depth + 1):
            return True
    return False


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Number and value of each field of a protocol buffer."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        form = tag & 7
        if form == 0:
            value, at = _varint(message, at)
            yield tag >> 3, value
            continue
        size = {1: 8, 5: 4}.get(form)
        if form == 2:
            size, at = _varint(message, at)
        if size is None or size > len(message) - at:
            raise ValueError("damaged fields")
        yield tag >> 3, message[at : at + size]
        at += size


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of seven bits a byte, and where it ends."""
    part = bytes(message[at : at + 10])
    count = next((number for number, byte in enumerate(part, start=1) if byte < 128), None)
    if count is None:
        raise ValueError("damaged fields")
    return functools.reduce(lambda total, byte: total << 7 | byte & 127, reversed(part[:count]), 0), at + count
