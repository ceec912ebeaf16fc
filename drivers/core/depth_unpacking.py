"""Decoding of packed depth with NumPy alone, for a process without compiled kernels."""

import numpy as np
from numpy.typing import NDArray

# A pixel's byte: 0 = no reading; 1 to 254 = the difference plus 128; 255 = see the escapes.
ZERO_STEP_CODE = np.uint16(128)
MAX_STEP_CODE = np.uint16(254)
ESCAPE_CODE = np.uint8(255)


def escapes_offset(pixels: int) -> int:
    """Return the even offset where the escapes begin."""
    return pixels + pixels % 2


def unpack_depth(packed: bytes, height: int, width: int) -> NDArray[np.uint16]:
    """Unpack a (height, width) uint16 image, bit for bit."""
    pixels = height * width
    if len(packed) == 2 * pixels:
        return np.frombuffer(packed, np.uint16).reshape(height, width)
    codes = np.frombuffer(packed, np.uint8, pixels)
    steps = codes.astype(np.uint16) - ZERO_STEP_CODE
    if len(packed) > pixels:
        steps[codes == ESCAPE_CODE] = np.frombuffer(
            packed, np.uint16, offset=escapes_offset(pixels)
        )
    has_reading = codes != 0
    depth = np.zeros(pixels, np.uint16)
    depth[has_reading] = np.cumsum(steps[has_reading], dtype=np.uint16)
    return depth.reshape(height, width)
