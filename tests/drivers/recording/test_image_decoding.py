import struct
import zlib
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.recording.image_decoding import (
    PNG_SIGNATURE,
    UnreadableFrameError,
    decode_depth,
    stored_color,
    stored_depth,
)
from drivers.recording.recorded_frames import FramePair
from drivers.tum.index_files import ListedImage

SIZE = (64, 48)
COLOR = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
DEPTH = np.random.default_rng(1).integers(0, 65536, (48, 64), dtype=np.uint16)


def encoded(image: NDArray[Any], kind: str = ".png") -> bytes:
    return cv2.imencode(kind, image)[1].tobytes()


Load = Callable[[bytes, bytes], tuple[NDArray[np.uint8], NDArray[np.uint16]]]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def load(color: bytes, depth: bytes) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
        (tmp_path / "c").write_bytes(color)
        (tmp_path / "d").write_bytes(depth)
        images = [ListedImage(Decimal(0), tmp_path / name, "list:1") for name in "cd"]
        return FramePair(*images).load(SIZE, SIZE)

    return load


def test_png_comes_back_bit_for_bit(load: Load) -> None:
    color, depth = load(encoded(COLOR), encoded(DEPTH))
    np.testing.assert_array_equal(color, COLOR)
    np.testing.assert_array_equal(depth, DEPTH)
    assert (color.dtype.name, depth.dtype.name) == ("uint8", "uint16")


def test_jpeg_color_is_read(load: Load) -> None:
    smooth = cv2.GaussianBlur(COLOR, (0, 0), 4)
    color, _ = load(encoded(smooth, ".jpg"), encoded(DEPTH))
    assert np.abs(color.astype(int) - smooth).mean() < 3


def test_gray_and_transparent_color_become_three_channels(load: Load) -> None:
    gray, _ = load(encoded(COLOR[..., 0]), encoded(DEPTH))
    np.testing.assert_array_equal(gray, COLOR[..., :1].repeat(3, axis=2))
    transparent = np.dstack([COLOR, COLOR[..., 0]])
    np.testing.assert_array_equal(load(encoded(transparent), encoded(DEPTH))[0], COLOR)


@pytest.mark.parametrize("kind", [".bmp", ".tiff", ".webp", ".ppm"])
def test_other_lossless_formats_of_color_are_read(load: Load, kind: str) -> None:
    options = [cv2.IMWRITE_WEBP_QUALITY, 101] if kind == ".webp" else []  # above 100: lossless
    data = cv2.imencode(kind, COLOR, options)[1].tobytes()
    np.testing.assert_array_equal(load(data, encoded(DEPTH))[0], COLOR)


@pytest.mark.parametrize("kind", [".tiff", ".pgm"])
def test_other_formats_of_depth_are_read(load: Load, kind: str) -> None:
    np.testing.assert_array_equal(load(encoded(COLOR), encoded(DEPTH, kind))[1], DEPTH)


def test_a_gray_pgm_and_color_of_16_bits_are_read(load: Load) -> None:
    pgm = b"P5\n# 64x48\n64 48\n255\n" + COLOR[..., 0].tobytes()
    np.testing.assert_array_equal(load(pgm, encoded(DEPTH))[0], COLOR[..., :1].repeat(3, axis=2))
    for kind in (".png", ".tiff"):
        data = encoded(COLOR.astype(np.uint16) * 257, kind)
        np.testing.assert_array_equal(load(data, encoded(DEPTH))[0], COLOR)


def test_a_conversion_keeps_png_and_jpeg_and_decodes_others() -> None:
    for kind in (".png", ".jpg"):
        assert stored_color(encoded(COLOR, kind), "c") == encoded(COLOR, kind)
    np.testing.assert_array_equal(stored_color(encoded(COLOR, ".bmp"), "c"), COLOR)
    assert stored_depth(encoded(DEPTH), "d") == encoded(DEPTH)
    np.testing.assert_array_equal(stored_depth(encoded(DEPTH, ".tiff"), "d"), DEPTH)


