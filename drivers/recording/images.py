"""Encoding and decoding of the images of a recording: complete PNG and JPEG files."""

import struct
import zlib
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_START = b"\xff\xd8"
JPEG_END = b"\xff\xd9"
JPEG_SCAN = 0xDA

BgrImage = NDArray[np.uint8]
DepthImage = NDArray[np.uint16]


class UnreadableFrameError(Exception):
    """An image of a frame is missing, broken or of the wrong kind: ``IMAGE: reason; action``."""


def decode_color(data: bytes, name: str) -> BgrImage:
    """Decode (height, width, 3) BGR uint8 from a PNG or JPEG.

    Args:
        data: The image file.
        name: Its name in error messages.

    Raises:
        UnreadableFrameError: The image is incomplete or not a color image.
    """
    image = decode_image(data, name)
    if image.dtype != np.uint8:
        raise UnreadableFrameError(
            f"{name}: color does not have 8 bits per channel; give the color image here "
            "(in associations.txt color comes before depth)"
        )
    if image.ndim == 2:
        return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)  # type: ignore[return-value]
    if image.shape[2] == 4:
        return cv2.cvtColor(image, cv2.COLOR_BGRA2BGR)  # type: ignore[return-value]
    return image


def decode_depth(data: bytes, name: str) -> DepthImage:
    """Decode (height, width) uint16 from a PNG; arguments and errors as `decode_color`."""
    image = decode_image(data, name)
    if image.ndim != 2 or image.dtype != np.uint16:
        raise UnreadableFrameError(
            f"{name}: depth has {image.dtype.itemsize * 8} bits and "
            f"{1 if image.ndim == 2 else image.shape[2]} channel(s), where 16 bits and 1 channel "
            "are needed; export the sensor's raw depth, not a visualization"
        )
    return image


def decode_image(data: bytes, name: str) -> NDArray[Any]:
    """Decode a PNG or JPEG as it is stored, channels in BGR order; errors as `decode_color`."""
    fault = _find_fault(data)
    if fault:
        raise UnreadableFrameError(f"{name}: {fault}; restore it or remove it from the list")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise UnreadableFrameError(f"{name}: cannot be decoded: {error.err}; replace it") from error
    if image is None:
        raise UnreadableFrameError(f"{name}: cannot be decoded; replace it")
    return image


def _find_fault(data: bytes) -> str:
    """Return why an image file is incomplete; "" if it is complete.

    OpenCV would fill missing parts with gray, or print to standard error.
    """
    if not data:
        return "is empty (0 bytes)"
    if data.startswith(PNG_SIGNATURE):
        return _find_png_fault(data)
    if data.startswith(JPEG_START):
        return _find_jpeg_fault(data)
    return "is not an image (neither PNG nor JPEG)"


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


class ColorFormat(StrEnum):
    """The file format of color images; depth is always PNG."""

    PNG = "png"  # lossless
    JPEG = "jpg"  # far smaller and faster, but lossy


def encode_image(image: NDArray[Any], kind: ColorFormat) -> bytes:
    """Encode a color or depth image as a file."""
    # OpenCV's own PNG settings (run lengths, horizontal differences) beat level 1 in time and size.
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if kind is ColorFormat.JPEG else []
    return cv2.imencode(f".{kind}", image, options)[1].tobytes()
