"""Conversion of the images that libfreenect delivers: to BGR, and to millimeters."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.freenect.depth_tables import MAX_DEPTH_MM, DepthTables


@dataclass(frozen=True)
class ImageConversion:
    """The conversion of both streams of one device.

    Attributes:
        to_bgr: Converts a color image, its first argument, to (480, 640, 3) uint8 BGR.
        to_mm: Converts a depth image to (480, 640) uint16 millimeters; 0 = no reading.
    """

    to_bgr: Callable[[NDArray[np.uint8], NDArray[np.uint8]], object]
    to_mm: Callable[[NDArray[Any], NDArray[np.uint16]], object]


def make_raw_conversion(tables: DepthTables, *, registers_depth: bool) -> ImageConversion:
    """Make the conversion of images as the Kinect sends them, by kernels.

    They take less than half the time of libfreenect's own functions, and give the same pixels.

    Args:
        registers_depth: Whether depth is registered to color.
    """
    # Here, because Numba takes half a second to import, and a dump does without.
    from drivers.freenect.bayer import demosaic
    from drivers.freenect.raw_depth import RegisteredDepth, UnregisteredDepth

    to_mm = RegisteredDepth(tables) if registers_depth else UnregisteredDepth(tables)
    return ImageConversion(demosaic, to_mm)


def load_kernels() -> None:
    """Load the kernels, or compile them the first time, before images arrive."""
    from drivers.core.memory import release_memory
    from drivers.freenect.bayer import demosaic
    from drivers.freenect.raw_depth import compile_kernels

    demosaic(np.zeros((4, 4), np.uint8), np.empty((4, 4, 3), np.uint8))
    compile_kernels()
    release_memory()


def _to_bgr(color_rgb: NDArray[np.uint8], bgr: NDArray[np.uint8]) -> None:
    import cv2  # here, because images of a Kinect need none of it

    cv2.cvtColor(color_rgb, cv2.COLOR_RGB2BGR, bgr)


def _clear_far(depth_mm: NDArray[np.uint16], result: NDArray[np.uint16]) -> None:
    np.multiply(depth_mm, depth_mm < MAX_DEPTH_MM, out=result)


# Color is RGB, depth is in millimeters and registered.
DUMP_CONVERSION = ImageConversion(_to_bgr, _clear_far)
