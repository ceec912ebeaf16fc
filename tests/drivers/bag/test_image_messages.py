"""Encodings of images, with known colors."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.playback.recording_formats import open_recording
from tests.drivers.bag.bag_maker import (
    COMPRESSED,
    IMAGE,
    INFO,
    SIZE,
    BagWriter,
    color_image,
    depth_mm,
    stamp_ns,
)
from tests.drivers.bag.test_bag import (
    COLOR_TOPIC,
    DEPTH_TOPIC,
    INFO_TOPIC,
    Fill,
    complaint,
    first_frame,
    make_bag,
    write_color,
)

WIDTH, HEIGHT = SIZE
# First and second row of a Bayer pattern's cells, as channels in BGR order.
BAYER = {"rggb": (2, 1, 1, 0), "bggr": (0, 1, 1, 2), "gbrg": (1, 0, 2, 1), "grbg": (1, 2, 0, 1)}


def known_image() -> NDArray[np.uint8]:
    """Make a BGR image with a ramp to the right in blue, one downward in green, and much red."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    return np.dstack([30 + u, 60 + 2 * v, 180 + 0 * u]).astype(np.uint8)


def to_16_bits(image: NDArray[np.uint8]) -> NDArray[np.uint16]:
    return image.astype(np.uint16) * 257


def mosaic(pattern: str) -> NDArray[np.uint8]:
    """Make what a sensor behind a Bayer pattern measures."""
    image = known_image()
    raw = np.empty((HEIGHT, WIDTH), np.uint8)
    for cell, channel in enumerate(BAYER[pattern]):
        row, column = divmod(cell, 2)
        raw[row::2, column::2] = image[row::2, column::2, channel]
    return raw


def yuv422(order: str) -> NDArray[np.uint8]:
    """Make (height, width, 2) bytes by the definition of ITU-R BT.601, in an order such as UYVY."""
    b, g, r = np.moveaxis(known_image() / 255.0, -1, 0)
    y = 16 + 65.481 * r + 128.553 * g + 24.966 * b
    u = 128 - 37.797 * r - 74.203 * g + 112.0 * b
    v = 128 + 112.0 * r - 93.786 * g - 18.214 * b
    channels = {"Y": [y[:, ::2], y[:, 1::2]], "U": [(u[:, ::2] + u[:, 1::2]) / 2]}
    channels["V"] = [(v[:, ::2] + v[:, 1::2]) / 2]
    pairs = np.dstack([channels[letter].pop(0) for letter in order])
    data: NDArray[np.uint8] = np.rint(pairs).astype(np.uint8).reshape(HEIGHT, WIDTH, 2)
    return data


def color_filler(image: NDArray[Any], encoding: str, is_bigendian: bool = False) -> Fill:
    """Return what writes frames with this color."""

    def fill(bag: BagWriter, k: int) -> None:
        t = stamp_ns(k)
        message = bag.maker.image(t, image, encoding)
        message.is_bigendian = int(is_bigendian)
        bag.write(INFO_TOPIC, INFO, t, bag.maker.info(t))
        bag.write(COLOR_TOPIC, IMAGE, t, message)
        bag.write(DEPTH_TOPIC, IMAGE, t, bag.maker.image(t, depth_mm(k), "16UC1"))

    return fill


def read_color(
    path: Path, image: NDArray[Any], encoding: str, is_bigendian: bool = False
) -> NDArray[np.int64]:
    frame = first_frame(path, color_filler(image, encoding, is_bigendian))
    color: NDArray[np.int64] = frame.color_bgr.astype(int)
    return color


EXACT = {
    "bgr8": known_image(),
    "8UC3": known_image(),
    "rgb8": known_image()[..., ::-1],
    "bgra8": np.dstack([known_image(), known_image()[..., 0]]),
    "8UC4": np.dstack([known_image(), known_image()[..., 0]]),
    "rgba8": np.dstack([known_image()[..., ::-1], known_image()[..., 0]]),
}
EXACT_16 = {name.replace("8", "16"): to_16_bits(image) for name, image in EXACT.items()}


