import io
import os
import struct
import threading
import warnings
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image

from tspslam.errors import InputError, OutputError
from tspslam.io import image_size, read_image, write_png

FUZZ = settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
RAMP = (np.arange(30 * 40) * 53 % 65_521).reshape(30, 40)


def encoded(mode, format_, **options):
    """An image file of a mode, with structure in it."""
    if (mode, format_) == ("I;16", "PPM"):  # Pillow writes it from 11 on
        return b"P5 40 30 65535\n" + RAMP.astype(">u2").tobytes()
    grey = Image.fromarray((RAMP % 256).astype(np.uint8))
    if mode.startswith("I"):
        image = Image.fromarray(RAMP.astype(np.uint16 if mode == "I;16" else np.int32))
    elif mode == "F":
        image = Image.fromarray(RAMP.astype(np.float32))
    else:
        image = grey.convert(mode)
    buffer = io.BytesIO()
    image.save(buffer, format=format_, **options)
    return buffer.getvalue()


def png(width, height, *chunks):
    """A PNG of a claimed size."""
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, body in [(b"IHDR", head), *chunks]:
        parts.append(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)))
    return b"".join(parts)


def saved(tmp_path, data, name="image"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_png_comes_back_exactly(tmp_path, dtype):
    array = RAMP.astype(dtype)
    write_png(tmp_path / "a.png", array)
    back = read_image(tmp_path / "a.png")
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, array)


def test_colour_png_comes_back_exactly_and_its_bytes_are_the_same_each_time(tmp_path):
    array = np.random.default_rng(0).integers(0, 256, (7, 5, 3), np.uint8)
    write_png(tmp_path / "a.png", array)
    write_png(tmp_path / "b.png", np.asfortranarray(array))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), array)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((2, 2)),
        np.zeros((2, 2, 3), np.uint16),
        np.zeros((2, 2, 4), np.uint8),
        np.zeros((0, 2), np.uint8),
        np.zeros(3, np.uint8),
        np.zeros((2, 2), bool),
    ],
)
def test_png_refuses_what_it_cannot_hold(tmp_path, array):
    with pytest.raises(InputError, match="cannot hold"):
        write_png(tmp_path / "a.png", array)
    assert not (tmp_path / "a.png").exists()


def test_png_below_a_file_is_an_output_error(tmp_path):
    saved(tmp_path, b"", "file")
    with pytest.raises(OutputError):
        write_png(tmp_path / "file" / "a.png", np.zeros((2, 2), np.uint8))


@pytest.mark.parametrize(
    ("mode", "format_", "ndim", "dtype"),
    [
        ("L", "PNG", 2, np.uint8),
        ("L", "JPEG", 2, np.uint8),
        ("L", "TIFF", 2, np.uint8),
        ("L", "PPM", 2, np.uint8),
        ("L", "BMP", 2, np.uint8),
        ("1", "PNG", 2, np.uint8),
        ("1", "PPM", 2, np.uint8),
        ("LA", "PNG", 2, np.uint8),
        ("P", "PNG", 3, np.uint8),
        ("P", "BMP", 2, np.uint8),
        ("PA", "TIFF", 3, np.uint8),
        ("RGB", "PNG", 3, np.uint8),
        ("RGB", "JPEG", 3, np.uint8),
        ("RGB", "TIFF", 3, np.uint8),
        ("RGB", "PPM", 3, np.uint8),
        ("RGB", "BMP", 3, np.uint8),
        ("RGBA", "PNG", 3, np.uint8),
        ("RGBA", "TIFF", 3, np.uint8),
        ("RGBA", "BMP", 3, np.uint8),
        ("CMYK", "JPEG", 3, np.uint8),
        ("CMYK", "TIFF", 3, np.uint8),
        ("YCbCr", "TIFF", 3, np.uint8),
        ("I;16", "PNG", 2, np.uint16),
        ("I;16", "TIFF", 2, np.uint16),
        ("I;16", "PPM", 2, np.uint16),
        ("I", "TIFF", 2, np.uint16),
    ],
)
def test_every_usual_kind_of_image_is_grey_or_rgb(tmp_path, mode, format_, ndim, dtype):
    data = encoded(mode, format_)
    if mode == "YCbCr":
        try:
            Image.open(io.BytesIO(data)).load()
        except OSError:
            pytest.skip("this Pillow cannot read what it wrote")
    back = read_image(saved(tmp_path, data))
    assert back.dtype == dtype
    assert back.shape == ((30, 40) if ndim == 2 else (30, 40, 3))
    assert back.flags.c_contiguous
    assert back.flags.writeable
    if dtype == np.uint16:
        np.testing.assert_array_equal(back, RAMP)
    elif format_ != "JPEG" and mode not in ("1", "YCbCr"):
        np.testing.assert_allclose(back if ndim == 2 else back[..., 0], RAMP % 256, atol=1)


