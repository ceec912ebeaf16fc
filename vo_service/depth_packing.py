"""Packing of depth images, for records in shared memory. `frame_record` has the format.

A process that only unpacks loads no Numba.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel
from vo_service.frame_record import (
    ESCAPE_CODE,
    MAX_STEP_CODE,
    ZERO_STEP_CODE,
    escapes_offset,
    max_packed_bytes,
)


def pack_depth(depth_raw: NDArray[np.uint16], out: NDArray[np.uint8]) -> int:
    """Pack an image; one that would not shrink is copied.

    Args:
        depth_raw: (height, width) uint16.
        out: Buffer of at least `max_packed_bytes` uint8, at an even address.

    Returns:
        The number of bytes written to the start of `out`.
    """
    pixels = depth_raw.size
    values = np.ascontiguousarray(depth_raw).reshape(-1).view()
    # Some cameras' arrays are read-only: with all read-only, one kind of array is compiled.
    values.flags.writeable = False
    begin = escapes_offset(pixels)
    # Packed data stay smaller than a copy, so that the decoder knows a copy by its size.
    max_escapes = max(0, (max_packed_bytes(pixels) - 2 - begin) // 2)
    escapes = out[begin : begin + 2 * max_escapes].view(np.uint16)
    count = _pack(values, out[:pixels], escapes)
    if count < 0:
        out[: 2 * pixels] = values.view(np.uint8)
        return 2 * pixels
    return begin + 2 * count if count else pixels


def compile_kernels() -> None:
    """Compile or load the kernel before the first frame, since that holds the GIL."""
    pack_depth(np.zeros((2, 2), np.uint16), np.zeros(8, np.uint8))


@kernel
def _pack(values: NDArray[np.uint16], codes: NDArray[np.uint8], escapes: NDArray[np.uint16]) -> Any:
    """Return the number of escapes; -1 if there are more than `escapes` holds."""
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
