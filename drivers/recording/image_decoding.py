"""Decoding of image files: PNG and JPEG, which are checked first, and what else OpenCV reads.

OpenCV is imported by the first image: a recorder that reads none takes 5 MB less.
"""

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_START = b"\xff\xd8"
JPEG_END = b"\xff\xd9"
JPEG_SCAN = 0xDA
# How files begin. OpenCV decodes some of each format, depending on how it was built.
FORMATS = {
    name: re.compile(start, re.DOTALL)
    for name, start in {
        "PNG": re.escape(PNG_SIGNATURE),
        "JPEG": JPEG_START,
        "BMP": rb"BM",
        "TIFF": rb"II[*+]\0|MM\0[*+]",
        "WebP": rb"RIFF....WEBP",
        "PGM or PPM": rb"P[1-7]\s",
        "GIF": rb"GIF8",
        "JPEG 2000": rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51",
        "OpenEXR": rb"v/1\x01",
        "AVIF or HEIC": rb"....ftyp",
    }.items()
}

BgrImage = NDArray[np.uint8]
DepthImage = NDArray[np.uint16]


class UnreadableFrameError(Exception):
    """An image of a frame is missing, broken or of the wrong kind: ``IMAGE: reason; action``."""


def decode_color(data: bytes, name: str) -> BgrImage:
    """Decode (height, width, 3) BGR uint8; 16 bits per channel are reduced to 8.

    Args:
        name: Its name in error messages.

    Raises:
        UnreadableFrameError: The image is incomplete or not a color image.
    """
    image = decode_image(data, name)
    if image.dtype == np.uint16 and image.ndim == 3:
        image = reduce_to_8_bits(image)
    if image.dtype != np.uint8:
        raise UnreadableFrameError(
            f"{name}: color has {_describe(image)}, as depth has; give the color image here "
            "(in associations.txt color comes before depth)"
        )
    import cv2

    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)  # type: ignore[return-value]
    if image.shape[2] == 4:
        return cv2.cvtColor(image, cv2.COLOR_BGRA2BGR)  # type: ignore[return-value]
    return image


def decode_depth(data: bytes, name: str) -> DepthImage:
    """Decode (height, width) uint16; arguments and errors as `decode_color`."""
    image = decode_image(data, name)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise UnreadableFrameError(
            f"{name}: depth has {_describe(image)}, where 16 bits and 1 channel are needed; export "
            "the sensor's raw depth as whole numbers, not a visualization"
        )
    return image


def _describe(image: NDArray[Any]) -> str:
    bits = f"{image.dtype.itemsize * 8}{' floating-point' if image.dtype.kind == 'f' else ''} bits"
    return f"{bits} and {1 if image.ndim == 2 else image.shape[2]} channel(s)"


def stored_color(data: bytes, name: str) -> bytes | BgrImage:
    """Return a PNG or JPEG as it is, which every format of recordings takes; decode others."""
    is_kept = data.startswith((PNG_SIGNATURE, JPEG_START))
    return data if is_kept else decode_color(data, name)


def stored_depth(data: bytes, name: str) -> bytes | DepthImage:
    """Return a PNG as it is, and decode others."""
    return data if data.startswith(PNG_SIGNATURE) else decode_depth(data, name)


def decode_image(data: bytes, name: str) -> NDArray[Any]:
    """Decode an image file as it is stored, channels in BGR order; errors as `decode_color`."""
    import cv2

    image_format = next((each for each, start in FORMATS.items() if start.match(data)), "")
    fault = _find_fault(data, image_format)
    if fault:
        raise UnreadableFrameError(f"{name}: {fault}; restore it or remove it from the list")
    try:
        with _no_opencv_messages():
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise UnreadableFrameError(f"{name}: cannot be decoded: {error.err}; replace it") from error
    if image is None:
        raise UnreadableFrameError(
            f"{name}: OpenCV cannot decode this {image_format} file; restore it, or convert it "
            "to PNG"
        )
    return image


def reduce_to_8_bits(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Scale uint16 to uint8, the largest value to the largest; uint8 is returned as it is."""
    if image.dtype == np.uint8:
        return image
    import cv2

    return cv2.convertScaleAbs(image, alpha=255 / 65535)  # type: ignore[return-value]


@contextmanager
def _no_opencv_messages() -> Iterator[None]:
    """Keep OpenCV from printing why it cannot decode an image."""
    import cv2

    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _find_fault(data: bytes, image_format: str) -> str:
    """Return why a file is no image or an incomplete PNG or JPEG; "" otherwise.

    OpenCV would fill their missing parts with gray, or print to standard error. Others it refuses.
    """
    if not data:
        return "is empty (0 bytes)"
    if image_format == "PNG":
        return _find_png_fault(data)
    if image_format == "JPEG":
        return _find_jpeg_fault(data)
    return "" if image_format else f"is not an image ({', '.join(FORMATS)})"


def _find_png_fault(data: bytes) -> str:
    """Check the chunks (length, type, data, CRC) up to IEND: PNG specification, section 5."""
    position = len(PNG_SIGNATURE)
    while position + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, position)
        end = position + 12 + length
        if end > len(data):
            break
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(memoryview(data)[position + 4 : end - 4]) != crc:
            return "is damaged (a checksum of the PNG does not match)"
        if data[position + 4 : position + 8] == b"IEND":
            return ""
        position = end
    return f"is truncated (the PNG ends after {len(data)} bytes)"


def _find_jpeg_fault(data: bytes) -> str:
    """Check the segments up to the scan, then search the end marker: ITU-T T.81, annex B.

    In a scan 0xFF is always escaped, so an end marker there is not that of an embedded preview.
    """
    position = len(JPEG_START)
    while position + 4 <= len(data) and data[position] == 0xFF:
        if data[position + 1] == JPEG_SCAN:
            is_complete = data.find(JPEG_END, position) >= 0
            return "" if is_complete else f"is truncated (the JPEG ends after {len(data)} bytes)"
        (length,) = struct.unpack_from(">H", data, position + 2)
        position += 2 + length
    return "is truncated or damaged (the JPEG contains no image)"