def test_one_bit_becomes_black_and_white(tmp_path):
    assert set(np.unique(read_image(saved(tmp_path, encoded("1", "PNG"))))) == {0, 255}


def test_alpha_is_dropped_and_not_blended(tmp_path):
    array = np.zeros((2, 2, 4), np.uint8)
    array[..., 0] = 200
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, format="PNG")
    assert read_image(saved(tmp_path, buffer.getvalue()))[0, 0].tolist() == [200, 0, 0]


def test_palette_with_transparency_is_read_without_a_warning(tmp_path):
    back = read_image(saved(tmp_path, encoded("P", "PNG", transparency=bytes(range(256)))))
    assert back.shape == (30, 40, 3)


@pytest.mark.parametrize("mode", ["La", "RGBa"])
def test_premultiplied_alpha_is_undone(mode):
    from tspslam.io.images import _pixels

    back = _pixels(Image.new(mode[:-1] + "A", (2, 2), (100, 128) if mode == "La" else (100, 0, 0, 128)).convert(mode))
    np.testing.assert_allclose(back[0, 0] if mode == "La" else back[0, 0, 0], 100, atol=1)


@pytest.mark.parametrize("format_", ["JPEG", "PNG", "WEBP", "TIFF"])
@pytest.mark.parametrize("flag", range(10))
def test_an_image_that_viewers_turn_is_refused(tmp_path, format_, flag):
    """Calibrations are made by programs that turn it, and by others that don't."""
    exif = Image.Exif()
    exif[0x0112] = flag
    path = saved(tmp_path, encoded("L", format_, exif=exif))
    if flag in range(2, 9):
        with pytest.raises(InputError, match=rf"image: has the EXIF orientation {flag}, and its calibration may be of"):
            read_image(path)
    else:
        assert read_image(path).shape[:2] == (30, 40)


def test_damaged_exif_does_not_matter(tmp_path):
    for exif in (b"", b"Exif\0\0", b"Exif\0\0MM\0*\0\0\0\x08\0\x05\x01", b"no exif at all"):
        assert read_image(saved(tmp_path, encoded("L", "JPEG", exif=exif))).shape == (30, 40)


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_webp_without_loss_comes_back_exactly(tmp_path, mode):
    data = encoded(mode, "WEBP", lossless=True)
    back = read_image(saved(tmp_path, data))
    assert back.dtype == np.uint8
    np.testing.assert_array_equal(back.reshape(30, 40, 3)[..., 1], RAMP % 256)


OTHERS = {
    "AVIF": b"\0\0\0\x1cftypavif",
    "HEIC": b"\0\0\0\x1cftypheic",
    "JPEG XL": b"\xff\x0a\xfa\x7f",
    "JPEG XL in a box": b"\0\0\0\x0cJXL \r\n\x87\n",
    "JPEG 2000": b"\0\0\0\x0cjP  \r\n\x87\n",
    "Radiance HDR": b"#?RADIANCE\n",
    "GIF": b"GIF89a",
}


@pytest.mark.parametrize("kind", OTHERS)
def test_an_image_of_another_kind_is_called_by_its_name(tmp_path, kind):
    said = f"is an image of a kind that is not read, {kind.removesuffix(' in a box')}; expected a PNG, JPEG, "
    with pytest.raises(InputError, match=said):
        read_image(saved(tmp_path, OTHERS[kind] + bytes(100)))


@pytest.mark.parametrize("value", [-1, 65_536])
def test_grey_that_16_bits_cannot_hold_is_refused(tmp_path, value):
    buffer = io.BytesIO()
    Image.fromarray(np.full((2, 2), value, np.int32)).save(buffer, format="TIFF")
    with pytest.raises(InputError, match="grey values"):
        read_image(saved(tmp_path, buffer.getvalue()))


def float_file(values, kind):
    """A TIFF or a PFM of floats; the last row of a PFM comes first."""
    if kind == "PFM":
        return b"Pf\n%d %d\n-1.0\n" % values.shape[::-1] + values[::-1].astype("<f4").tobytes()
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, format="TIFF")
    return buffer.getvalue()


@pytest.mark.parametrize("kind", ["TIFF", "PFM"])
def test_floats_from_0_to_1_come_back_exactly_and_others_are_refused(tmp_path, kind):
    values = (RAMP / RAMP.max()).astype(np.float32)
    back = read_image(saved(tmp_path, float_file(values, kind)))
    assert back.dtype == np.float32
    assert back.flags.writeable
    np.testing.assert_array_equal(back, values)
    for bad in (-0.01, 1.01, np.nan, np.inf, 812):
        values[3, 4] = bad
        with pytest.raises(
            InputError, match=r"floating-point pixels .* \(--depth, --disparity\), where luminance goes"
        ):
            read_image(saved(tmp_path, float_file(values, kind)))


