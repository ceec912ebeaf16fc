"""Encoding of a frame's images and stamps."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Vector
from drivers.recording.frame_stamps import FrameStamps


class ColorFormat(StrEnum):
    """The file format of color images; depth is always PNG."""

    PNG = "png"  # lossless
    JPEG = "jpg"  # far smaller and faster, but lossy


@dataclass(frozen=True)
class EncodedFrame:
    """A frame as it is stored on disk."""

    stamps: FrameStamps
    color: bytes
    color_format: ColorFormat
    depth: bytes
    gravity_m_s2: Vector | None


def encode_frame(frame: RgbdFrame, stamps: FrameStamps, color_format: ColorFormat) -> EncodedFrame:
    """Encode the images of a frame."""
    color = encode_image(frame.color_bgr, color_format)
    depth = encode_image(frame.depth_raw, ColorFormat.PNG)
    return EncodedFrame(stamps, color, color_format, depth, frame.gravity_m_s2)


def encode_image(image: NDArray[Any], kind: ColorFormat) -> bytes:
    """Encode a color or depth image as a file."""
    # OpenCV's own PNG settings (run lengths, horizontal differences) beat level 1 in time and size.
    options = [cv2.IMWRITE_JPEG_QUALITY, 95] if kind is ColorFormat.JPEG else []
    return cv2.imencode(f".{kind}", image, options)[1].tobytes()
