"""Depth images without loss in about half their size, in a quarter of a millisecond.

The code is made for speed: one byte a pixel for its difference from the last pixel to the left
that has a reading, and two bytes more, in a second part, where the difference does not fit.
Smooth or noisy, a Kinect's depth takes 1.0 to 1.1 bytes a pixel. `depth_unpacking` reads it.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from drivers.core.shared_frames.depth_unpacking import (
    ESCAPE_CODE,
    MAX_STEP_CODE,
    ZERO_STEP_CODE,
    escapes_offset,
)


def max_packed_bytes(pixels: int) -> int:
    """Bytes that a depth image of so many pixels takes at most."""
    return 2 * pixels


def pack_depth(depth_raw: NDArray[np.uint16], out: NDArray[np.uint8]) -> int:
    """Pack an image into the first bytes of `out`; returns how many.

    out  (`max_packed_bytes`,) or more, at an even address. An image that would not shrink is copied.
    """
    pixels = depth_raw.size
    values = np.ascontiguousarray(depth_raw).reshape(-1).view()
    values.flags.writeable = False  # as some cameras' are: one kind of array is compiled, not two
    begin = escapes_offset(pixels)
    most = max(0, (max_packed_bytes(pixels) - 2 - begin) // 2)  # so the size tells what was done
    escapes = out[begin : begin + 2 * most].view(np.uint16)
    count = _pack(values, out[:pixels], escapes)
    if count < 0:
        out[: 2 * pixels] = values.view(np.uint8)
        return 2 * pixels
    return begin + 2 * count if count else pixels


def compile_kernels() -> None:
    """Compile, or load, before the first frame: that holds Python's lock."""
    pack_depth(np.zeros((2, 2), np.uint16), np.zeros(8, np.uint8))


@kernel
def _pack(values: NDArray[np.uint16], codes: NDArray[np.uint8], escapes: NDArray[np.uint16]) -> Any:
    """How many differences did not fit into a byte; -1 if more than there is room for."""
    last = np.uint16(0)
    count = 0
    for pixel in range(values.size):
        value = values[pixel]
        if value == 0:
            codes[pixel] = 0
            continue
        step = np.uint16(value - last)  # modulo 65536, so that every difference has 16 bits
        last = value
        code = np.uint16(step + ZERO_STEP_CODE)
        if code != 0 and code <= MAX_STEP_CODE:
            codes[pixel] = code
        elif count == escapes.size:
            return -1
        else:
            codes[pixel] = ESCAPE_CODE
            escapes[count] = step
            count += 1
    return count
