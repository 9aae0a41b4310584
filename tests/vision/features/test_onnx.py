from __future__ import annotations

import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tspslam.datasets import motorcycle_truth
from tspslam.errors import InputError
from tspslam.types import StereoPair
from tspslam.vision.features import _onnx_probe
from tspslam.vision.features.onnx import OnnxDetector
from tspslam.vision.images import grey_levels
from tspslam.vision.stereo.reconstruct import reconstruct


def field(number: int, value: int | bytes | str) -> bytes:
    """One field of a protocol buffer: a varint, or a length and bytes."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def varint(value: int) -> bytes:
    head, rest = value & 127, value >> 7
    return bytes([head | 128]) + varint(rest) if rest else bytes([head])


def value_info(name: str, shape: tuple[int, ...]) -> bytes:
    dims = b"".join(field(1, field(1, size)) for size in shape)
    return field(1, name) + field(2, field(1, field(1, 1) + field(2, dims)))


def convolution(name: str, weights: np.ndarray, stride: int) -> tuple[bytes, bytes]:
    """A node that convolves the image with same padding, and its weights."""
    pad = weights.shape[2] // 2
    attributes = {"pads": [pad] * 4, "strides": [stride] * 2, "kernel_shape": list(weights.shape[2:])}
    packed = [
        field(5, field(1, key) + b"".join(field(8, v) for v in values) + field(20, 7))
        for key, values in attributes.items()
    ]
    node = field(1, "image") + field(1, f"{name}_w") + field(2, name) + field(3, name) + field(4, "Conv")
    tensor = b"".join(field(1, size) for size in weights.shape) + field(2, 1) + field(8, f"{name}_w")
    return node + b"".join(packed), tensor + field(9, weights.astype("<f4").tobytes())


def network(
    path: Path,
    outputs: dict[str, tuple[np.ndarray, int]],
    shape: tuple[int, int] = (504, 744),
    spoil: Callable[[bytes, bytes], tuple[bytes, bytes]] = lambda node, tensor: (node, tensor),
) -> Path:
    """Write an ONNX file that convolves an image with each output's weights."""
    graph = field(2, "net") + field(11, value_info("image", (1, 1, *shape)))
    for name, (weights, stride) in outputs.items():
        node, tensor = spoil(*convolution(name, weights, stride))
        size = (1, len(weights), shape[0] // stride, shape[1] // stride)
        graph += field(1, node) + field(5, tensor) + field(12, value_info(name, size))
    path.write_bytes(field(1, 7) + field(7, graph) + field(8, field(1, "") + field(2, 13)))
    return path


def blob() -> np.ndarray:
    """Difference of two Gaussians: a weight that peaks at small bright spots."""
    v, u = np.mgrid[-4:5, -4:5]
    rr = u**2 + v**2
    narrow, broad = np.exp(-rr / 2), np.exp(-rr / 8)
    return (narrow / narrow.sum() - broad / broad.sum())[None, None]


def patterns(count: int = 24) -> np.ndarray:
    weights = np.random.default_rng(0).normal(size=(count, 1, 9, 9))
    return weights - weights.mean(axis=(2, 3), keepdims=True)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return network(tmp_path / "net.onnx", {"scores": (blob(), 1), "descriptors": (patterns(), 4)})


def test_a_network_is_a_detector_like_any_other(path: Path, pair: StereoPair) -> None:
    detector = OnnxDetector(str(path), threshold=0.01, radius=2)
    features = detector(grey_levels(pair.left))
    assert 1000 < len(features.uv) <= 2000
    assert features.descriptor.shape[1] == 24
    np.testing.assert_allclose(np.linalg.norm(features.descriptor, axis=1), 1, rtol=1e-5)
    cloud = reconstruct(pair, detector=detector)
    pixel = np.rint(cloud.uv).astype(int)
    error = np.abs(cloud.disparity - motorcycle_truth()[pixel[:, 1], pixel[:, 0]])
    assert len(cloud) > 700
    assert (error[np.isfinite(error)] < 1).mean() > 0.93


def test_keypoints_are_the_peaks_of_the_scores(path: Path) -> None:
    image = np.zeros((504, 744), np.uint8)
    spots = np.array([[100, 50], [300, 200], [700, 480]])
    image[spots[:, 1], spots[:, 0]] = 255
    features = OnnxDetector(str(path), threshold=0.05)(image)
    assert sorted(features.uv.tolist()) == sorted(spots.tolist())
    flat = OnnxDetector(str(path))(np.full((504, 744), 90, np.uint8)).uv
    assert ((flat < 5) | (flat > (738, 498))).any(axis=1).all()  # only where the network's own padding shows


@pytest.mark.parametrize(("outputs", "message"), [
    ({"scores": (blob(), 1)}, r"gives \[\(1, 1, 504, 744\)\] for an image"),
    ({"a": (patterns(), 4), "b": (patterns(), 4)}, "expected an ONNX network from an image"),
    ({"scores": (blob() * np.float64(1e38), 1), "d": (patterns() * np.inf, 4)}, "not finite"),
])  # fmt: skip
def test_other_networks_are_named(tmp_path: Path, outputs: dict[str, tuple[np.ndarray, int]], message: str) -> None:
    with np.errstate(all="ignore"):
        made = network(tmp_path / "net.onnx", outputs)
    with pytest.raises(InputError, match=message):
        OnnxDetector(str(made))(np.full((500, 741), 128, np.uint8))


def test_files_that_are_no_network_are_named(tmp_path: Path) -> None:
    grey = np.zeros((64, 64), np.uint8)
    with pytest.raises(InputError, match="cannot be opened"):
        OnnxDetector(str(tmp_path / "none.onnx"))(grey)
    with pytest.raises(InputError, match=r"is a directory|cannot be opened"):
        OnnxDetector("")(grey)
    (tmp_path / "bad.onnx").write_bytes(b"no network at all")
    with pytest.raises(InputError, match=r"bad\.onnx: is no ONNX network that OpenCV reads"):
        OnnxDetector(str(tmp_path / "bad.onnx"))(grey)
    with pytest.raises(InputError, match="onnx: radius is 0"):
        OnnxDetector("x", radius=0)


def test_another_network_in_the_same_file_is_another_input(tmp_path: Path, path: Path) -> None:
    first = OnnxDetector(str(path)).fingerprint
    network(path, {"scores": (2 * blob(), 1), "descriptors": (patterns(), 4)})
    assert OnnxDetector(str(path)).fingerprint != first


SMALL = {"scores": (blob(), 1), "descriptors": (patterns(2), 4)}
GREY = np.zeros((64, 64), np.uint8)
GROUP_OF_NONE = field(5, field(1, "group") + field(3, 0) + field(20, 2))
INSIDE, OUTSIDE = field(14, 0), field(14, 1) + field(13, field(1, "location") + field(2, "../weights"))


def head(tensor: bytes) -> bytes:
    """A tensor without its numbers."""
    return tensor[: tensor.rindex(b"_w") + 2]


HOSTILE: dict[str, Callable[[bytes, bytes], tuple[bytes, bytes]]] = {
    "empty raw data": lambda node, tensor: (node, head(tensor) + field(9, b"")),
    "no data": lambda node, tensor: (node, head(tensor)),
    "group 0": lambda node, tensor: (node + GROUP_OF_NONE, tensor),
    "no size": lambda node, tensor: (node, 4 * field(1, 0) + field(2, 1) + tensor[tensor.index(field(8, "")[:1]) :]),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_network_that_crashes_opencv_costs_one_line(tmp_path: Path, kind: str) -> None:
    path = network(tmp_path / "bad.onnx", SMALL, (64, 64), HOSTILE[kind])
    said = ""
    try:
        OnnxDetector(str(path))(GREY)
    except InputError as error:
        said = str(error)
    if said or platform.machine() in ("x86_64", "AMD64"):  # where a division by zero ends the process
        assert said.startswith(f"{path}: ")
        assert said.isprintable()


def test_a_network_that_was_refused_is_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = network(tmp_path / "bad.onnx", SMALL, (64, 64), lambda node, tensor: (node, tensor + OUTSIDE))
    detector = OnnxDetector(str(path))
    started = []
    monkeypatch.setattr(subprocess, "run", counted(subprocess.run, started))
    for _ in range(3):
        with pytest.raises(InputError, match=r"bad\.onnx: keeps weights in other files"):
            detector(GREY)
    assert len(started) == 1


def test_a_sound_network_is_tried_once_for_each_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    detector = OnnxDetector(str(network(tmp_path / "net.onnx", SMALL, (64, 64))))
    started = []
    monkeypatch.setattr(subprocess, "run", counted(subprocess.run, started))
    for _ in range(3):
        assert len(detector(GREY).uv) == 0
    assert len(started) == 1


def counted(function: Callable[..., object], calls: list[object]) -> Callable[..., object]:
    """The function, noting each call."""

    def call(*given: object, **named: object) -> object:
        calls.append(given)
        return function(*given, **named)

    return call


@pytest.mark.skipif(sys.platform == "win32", reason="a script stands in for the interpreter")
@pytest.mark.parametrize(("script", "said"), [
    ("kill -SEGV $$", r"crashes OpenCV \(SIGSEGV\)"), ("echo oh $'\\e[2J' >&2; exit 7", r"exit code 7: oh \S* ?\[2J\)"),
    ("sleep 60", "does not come to an end within 0.5 s"),
])  # fmt: skip
def test_whatever_ends_the_trial_is_said(
    tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch, script: str, said: str
) -> None:
    stand_in = tmp_path / "python"
    stand_in.write_text(f"#!/bin/bash\n{script}\n")
    stand_in.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(stand_in))
    monkeypatch.setattr(_onnx_probe, "_LONGEST", 0.5 if "sleep" in script else 60.0)
    with pytest.raises(InputError, match=said) as caught:
        OnnxDetector(str(path))(GREY)
    assert str(caught.value).isprintable()


def in_graph(tensor: bytes) -> bytes:
    return field(7, field(5, tensor))


@pytest.mark.parametrize("place", [
    in_graph,
    lambda tensor: field(7, field(1, field(5, field(5, tensor)))),  # a constant
    lambda tensor: field(7, field(1, field(5, field(10, tensor)))),
    lambda tensor: field(7, field(1, field(5, field(6, field(5, tensor))))),  # of a branch
    lambda tensor: field(7, field(1, field(5, field(11, field(1, field(5, field(5, tensor))))))),
    lambda tensor: field(7, field(15, field(1, tensor))),
    lambda tensor: field(7, field(1, field(5, field(22, field(2, tensor))))),
    lambda tensor: field(25, field(7, field(5, field(5, tensor)))),
    lambda tensor: field(20, field(1, field(5, tensor))),
    lambda tensor: in_graph(b"") + in_graph(tensor),
])  # fmt: skip
def test_weights_in_other_files_are_found_wherever_a_tensor_is(place: Callable[[bytes], bytes]) -> None:
    model = field(1, 7) + place(field(1, 3) + field(2, 1) + field(4, bytes(12)) + field(8, "w") + OUTSIDE)
    assert _onnx_probe.keeps_data_outside(model)
    assert not _onnx_probe.keeps_data_outside(model.replace(OUTSIDE, INSIDE + field(9, b"x" * (len(OUTSIDE) - 4))))
    assert _onnx_probe.keeps_data_outside(place(varint(14 << 3) + b"\x81\x80\x00"))  # 1 in more bytes than it needs


@pytest.mark.parametrize(
    "damaged", [b"\xff" * 20, field(7, b"abc")[:-1], b"\x3b", varint(7 << 3 | 2) + varint(1 << 60)]
)
def test_fields_that_cannot_be_read_are_no_network(damaged: bytes) -> None:
    with pytest.raises(ValueError, match="damaged fields"):
        _onnx_probe.keeps_data_outside(damaged)


def test_messages_in_each_other_have_an_end() -> None:
    model = b""
    for _ in range(200):
        model = field(1, field(5, field(6, model)))
    with pytest.raises(ValueError, match="without end"):
        _onnx_probe.keeps_data_outside(field(7, model))
