"""Color images from the Bayer mosaic of the Kinect, with the pixels that libfreenect computes."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel


def demosaic(mosaic: NDArray[np.uint8], bgr: NDArray[np.uint8]) -> None:
    """Interpolate the colors that the mosaic leaves out.

    Each mean of two is rounded down, and so is a mean of two means. The border is mirrored at the
    outermost pixels.

    Args:
        mosaic: (height, width) of even numbers; rows are green red and blue green by turns.
        bgr: (height, width, 3) the result.
    """
    _demosaic(mosaic, bgr.reshape(len(mosaic), -1))


def extract_mosaic(bgr: NDArray[np.uint8], mosaic: NDArray[np.uint8]) -> bool:
    """Take out the mosaic that an image was computed from.

    Args:
        bgr: (height, width, 3), contiguous.
        mosaic: (height, width) the result; undefined if there is none.

    Returns:
        Whether `demosaic` makes exactly this image of the mosaic.
    """
    height, width = mosaic.shape
    if height % 2 or width % 2:
        return False
    return _extract_mosaic(bgr.reshape(height, -1), mosaic)


@inline_kernel
def _mean(a: int, b: int) -> int:
    return (a + b) >> 1


@kernel
def _demosaic(mosaic: NDArray[np.uint8], bgr: NDArray[np.uint8]) -> None:
    """Fill (height, 3 * width) BGR."""
    columns = np.empty((4, mosaic.shape[1] // 2 + 1), np.uint8)
    for y in range(len(mosaic)):
        _demosaic_row(mosaic, y, columns, bgr[y])


@kernel
def _extract_mosaic(bgr: NDArray[np.uint8], mosaic: NDArray[np.uint8]) -> bool:
    """Fill the mosaic row by row, and compare each finished row with that of the image."""
    height, width = mosaic.shape
    columns = np.empty((4, width // 2 + 1), np.uint8)
    row = np.empty(3 * width, np.uint8)
    for y in range(height + 1):
        if y < height:
            first, second = (1, 5) if y % 2 == 0 else (0, 4)
            for i in range(width // 2):
                mosaic[y, 2 * i] = bgr[y, 6 * i + first]
                mosaic[y, 2 * i + 1] = bgr[y, 6 * i + second]
        if y > 0:  # it needs the row below
            _demosaic_row(mosaic, y - 1, columns, row)
            differs = 0
            for i in range(3 * width):
                differs |= row[i] ^ bgr[y - 1, i]
            if differs:
                return False
    return True


@inline_kernel
def _demosaic_row(
    mosaic: NDArray[np.uint8], y: int, columns: NDArray[np.uint8], bgr: NDArray[np.uint8]
) -> None:
    """Fill a row of the image, (3 * width).

    Even and odd columns have arrays of their own, because the compiler turns only simple loops over
    whole arrays into vector instructions. `left` and `right` are the row's pixels; their first and
    last element is the mirrored one. `above_left` and `above_right` are the means of the pixels
    above and below. All four are rows of `columns`, whose content on entry does not matter.
    """
    height, width = mosaic.shape
    half = width // 2
    left, right, above_left, above_right = columns[0], columns[1], columns[2], columns[3]
    row = mosaic[y]
    above = mosaic[y - 1 if y > 0 else 1]
    below = mosaic[y + 1 if y < height - 1 else height - 2]
    for i in range(half):
        left[i], right[i + 1] = row[2 * i], row[2 * i + 1]
        above_left[i] = _mean(above[2 * i], below[2 * i])
        above_right[i + 1] = _mean(above[2 * i + 1], below[2 * i + 1])
    left[half], above_left[half] = left[half - 1], above_left[half - 1]
    right[0], above_right[0] = right[1], above_right[1]
    if y % 2 == 0:
        _fill_green_red(left, right, above_left, above_right, bgr)
    else:
        _fill_blue_green(left, right, above_left, above_right, bgr)


@inline_kernel
def _fill_green_red(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    above_left: NDArray[np.uint8],
    above_right: NDArray[np.uint8],
    bgr: NDArray[np.uint8],
) -> None:
    for i in range(len(left) - 1):
        bgr[6 * i] = above_left[i]
        bgr[6 * i + 1] = left[i]
        bgr[6 * i + 2] = _mean(right[i], right[i + 1])
        bgr[6 * i + 3] = _mean(above_left[i], above_left[i + 1])
        bgr[6 * i + 4] = _mean(_mean(left[i], left[i + 1]), above_right[i + 1])
        bgr[6 * i + 5] = right[i + 1]


@inline_kernel
def _fill_blue_green(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    above_left: NDArray[np.uint8],
    above_right: NDArray[np.uint8],
    bgr: NDArray[np.uint8],
) -> None:
    for i in range(len(left) - 1):
        bgr[6 * i] = left[i]
        bgr[6 * i + 1] = _mean(_mean(right[i], right[i + 1]), above_left[i])
        bgr[6 * i + 2] = _mean(above_right[i], above_right[i + 1])
        bgr[6 * i + 3] = _mean(left[i], left[i + 1])
        bgr[6 * i + 4] = right[i + 1]
        bgr[6 * i + 5] = above_right[i + 1]
