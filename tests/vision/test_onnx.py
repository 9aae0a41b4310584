from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tspslam.datasets import motorcycle_truth
from tspslam.errors import InputError
from tspslam.types import StereoPair
from tspslam.vision.features import grey_levels
from tspslam.vision.onnx import OnnxDetector
from tspslam.vision.reconstruct import reconstruct


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


def network(path: Path, outputs: dict[str, tuple[np.ndarray, int]], shape: tuple[int, int] = (504, 744)) -> Path:
    """Write an ONNX file that convolves an image with each output's weights."""
    graph = field(2, "net") + field(11, value_info("image", (1, 1, *shape)))
    for name, (weights, stride) in outputs.items():
        node, tensor = convolution(name, weights, stride)
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
