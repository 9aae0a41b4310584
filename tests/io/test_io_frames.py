import dataclasses
import io
import pickle
import time
import tracemalloc
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tspslam import Frame
from tspslam.errors import InputError, OutputError
from tspslam.io import read_frame, read_mesh, write_frame
from tspslam.topology.complex import build_complex
from tspslam.types import Cloud, Response, Rig, Signals, Surface

FUZZ = settings(max_examples=250, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
RIG = Rig(fx=500.5, fy=501, cx=320, cy=240, baseline=0.1, width=640, height=480, skew=0.2, doffs=-1.5)
FACES = np.array([[0, 2, 1], [0, 2, 3]], np.int32)


def frame(channels=(), covariance=True, n=5, faces=FACES, edges=((3, 4),)):
    """A frame with every field filled."""
    rng = np.random.default_rng(3)
    complex_ = build_complex(faces, n, edges=np.array(edges).reshape(-1, 2))
    n_edges, n_faces = len(complex_.edges), len(complex_.faces)
    spread = rng.normal(size=(n, 3, 3)) if covariance else None
    signals = Signals(
        vertex=rng.normal(size=(n, *channels)),
        edge=rng.normal(size=(n_edges, *channels)),
        face=rng.normal(size=(n_faces, *channels)),
        edge_uv=rng.normal(size=(n_edges, 2)),
        face_uv=rng.normal(size=(n_faces, 2)),
        edge_pixels=np.arange(n_edges, dtype=np.int32),
        face_pixels=np.arange(n_faces, dtype=np.int32),
        vertex_ok=rng.random(n) < 0.5,
        edge_ok=rng.random(n_edges) < 0.5,
        face_ok=rng.random(n_faces) < 0.5,
    )
    z = rng.normal(size=(n, *channels)) + 1j * rng.normal(size=(n, *channels))
    return Frame(
        index=12,
        stamp=0.1,
        name="Straße 12",
        rig=RIG,
        cloud=Cloud(rng.normal(size=(n, 3)), rng.normal(size=(n, 2)), rng.normal(size=n), spread),
        surface=Surface(np.asarray(faces, np.int32)),
        complex_=complex_,
        signals=signals,
        response=Response(z, 2, rng.random(n) < 0.5),
        T_world_camera=np.array([[0.0, 0, 1, 2], [1, 0, 0, -3], [0, 1, 0, 5.5], [0, 0, 0, 1]]),
        landmark=rng.integers(-1, 1 << 40, n) if covariance else None,
        is_keyframe=True,
        is_lost=covariance,
    )


def saved(tmp_path, data, name="frame.npz"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def stored(tmp_path, **arguments):
    write_frame(tmp_path / "stored.npz", frame(**arguments))
    return (tmp_path / "stored.npz").read_bytes()


def entries(data):
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(parts, method=zipfile.ZIP_DEFLATED):
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return buffer.getvalue()


def npy(values, **options):
    buffer = io.BytesIO()
    np.save(buffer, values, **options)
    return buffer.getvalue()


def leaves(value, name="frame"):
    """Every array and number of nested data classes."""
    if dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from leaves(getattr(value, field.name), f"{name}.{field.name}")
    else:
        yield name, value


def assert_equal(a, b):
    for (name, first), (_, second) in zip(leaves(a), leaves(b), strict=True):
        np.testing.assert_array_equal(first, second, err_msg=name)
        if isinstance(first, np.ndarray):
            assert first.dtype == second.dtype, name
        else:
            assert type(first) is type(second), name


@pytest.mark.parametrize("channels", [(), (1,), (3,)])
@pytest.mark.parametrize("covariance", [True, False])
def test_a_frame_reads_back_exactly(tmp_path, channels, covariance):
    original = frame(channels, covariance)
    write_frame(tmp_path / "a.npz", original)
    back = read_frame(tmp_path / "a.npz")
    assert back.cloud.covariance is None or covariance
    assert_equal(back, dataclasses.replace(original, rig=back.rig))
    assert back.rig == RIG


@pytest.mark.parametrize("n", [0, 4])
def test_a_frame_without_faces_reads_back(tmp_path, n):
    original = frame(n=n, faces=np.empty((0, 3), np.int32), edges=())
    write_frame(tmp_path / "a.npz", original)
    assert_equal(read_frame(tmp_path / "a.npz").signals, original.signals)


def test_equal_frames_give_equal_bytes_whenever_they_are_written(tmp_path, monkeypatch):
    first = stored(tmp_path)
    monkeypatch.setattr(time, "time", lambda: 2e9)
    original = frame()
    cloud = dataclasses.replace(original.cloud, xyz=np.asfortranarray(original.cloud.xyz))
    write_frame(tmp_path / "b.npz", dataclasses.replace(original, cloud=cloud))
    assert (tmp_path / "b.npz").read_bytes() == first


def test_numpy_reads_a_frame_without_pickles(tmp_path):
    with np.load(io.BytesIO(stored(tmp_path)), allow_pickle=False) as arrays:
        np.testing.assert_array_equal(arrays["cloud_xyz"], frame().cloud.xyz)


def test_a_point_without_projection_keeps_its_nan_pixels(tmp_path):
    original = frame()
    original.cloud.uv[2] = np.nan
    write_frame(tmp_path / "a.npz", original)
    np.testing.assert_array_equal(read_frame(tmp_path / "a.npz").cloud.uv, original.cloud.uv)


def test_read_mesh_takes_a_frame_s_cloud_and_surface(tmp_path):
    stored(tmp_path)
    xyz, faces = read_mesh(tmp_path / "stored.npz")
    np.testing.assert_array_equal(xyz, frame().cloud.xyz)
    np.testing.assert_array_equal(faces, FACES)


IMAGES = [
    np.arange(480 * 640).reshape(480, 640).astype(np.uint8),
    np.full((480, 640, 3), 60_000, np.uint16),
    np.random.default_rng(1).random((480, 640), np.float32),
]


@pytest.mark.parametrize("image", IMAGES, ids=lambda image: image.dtype.name)
def test_a_frame_keeps_its_image_as_it_is(tmp_path, image):
    write_frame(tmp_path / "a.npz", dataclasses.replace(frame(), image=image))
    back = read_frame(tmp_path / "a.npz").image
    assert back.dtype == image.dtype
    np.testing.assert_array_equal(back, image)
    assert (tmp_path / "a.npz").stat().st_size > image.nbytes  # not compressed: pictures hardly shrink


def test_an_image_of_float64_is_kept_as_float32(tmp_path):
    image = np.random.default_rng(1).random((480, 640))
    write_frame(tmp_path / "a.npz", dataclasses.replace(frame(), image=image))
    np.testing.assert_array_equal(read_frame(tmp_path / "a.npz").image, image.astype(np.float32))


def test_an_image_of_another_size_than_the_rig_s_is_left_out(tmp_path):
    write_frame(tmp_path / "a.npz", dataclasses.replace(frame(), image=np.zeros((9, 9))))
    assert read_frame(tmp_path / "a.npz").image is None


def changed(part, **fields):
    original = frame()
    return dataclasses.replace(original, **{part: dataclasses.replace(getattr(original, part), **fields)})


@pytest.mark.parametrize(
    ("bad", "said"),
    [
        (changed("cloud", xyz=np.zeros((4, 3))), "cloud_xyz has shape"),
        (changed("cloud", xyz=np.full((5, 3), np.nan)), "cloud_xyz holds a value that is not finite"),
        (changed("cloud", covariance=np.zeros((5, 3))), "cloud_covariance has shape"),
        (changed("signals", edge=np.zeros(5)), "signals_edge has shape"),
        (changed("signals", edge=np.zeros((6, 2))), "signals_edge has shape"),
        (changed("signals", vertex=np.full(5, np.inf)), "not finite"),
        (changed("signals", vertex_ok=np.zeros(5)), "signals_vertex_ok has dtype"),
        (changed("response", z=np.full(5, np.nan + 0j)), "response_z"),
        (changed("response", z=np.full(5, 1.7e308 * (1 + 1j))), "response_z holds a value"),
        (changed("cloud", xyz=np.full((5, 3), 1e300)), "cloud_xyz holds a value"),
        (changed("cloud", disparity=np.full(5, -np.inf)), "cloud_disparity holds a value"),
        (changed("response", order=1 << 70), "response_order"),
        (changed("response", order=-1), "order -1"),
        (changed("surface", faces=np.array([[0, 1, 5]])), "surface_faces holds 0 to 5"),
        (changed("surface", faces=np.array([[0, 1, 1 << 40]])), "does not fit"),
        (changed("surface", faces=np.array([["a", "b", "c"]])), "dtype"),
        (changed("complex_", face_edges=np.zeros((2, 3), np.int32)), "not the sides"),
        (changed("complex_", face_edges=np.full((2, 3), 6, np.int32)), "holds 6 to 6"),
        (changed("complex_", edges=frame().complex_.edges[:, ::-1]), "ascend"),
        (changed("complex_", edges=frame().complex_.edges[::-1]), "lexicographic"),
        (dataclasses.replace(frame(), stamp=np.nan), "stamp"),
        (dataclasses.replace(frame(), landmark=np.arange(4)), "landmark has shape"),
        (dataclasses.replace(frame(), landmark=np.arange(5) - 2), "landmark holds -2, where -1 is the least"),
        (dataclasses.replace(frame(), landmark=np.full(5, 1 << 63, np.uint64)), "landmark"),
        (dataclasses.replace(frame(), T_world_camera=2 * np.eye(4)), "T_world_camera holds no rigid motion"),
        (dataclasses.replace(frame(), T_world_camera=np.diag([1.0, 1, -1, 1])), "no rigid motion"),
        (dataclasses.replace(frame(), T_world_camera=np.diag([1.0, 1, 1, 2])), "no rigid motion"),
    ],
)
def test_an_inconsistent_frame_is_not_written(tmp_path, bad, said):
    with pytest.raises(InputError, match=said) as caught:
        write_frame(tmp_path / "a.npz", bad)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "a.npz").exists()


def test_a_place_below_a_file_is_an_output_error(tmp_path):
    saved(tmp_path, b"", "file")
    with pytest.raises(OutputError):
        write_frame(tmp_path / "file" / "a.npz", frame())


@pytest.mark.parametrize(
    ("part", "data", "said"),
    [
        ("version", npy(np.int64(2)), "format version 2 of a former tspslam, and the run is to be made anew"),
        ("version", npy(np.int64(4)), "format version 4 of a later tspslam.*; expected a frame of format version 3"),
        ("version", npy(np.array([1])), "format version"),
        ("magic", npy(np.zeros(13, np.uint8)), "mark of a frame"),
        ("magic", None, "no array magic"),
        ("cloud_uv", None, "no array cloud_uv"),
        ("T_world_camera", None, "no array T_world_camera"),
        ("is_keyframe", None, "no array is_keyframe"),
        ("landmark", npy(np.zeros(5)), "array landmark has type <f8"),
        ("image", npy(np.zeros((480, 640))), r"array image has type <f8, where \|u1 or <u2 or <f4 goes"),
        ("image", npy(np.zeros((640, 480), np.uint8)), r"image has shape \(640, 480\), where \(480, 640\)"),
        ("image", npy(np.zeros((480, 640, 4), np.uint8)), "image has shape"),
        ("image", npy(np.full((480, 640), np.nan, np.float32)), "image holds a value that is not finite"),
        ("surprise", npy(np.zeros(3)), "unknown array"),
        ("cloud_xyz", b"nothing", "no header of ours"),
        ("cloud_xyz", npy(np.array([None]), allow_pickle=True), "no header of ours"),
        ("cloud_xyz", npy(np.zeros((3, 5)).T), "no header of ours"),
        ("cloud_xyz", npy(np.zeros((5, 3), np.float32)), "has type <f4"),
        ("cloud_xyz", npy(np.zeros((5, 3)))[:-1], "claims 120 bytes and has 119"),
        ("cloud_xyz", npy(np.zeros((5, 3))).replace(b"(5, 3), ", b"(5, ,), "), "no header of ours"),
        ("cloud_xyz", npy(np.zeros((5, 3))).replace(b"(5, 3), }    ", b"(50000, 3), }"), "claims 1200000 bytes"),
        ("cloud_xyz", npy(np.zeros((5, 2))), "cloud_xyz has shape"),
        ("signals_edge_ok", npy(np.ones(6, bool))[:-1] + b"\7", "neither true nor false"),
        ("complex_n", npy(np.int64(-5)), "shape"),
        ("complex_n", npy(np.zeros(1, int)), "shape"),
        ("rig", npy(np.zeros(7)), "rig: fx"),
        ("name", npy(np.full(3, 255, np.uint8)), "utf-8"),
        ("response_order", npy(np.int64(-1)), "order -1"),
    ],
)
def test_each_fault_is_named_in_one_line(tmp_path, part, data, said):
    parts = entries(stored(tmp_path))
    parts.pop(f"{part}.npy", None)
    if data is not None:
        parts[f"{part}.npy"] = data
    with pytest.raises(InputError, match=said) as caught:
        read_frame(saved(tmp_path, zipped(parts)))
    assert "\n" not in str(caught.value)


def test_a_pickle_is_never_loaded(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    for data in (pickle.dumps(Trap()), npy(np.array([Trap()]), allow_pickle=True)):
        parts = entries(stored(tmp_path)) | {"cloud_xyz.npy": data}
        with pytest.raises(InputError):
            read_frame(saved(tmp_path, zipped(parts)))
        with pytest.raises(InputError):
            read_frame(saved(tmp_path, data))
    assert not (tmp_path / "sprung").exists()


def test_other_packings_and_repeated_arrays_are_refused(tmp_path):
    parts = entries(stored(tmp_path))
    with pytest.raises(InputError, match="not ours"):
        read_frame(saved(tmp_path, zipped(parts, zipfile.ZIP_LZMA)))
    doubled = io.BytesIO(zipped(parts))
    with zipfile.ZipFile(doubled, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("version.npy", parts["version.npy"])
    with pytest.raises(InputError, match="repeated"):
        read_frame(saved(tmp_path, doubled.getvalue()))


def test_stored_entries_are_read_too(tmp_path):
    assert_equal(
        read_frame(saved(tmp_path, zipped(entries(stored(tmp_path)), zipfile.ZIP_STORED))).cloud, frame().cloud
    )


def test_a_bomb_is_refused_before_it_takes_memory(tmp_path):
    data = bytearray(stored(tmp_path))
    at = data.rindex(b"PK\1\2", 0, data.rindex(b"cloud_xyz.npy"))
    data[at + 24 : at + 28] = (0xFFFFFFF0).to_bytes(4, "little")
    tracemalloc.start()
    with pytest.raises(InputError, match="claims"):
        read_frame(saved(tmp_path, bytes(data)))
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


def test_entries_that_claim_too_much_together_are_refused(tmp_path, monkeypatch):
    data = stored(tmp_path)
    monkeypatch.setattr("tspslam._npz.unpacked_limit", lambda _: 1000)
    with pytest.raises(InputError, match="may take 1000"):
        read_frame(saved(tmp_path, data))


def test_a_small_file_that_unpacks_to_very_much_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("tspslam._files._UNPACKED", 1 << 20)
    parts = entries(stored(tmp_path))
    parts["signals_vertex.npy"] = npy(np.zeros((5, 1 << 18)))
    with pytest.raises(InputError, match="may take"):
        read_frame(saved(tmp_path, zipped(parts)))


def test_every_truncation_is_seen(tmp_path):
    data = stored(tmp_path)
    for size in range(1, len(data), 37):
        with pytest.raises(InputError):
            read_frame(saved(tmp_path, data[:size]))


@FUZZ
@given(data=st.data())
def test_a_damaged_frame_is_a_frame_or_an_input_error(tmp_path, data):
    source = stored(tmp_path, covariance=False)
    if data.draw(st.booleans()):
        parts = entries(source)
        name = data.draw(st.sampled_from(sorted(parts)))
        part = bytearray(parts[name])
        for _ in range(data.draw(st.integers(1, 4))):
            part[data.draw(st.integers(0, len(part) - 1))] = data.draw(st.integers(0, 255))
        damaged = zipped(parts | {name: bytes(part)}, zipfile.ZIP_STORED)
    else:
        mutable = bytearray(source)
        for _ in range(data.draw(st.integers(1, 4))):
            mutable[data.draw(st.integers(0, len(mutable) - 1))] = data.draw(st.integers(0, 255))
        damaged = bytes(mutable)
    said = ""
    try:
        back = read_frame(saved(tmp_path, damaged))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    if not said:
        write_frame(tmp_path / "again.npz", back)
        assert_equal(read_frame(tmp_path / "again.npz").signals, back.signals)
