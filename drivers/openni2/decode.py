"""Conversion of images in libOpenNI2's memory to NumPy arrays."""

import ctypes

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.openni2.library import OniFrame, PixelFormat, VideoMode

# Depth values per meter.
DEPTH_FACTORS = {PixelFormat.DEPTH_1_MM: 1000.0, PixelFormat.DEPTH_100_UM: 10000.0}
TO_BGR = {
    PixelFormat.RGB888: (cv2.COLOR_RGB2BGR, 3),
    PixelFormat.YUV422: (cv2.COLOR_YUV2BGR_UYVY, 2),
    PixelFormat.YUYV: (cv2.COLOR_YUV2BGR_YUYV, 2),
    PixelFormat.GRAY8: (cv2.COLOR_GRAY2BGR, 1),
}


class IncompleteFrameError(Exception):
    """A frame whose size differs from its stream's video mode."""


def format_name(mode: VideoMode) -> str:
    """Return the name of a pixel format, or its number."""
    return (
        PixelFormat(mode.format).name
        if mode.format in set(PixelFormat)
        else f"number {mode.format}"
    )


def decode_color(frame: OniFrame) -> NDArray[np.uint8]:
    """Copy an image as (height, width, 3) uint8 BGR.

    Raises:
        IncompleteFrameError: If the image is incomplete.
    """
    code, channels = TO_BGR[PixelFormat(frame.mode.format)]
    return cv2.cvtColor(_pixels(frame, channels), code)  # type: ignore[return-value]


def decode_depth(frame: OniFrame) -> NDArray[np.uint16]:
    """Copy depth as (height, width) uint16 in the stream's unit; 0 = no reading.

    Raises:
        IncompleteFrameError: The frame has the wrong size.
    """
    depth: NDArray[np.uint16] = _pixels(frame, 2).view(np.uint16)[..., 0].copy()
    return depth


def _pixels(frame: OniFrame, channels: int) -> NDArray[np.uint8]:
    """Return a (height, width, channels) uint8 view of the library's memory."""
    height, width = frame.height, frame.width
    is_whole = (width, height) == (frame.mode.width, frame.mode.height)
    if not is_whole or frame.size != height * width * channels:
        raise IncompleteFrameError(
            f"{frame.size} bytes of {width}x{height} where {frame.mode.width}x{frame.mode.height} "
            "are expected"
        )
    memory = (ctypes.c_uint8 * frame.size).from_address(frame.data)
    return np.frombuffer(memory, np.uint8).reshape(height, width, channels)