@pytest.mark.parametrize("size", [(8001, 8000), (32_768, 1), (1, 32_768), (10_000, 10_000), (60_000, 60_000)])
def test_too_large_an_image_is_refused_by_its_header_alone(tmp_path, size):
    data = png(*size, (b"IDAT", b"not pixels"), (b"IEND", b""))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(InputError, match="px"):
            read_image(saved(tmp_path, data))


@pytest.mark.parametrize("size", [(0, 5), (5, 0)])
def test_an_image_without_pixels_is_refused(tmp_path, size):
    with pytest.raises(InputError):
        read_image(saved(tmp_path, png(*size, (b"IEND", b""))))


def test_missing_folder_empty_pipe_and_text_are_named(tmp_path):
    cases = {
        "missing": "No such file",
        "nul\0": "null",
        ".": "is a directory",
        "empty": "is empty",
        "text": "not an image",
    }
    saved(tmp_path, b"", "empty")
    saved(tmp_path, b"hello, I am no image", "text")
    for name, said in cases.items():
        with pytest.raises(InputError, match=said) as caught:
            read_image(tmp_path / name)
        assert "\n" not in str(caught.value)
        assert "expected a PNG" in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_is_refused_and_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="regular file"):
        read_image(tmp_path / "pipe")


def test_a_file_larger_than_any_of_ours_is_not_read(tmp_path):
    with open(tmp_path / "huge", "wb") as handle:
        handle.truncate((1 << 32) + 1)
    with pytest.raises(InputError, match="bytes"):
        read_image(tmp_path / "huge")


