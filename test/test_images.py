"""Decoding of raw and compressed images, and what is refused with which reason."""

from __future__ import annotations

import array
import struct
import zlib
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline_tracker.errors import ImageError
from pipeline_tracker.images import (
    decode_compressed,
    decode_image,
    decode_raw,
)
from pipeline_tracker.settings import ImageSettings
from pipeline_tracker.validation.inputs import check_calibrated_size

DEFAULTS = ImageSettings()
GREY = np.random.default_rng(3).integers(0, 256, (48, 64), np.uint8)


def raw(
    data: Any, encoding: str, step: int, *, width: int = 64, height: int = 48, big: bool = False
) -> NDArray[np.uint8]:
    return decode_raw(data, encoding, width, height, step, big, DEFAULTS)


def encoded(image: NDArray[Any], extension: str) -> bytes:
    ok, buffer = cv2.imencode(extension, image)
    assert ok
    return buffer.tobytes()


def test_mono8_comes_as_it_is() -> None:
    image = raw(GREY.tobytes(), "mono8", 64)
    np.testing.assert_array_equal(image, GREY)
    assert image.flags.c_contiguous


@pytest.mark.parametrize("kind", [bytes, bytearray, np.array, memoryview])
def test_data_of_any_kind(kind: Any) -> None:
    data = kind(GREY.ravel()) if kind is np.array else kind(GREY.tobytes())
    np.testing.assert_array_equal(raw(data, "mono8", 64), GREY)
    np.testing.assert_array_equal(raw(array.array("B", GREY.tobytes()), "mono8", 64), GREY)


def test_row_padding_is_cut_and_may_lack_in_the_last_row() -> None:
    padded = np.zeros((48, 80), np.uint8)
    padded[:, :64] = GREY
    np.testing.assert_array_equal(raw(padded.tobytes(), "mono8", 80), GREY)
    np.testing.assert_array_equal(raw(padded.tobytes()[:-16], "mono8", 80), GREY)


@pytest.mark.parametrize("big", [False, True])
def test_mono16_in_either_byte_order(big: bool) -> None:
    wide = (GREY.astype(np.uint16) << 8) | 0x7F
    data = wide.astype(">u2" if big else "<u2").tobytes()
    image = raw(data, "mono16", 128, big=big)
    np.testing.assert_array_equal(image, wide.astype(np.uint32) * 255 // 65535)


def test_mono16_scale_is_that_of_the_setting_not_of_the_image() -> None:
    white = ImageSettings(mono16_white=4095)
    for values in ([0, 1, 2, 3], [0, 2048, 4095, 60000]):
        data = np.array(values, "<u2").tobytes()
        image = decode_raw(data, "mono16", 4, 1, 8, False, white)
        assert image.tolist() == [[min(255, v * 255 // 4095) for v in values]]


@pytest.mark.parametrize(("encoding", "order"), [("bgr8", (0, 1, 2)), ("rgb8", (2, 1, 0))])
def test_colour_becomes_luma(encoding: str, order: tuple[int, int, int]) -> None:
    bgr = np.random.default_rng(4).integers(0, 256, (48, 64, 3), np.uint8)
    image = raw(bgr[..., order].tobytes(), encoding, 192)
    luma = bgr @ np.array([0.114, 0.587, 0.299])
    assert np.abs(image.astype(float) - luma).max() <= 0.51


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"encoding": "bayer_rggb8"}, "'bayer_rggb8' is not taken; a Bayer image must"),
        ({"encoding": "32FC1"}, "'32FC1' is not taken; expected mono8"),
        ({"encoding": "x" * 1000}, "is not taken"),
        ({"width": 0}, "0 x 48, expected both above 0"),
        ({"height": -1}, "64 x -1, expected both above 0"),
        ({"width": 100_000, "height": 100_000}, "at most 64000000 px"),
        ({"step": 63}, "step is 63, expected at least 64"),
        ({"data": GREY.tobytes()[:-1]}, "3071 bytes of data, expected 3072"),
        ({"data": b""}, "0 bytes of data"),
    ],
)
def test_raw_images_that_are_refused(changes: dict[str, Any], reason: str) -> None:
    values = {
        "data": GREY.tobytes(),
        "encoding": "mono8",
        "width": 64,
        "height": 48,
        "step": 64,
        "is_bigendian": False,
        **changes,
    }
    with pytest.raises(ImageError, match=reason):
        decode_raw(**values, settings=DEFAULTS)