@pytest.mark.parametrize("kind", [".bmp", ".tiff", ".webp", ".pgm"])
def test_other_formats_are_refused_quietly_if_truncated(
    load: Load, kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    data = encoded(COLOR[..., 0] if kind == ".pgm" else COLOR, kind)
    for length in (20, 60, len(data) // 2, len(data) - 40):
        with pytest.raises(UnreadableFrameError, match="OpenCV cannot decode this"):
            load(data[:length], encoded(DEPTH))
    assert capfd.readouterr().err == ""


def test_a_truncated_file_is_rejected(load: Load, capfd: pytest.CaptureFixture[str]) -> None:
    png, jpeg, depth = encoded(COLOR), encoded(COLOR, ".jpg"), encoded(DEPTH)
    for data in (png, jpeg):
        for length in (*range(60), len(data) // 2, len(data) - 5, len(data) - 1):
            with pytest.raises(UnreadableFrameError):
                load(data[:length], depth)
    with pytest.raises(UnreadableFrameError, match=r"d: is truncated \(the PNG ends after"):
        load(png, depth[:-20])
    assert capfd.readouterr().err == ""


def test_a_damaged_png_is_refused_quietly(load: Load, capfd: pytest.CaptureFixture[str]) -> None:
    for position in range(8, 2000, 37):
        data = bytearray(encoded(COLOR))
        data[position] ^= 0x10
        with pytest.raises(UnreadableFrameError, match=r"damaged|truncated"):
            load(bytes(data), encoded(DEPTH))
    assert capfd.readouterr().err == ""


def test_a_jpeg_with_an_embedded_preview_is_checked_by_its_main_image(load: Load) -> None:
    jpeg = encoded(COLOR, ".jpg")
    preview = encoded(COLOR[:8, :8], ".jpg")
    segment = b"\xff\xe1" + struct.pack(">H", len(preview) + 2) + preview
    whole = jpeg[:2] + segment + jpeg[2:]
    load(whole, encoded(DEPTH))
    with pytest.raises(UnreadableFrameError, match="truncated"):
        load(whole[:-20], encoded(DEPTH))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "is empty"),
        (b"not an image at all", "is not an image"),
        (b"GIF89a" + bytes(100), "OpenCV cannot decode this GIF file; .* convert it to PNG"),
        (b"P7\nWIDTH 9\n", "OpenCV cannot decode this PGM or PPM file"),
        (b"v/1\x01" + bytes(100), "OpenCV cannot decode this OpenEXR file"),
        (b"\xff\xd8\xff\xd9", "contains no image"),
    ],
)
def test_a_file_that_is_no_image_is_reported(load: Load, data: bytes, reason: str) -> None:
    with pytest.raises(UnreadableFrameError, match=reason):
        load(data, encoded(DEPTH))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    image = ListedImage(Decimal(0), tmp_path / "gone.png", "list:1")
    with pytest.raises(UnreadableFrameError, match=r"gone\.png: cannot be read: No such file"):
        FramePair(image, image).load(SIZE, SIZE)


@pytest.mark.parametrize(
    ("color", "depth", "reason"),
    [
        (COLOR, DEPTH.astype(np.uint8), "where 16 bits and 1 channel are needed"),
        (COLOR, COLOR, "where 16 bits and 1 channel are needed"),
        (COLOR, np.dstack([DEPTH] * 3), "where 16 bits and 1 channel are needed"),
        (DEPTH, COLOR, "color has 16 bits and 1 channel"),
        (COLOR, DEPTH[:, :32], r"color is 64x48 but depth .* is 32x48"),
        (COLOR[:, :32], DEPTH[:, :32], "the image is 32x48 but the camera is 64x48"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_images_of_another_kind_or_size_are_refused(
    load: Load, color: NDArray[Any], depth: NDArray[Any], reason: str
) -> None:
    with pytest.raises(UnreadableFrameError, match=reason):
        load(encoded(color), encoded(depth))


def test_floating_point_depth_is_refused() -> None:
    data = cv2.imencode(".tiff", DEPTH.astype(np.float32))[1].tobytes()
    with pytest.raises(UnreadableFrameError, match=r"32 floating-point bits.* as whole numbers"):
        decode_depth(data, "depth.tiff")


def test_an_absurd_size_is_refused_not_a_crash(load: Load) -> None:
    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", 600_000, 600_000, 16, 0, 0, 0, 0)
    bomb = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(99))) + chunk(b"IEND", b"")
    with pytest.raises(UnreadableFrameError, match="cannot be decoded"):
        load(encoded(COLOR), PNG_SIGNATURE + bomb)