@pytest.mark.parametrize("format_", ["PNG", "JPEG", "TIFF", "PPM", "BMP", "WEBP"])
def test_every_truncation_is_seen(tmp_path, format_):
    data = encoded("RGB", format_)
    for size in {*range(1, len(data), max(1, len(data) // 200)), *range(len(data) - 12, len(data))}:
        with pytest.raises(InputError):
            read_image(saved(tmp_path, data[:size]))


def test_every_flipped_bit_of_a_png_is_seen(tmp_path):
    data = encoded("L", "PNG")
    for at in range(0, len(data), max(1, len(data) // 200)):
        damaged = bytearray(data)
        damaged[at] ^= 1 << at % 8
        with pytest.raises(InputError):
            read_image(saved(tmp_path, bytes(damaged)))


@pytest.mark.parametrize("compression", ["tiff_adobe_deflate", "tiff_deflate"])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_every_flipped_bit_of_a_deflated_tiff_s_pixels_is_seen(tmp_path, compression, dtype):
    values = np.arange(60 * 80, dtype=dtype).reshape(60, 80) % 251
    buffer = io.BytesIO()
    Image.fromarray(values).save(buffer, format="TIFF", compression=compression)
    data = buffer.getvalue()
    tags = Image.open(io.BytesIO(data)).tag_v2
    np.testing.assert_array_equal(read_image(saved(tmp_path, data)), values)
    places = [at for start, size in zip(tags[273], tags[279], strict=True) for at in range(start, start + size)]
    for at in places[:: max(1, len(places) // 120)]:
        broken = bytearray(data)
        broken[at] ^= 1 << at % 8
        with pytest.raises(InputError):
            read_image(saved(tmp_path, bytes(broken)))


def test_a_chunk_that_claims_more_than_the_file_is_refused(tmp_path):
    data = png(4, 4) + struct.pack(">I4s", 0x7FFFFFFF, b"IDAT")
    with pytest.raises(InputError, match="truncated"):
        read_image(saved(tmp_path, data))


@pytest.mark.parametrize("format_", ["PNG", "JPEG", "TIFF", "PPM", "BMP", "WEBP"])
@FUZZ
@given(data=st.data())
def test_a_damaged_image_is_an_image_or_an_input_error(tmp_path, format_, data):
    damaged = bytearray(encoded(data.draw(st.sampled_from(["L", "RGB"])), format_))
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, len(damaged) - 1))
        damaged[at] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(1, len(damaged))) :]
    said = ""
    try:
        back = read_image(saved(tmp_path, bytes(damaged)))
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    if not said:
        assert back.dtype in (np.uint8, np.uint16)
        assert back.ndim == 2 or back.shape[2] == 3


def test_threads_leave_the_warning_filters_as_they_were(tmp_path):
    path = saved(tmp_path, encoded("RGB", "TIFF"))
    before = list(warnings.filters)
    threads = [threading.Thread(target=lambda: [read_image(path) for _ in range(20)]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert list(warnings.filters) == before


def test_the_size_is_read_from_the_header_alone(tmp_path):
    write_png(tmp_path / "a.png", np.zeros((20, 30, 3), np.uint8))
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:50])
    assert image_size(tmp_path / "a.png") == (30, 20)
    for bad in (b"", b"no image", data[:20]):
        (tmp_path / "b.png").write_bytes(bad)
        with pytest.raises(InputError, match=r"b\.png"):
            image_size(tmp_path / "b.png")


def deep(tmp_path, name, array):
    """A file of 16-bit colour, or of colour and alpha."""
    import cv2

    order = [2, 1, 0, *range(3, array.shape[2])]
    assert cv2.imwrite(str(tmp_path / name), array[..., order])
    return tmp_path / name


@pytest.mark.parametrize("name", ["a.png", "a.tif", "a.ppm"])
@pytest.mark.parametrize("bits", [12, 16])
def test_colour_of_16_bits_keeps_all_of_them(tmp_path, name, bits):
    array = np.random.default_rng(0).integers(0, 1 << bits, (7, 5, 3)).astype(np.uint16)
    back = read_image(deep(tmp_path, name, array))
    assert back.dtype == np.uint16
    assert back.flags.c_contiguous
    np.testing.assert_array_equal(back, array)


def test_alpha_of_16_bits_is_dropped(tmp_path):
    array = np.random.default_rng(0).integers(0, 4096, (7, 5, 4)).astype(np.uint16)
    np.testing.assert_array_equal(read_image(deep(tmp_path, "a.png", array)), array[..., :3])


def test_grey_of_16_bits_with_alpha_stays_grey(tmp_path):
    array = np.random.default_rng(0).integers(0, 4096, (7, 5, 2)).astype(np.uint16)
    rows = b"".join(b"\0" + row.astype(">u2").tobytes() for row in array)
    parts = (b"IHDR", struct.pack(">IIBBBBB", 5, 7, 16, 4, 0, 0, 0)), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")
    data = b"\x89PNG\r\n\x1a\n"
    for kind, body in parts:
        data += struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
    np.testing.assert_array_equal(read_image(saved(tmp_path, data)), array[..., 0])


def test_a_netpbm_image_is_spread_from_the_largest_value_that_it_declares(tmp_path):
    for magic, count in ((b"P5", 1), (b"P6", 3)):
        levels = np.repeat(np.array([0, 1023, 300, 5], ">u2"), count)
        back = read_image(saved(tmp_path, magic + b"\n4 1\n1023\n" + levels.tobytes()))
        assert back.dtype == np.uint16
        wanted = np.rint(np.array([0, 1023, 300, 5]) * (65_535 / 1023))
        np.testing.assert_array_equal(back if count == 1 else back[..., 1], wanted[None])


def tiff(order, *, bits, photometric=1, kind=1, data):
    """A TIFF of one strip, 4 x 3 px."""
    tags = [(256, 4, 4), (257, 4, 3), (258, 3, bits), (259, 3, 1), (262, 3, photometric), (273, 4, 134), (277, 3, 1),
            (278, 4, 3), (279, 4, len(data)), (339, 3, kind)]  # fmt: skip
    body = b"".join(
        struct.pack(f"{order}HHI", tag, size, 1) + struct.pack(f"{order}H2x" if size == 3 else f"{order}I", value)
        for tag, size, value in tags
    )
    head = (b"II" if order == "<" else b"MM") + struct.pack(f"{order}HIH", 42, 8, len(tags))
    return head + body + struct.pack(f"{order}I", 0) + data


@pytest.mark.parametrize("order", "<>")
def test_both_byte_orders_of_a_tiff_give_the_same_pixels(tmp_path, order):
    values = (np.arange(12) * 5000).astype(np.uint16).reshape(3, 4)
    data = tiff(order, bits=16, data=values.astype(f"{order}u2").tobytes())
    back = read_image(saved(tmp_path, data))
    assert back.dtype.isnative
    np.testing.assert_array_equal(back, values)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_tiff_whose_0_is_white_has_bright_pixels_large(tmp_path, bits):
    values = np.arange(12, dtype=f"<u{bits // 8}").reshape(3, 4)
    back = read_image(saved(tmp_path, tiff("<", bits=bits, photometric=0, data=values.tobytes())))
    np.testing.assert_array_equal(back, (1 << bits) - 1 - values)


def test_a_tiff_of_pixels_that_are_not_read_says_which_are(tmp_path):
    data = tiff("<", bits=64, kind=3, data=np.zeros((3, 4)).tobytes())
    with pytest.raises(InputError, match=r"pixels that are not read .*float64.*for maps, float32"):
        read_image(saved(tmp_path, data))