@pytest.mark.parametrize("encoding", [*EXACT, *EXACT_16])
def test_color_is_read_exactly(tmp_path: Path, encoding: str) -> None:
    color = read_color(tmp_path, (EXACT | EXACT_16)[encoding], encoding)
    np.testing.assert_array_equal(color, known_image())


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "mono16"])
def test_gray_images_get_three_equal_channels(tmp_path: Path, encoding: str) -> None:
    gray = known_image()[..., 0]
    color = read_color(tmp_path, to_16_bits(gray) if encoding == "mono16" else gray, encoding)
    np.testing.assert_array_equal(color, np.dstack([gray] * 3))


def test_color_of_a_big_endian_machine_is_read(tmp_path: Path) -> None:
    image = to_16_bits(known_image()) - np.uint16(200)  # both bytes of a value differ
    color = read_color(tmp_path, image.astype(">u2"), "bgr16", is_bigendian=True)
    assert np.abs(color - known_image()).max() <= 1


@pytest.mark.parametrize("pattern", BAYER)
@pytest.mark.parametrize("bits", [8, 16])
def test_the_colors_of_a_bayer_pattern_are_restored(
    tmp_path: Path, pattern: str, bits: int
) -> None:
    raw = mosaic(pattern) if bits == 8 else to_16_bits(mosaic(pattern))
    color = read_color(tmp_path, raw, f"bayer_{pattern}{bits}")
    assert np.abs(color - known_image())[2:-2, 2:-2].max() <= 1


@pytest.mark.parametrize(
    ("encoding", "order"),
    [("uyvy", "UYVY"), ("yuv422", "UYVY"), ("yuyv", "YUYV"), ("yuv422_yuy2", "YUYV")],
)
def test_the_colors_of_yuv_are_restored(tmp_path: Path, encoding: str, order: str) -> None:
    color = read_color(tmp_path, yuv422(order), encoding)
    assert np.abs(color - known_image()).max() <= 4


@pytest.mark.parametrize(
    ("image", "encoding", "expected"),
    [
        (yuv422("UYVY")[:, 1:], "uyvy", "63x48 pixels are no uyvy; remove the message"),
        (depth_mm(0), "16UC1", "encoding 16UC1 is not color; use one of bgr8, "),
    ],
)
def test_images_that_are_no_color_are_refused(
    tmp_path: Path, image: NDArray[Any], encoding: str, expected: str
) -> None:
    assert expected in complaint(make_bag(tmp_path / "a", color_filler(image, encoding)))


def test_compressed_messages_may_hold_other_files_than_png_and_jpeg(tmp_path: Path) -> None:
    def fill(bag: BagWriter, k: int) -> None:
        t, make = stamp_ns(k), bag.maker
        color = cv2.imencode(".bmp", color_image(k))[1].tobytes()
        depth = cv2.imencode(".tiff", depth_mm(k))[1].tobytes()
        bag.write(INFO_TOPIC, INFO, t, make.info(t))
        bag.write(f"{COLOR_TOPIC}/compressed", COMPRESSED, t, make.compressed(t, color, "bmp"))
        bag.write(f"{DEPTH_TOPIC}/compressed", COMPRESSED, t, make.compressed(t, depth, "tiff"))

    recording = open_recording(make_bag(tmp_path / "a", fill))
    pair = recording.frames.pairs[1]
    for color in (pair.color.read_color(), pair.color.read_stored_color()):
        np.testing.assert_array_equal(color, color_image(1))
    for depth in (pair.depth.read_depth(), pair.depth.read_stored_depth()):
        np.testing.assert_array_equal(depth, depth_mm(1))
    recording.close()


def test_enlarged_depth_is_not_shifted(tmp_path: Path) -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    plane = 1000 + 10 * u + 20 * v
    binned = plane.reshape(HEIGHT // 2, 2, WIDTH // 2, 2).mean(axis=(1, 3)).astype(np.uint16)

    def fill(bag: BagWriter, k: int) -> None:
        write_color(bag, k)
        t, size = stamp_ns(k), (WIDTH // 2, HEIGHT // 2)
        info = bag.maker.info(t, focal_px=30.0, size=size)
        bag.write(DEPTH_TOPIC.replace("image_raw", "camera_info"), INFO, t, info)
        bag.write(DEPTH_TOPIC, IMAGE, t, bag.maker.image(t, binned, "16UC1"))

    error = first_frame(tmp_path, fill).depth_raw - plane
    assert error.mean() == 0  # a shift by a column would be 10
    assert np.abs(error).max() == 15
