"""Frames in a Kinect's USB format: packed 11-bit depth and Bayer color."""

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.simulators.raw_depth import NOMINAL, RawDepthScale, mm_to_raw

ROWS, COLUMNS = 480, 640
DEPTH_BITS = 11
_MAGIC = 0x4D4C464B
HEADER_BYTES = 64

ColorBgr = NDArray[np.uint8]
DepthMm = NDArray[np.uint16]


@dataclass(frozen=True)
class UsbFrames:
    """A file of frames for the Kinect simulator."""

    file: Path
    count: int
    scale: RawDepthScale


def write_usb_frames(
    folder: Path,
    frames: Iterable[tuple[ColorBgr, DepthMm]],
    scale: RawDepthScale = NOMINAL,
) -> UsbFrames:
    """Write frames to a new file in `folder`.

    Args:
        folder: Folder of the file.
        frames: Color (480, 640, 3) uint8 BGR, and depth (480, 640) uint16 in millimeters with 0 for
            no reading.
        scale: Constants of the simulated Kinect; `fit_scale` finds those of a recording.
    """
    file = folder / f"frames-{len(list(folder.glob('frames-*')))}.bin"
    count = 0
    with file.open("wb") as stream:
        stream.write(bytes(HEADER_BYTES))
        for bgr, depth_mm in frames:
            count += 1
            _check_shape(depth_mm, (ROWS, COLUMNS))
            _check_shape(bgr, (ROWS, COLUMNS, 3))
            stream.write(pack_bits(mm_to_raw(depth_mm, scale), DEPTH_BITS).tobytes())
            stream.write(to_bayer(bgr).tobytes())
        sizes = (ROWS * COLUMNS * DEPTH_BITS // 8, ROWS * COLUMNS)
        stream.seek(0)
        stream.write(struct.pack("<4I", _MAGIC, count, *sizes))
    return UsbFrames(file, count, scale)


def to_bayer(bgr: ColorBgr) -> NDArray[np.uint8]:
    """Apply the Kinect's color filters: green red / blue green."""
    mosaic = np.ascontiguousarray(bgr[:, :, 1])
    mosaic[0::2, 1::2] = bgr[0::2, 1::2, 2]
    mosaic[1::2, 0::2] = bgr[1::2, 0::2, 0]
    return mosaic


def pack_bits(values: NDArray[np.uint16], bits: int) -> NDArray[np.uint8]:
    """Pack values of `bits` (9 to 16) bits without gaps, the highest bit first.

    Eight values fill `bits` bytes, and no byte has bits of more than two values.
    """
    groups = values.reshape(-1, 8).astype(np.uint32)
    packed = np.empty((len(groups), bits), np.uint8)
    for byte in range(bits):
        first, skipped = divmod(8 * byte, bits)
        both = groups[:, first] << bits | groups[:, min(first + 1, 7)]
        packed[:, byte] = both >> (2 * bits - skipped - 8) & 0xFF
    return packed.ravel()


def _check_shape(image: NDArray[np.generic], shape: tuple[int, ...]) -> None:
    if image.shape != shape:
        raise ValueError(f"an image of a Kinect must have the shape {shape}, not {image.shape}")