def test_png_is_exact_and_jpeg_near() -> None:
    np.testing.assert_array_equal(decode_compressed(encoded(GREY, ".png"), DEFAULTS), GREY)
    smooth = cv2.GaussianBlur(GREY, (0, 0), 3)
    near = decode_compressed(encoded(smooth, ".jpg"), DEFAULTS)
    assert np.abs(near.astype(int) - smooth).max() <= 6


def test_compressed_colour_and_depth() -> None:
    colour = np.repeat(GREY[..., None], 3, axis=2)
    np.testing.assert_array_equal(decode_compressed(encoded(colour, ".png"), DEFAULTS), GREY)
    wide = GREY.astype(np.uint16) * 257
    np.testing.assert_array_equal(decode_compressed(encoded(wide, ".png"), DEFAULTS), GREY)


def test_jpeg_is_not_turned_by_its_exif_tag() -> None:
    jpeg = encoded(GREY, ".jpg")
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    tagged = jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + jpeg[2:]
    np.testing.assert_array_equal(
        decode_compressed(tagged, DEFAULTS), decode_compressed(jpeg, DEFAULTS)
    )


@pytest.mark.parametrize("extension", [".jpg", ".png"])
def test_compressed_image_cut_off_is_refused(extension: str) -> None:
    whole = encoded(GREY, extension)
    for length in (9, 30, len(whole) // 2, len(whole) - 3):
        with pytest.raises(ImageError, match="cut off after"):
            decode_compressed(whole[:length], DEFAULTS)


@pytest.mark.parametrize("data", [b"", b"\x00", b"GIF89a" + b"\0" * 50, b"BM" + b"\0" * 60])
def test_other_formats_are_refused(data: bytes) -> None:
    with pytest.raises(ImageError, match="neither JPEG nor PNG"):
        decode_compressed(data, DEFAULTS)


def test_huge_png_is_refused_before_it_is_unpacked() -> None:
    def chunk(name: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        )

    head = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
    with pytest.raises(ImageError, match="60000 x 60000, expected at most 64000000 px"):
        decode_compressed(png, DEFAULTS)


def test_jpeg_whose_markers_lead_nowhere_is_refused() -> None:
    with pytest.raises(ImageError, match="does not say its size"):
        decode_compressed(b"\xff\xd8\xff\xe0\xff\xff" + b"\0" * 20 + b"\xff\xd9", DEFAULTS)


def test_message_of_either_kind() -> None:
    message = SimpleNamespace(
        data=GREY.tobytes(), encoding="mono8", width=64, height=48, step=64, is_bigendian=0
    )
    np.testing.assert_array_equal(decode_image(message, DEFAULTS), GREY)
    packed = SimpleNamespace(format="mono8; png compressed", data=encoded(GREY, ".png"))
    np.testing.assert_array_equal(decode_image(packed, DEFAULTS), GREY)


def test_size_is_checked_against_the_calibration() -> None:
    check_calibrated_size(GREY, 64, 48)
    with pytest.raises(ImageError, match="image is 64 x 48, expected 48 x 64 as the camera info"):
        check_calibrated_size(GREY, 48, 64)


JPEG, PNG = encoded(GREY, ".jpg"), encoded(GREY, ".png")


@settings(max_examples=300, deadline=None)
@given(st.sampled_from([JPEG, PNG]), st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255))))
def test_damaged_bytes_give_an_image_or_a_reason(
    whole: bytes, damage: list[tuple[float, int]]
) -> None:
    data = bytearray(whole)
    for place, value in damage:
        data[min(int(place * len(data)), len(data) - 1)] = value
    try:
        image = decode_compressed(bytes(data), DEFAULTS)
    except ImageError as error:
        assert "\n" not in str(error)  # noqa: PT017
    else:
        assert image.dtype == np.uint8
        assert image.ndim == 2
