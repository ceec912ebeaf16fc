"""Keypoints: 3-D non-maximum suppression and interpolation (Bay et al. 2008, Section 3.4)."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.surf.hessian import SCALE_PER_LOBE, is_laplacian_positive, lobe_margin

# Columns of a keypoint table, float32, one keypoint per row.
X, Y, SCALE, RESPONSE, SIGN = 0, 1, 2, 3, 4
NUM_COLUMNS = 5


def max_num_maxima(rows: int, columns: int) -> int:
    """Largest number of maxima of a layer: no two are neighbors, so one per square of 2x2."""
    return -(-rows // 2) * -(-columns // 2)


@kernel
def find_maxima(
    integral: NDArray[np.int32],
    below: NDArray[np.float32],
    middle: NDArray[np.float32],
    above: NDArray[np.float32],
    lobes: tuple[int, int, int],
    step: int,
    threshold: np.float32,
    table: NDArray[np.float32],
    found: int,
) -> int:
    """Append the maxima of the middle layer to `table` from row `found`; return the new count.

    A maximum is above `threshold` and above its 26 neighbors in space and scale. Its position
    (pixels of the full image) and scale are those of the quadratic fitted to the 27 values.
    The table must have room for `max_num_maxima` of the layer.
    """
    rows, columns = middle.shape
    first = (lobe_margin(lobes[2]) + step - 1) // step + 1
    last_row, last_column = rows - 1 - first, columns - 1 - first
    if last_row < first or last_column < first:
        return found
    # Each row is the maximum of the three layers by column; the three rows are used in turn.
    tallest = np.empty((3, columns), np.float32)
    for row in range(first - 1, first + 1):
        _max_of_three(below[row], middle[row], above[row], tallest[row % 3])
    around = np.zeros(columns, np.float32)
    is_peak = np.zeros((columns + 7) // 8 * 8, np.uint8)
    eight_at_once = is_peak.view(np.uint64)
    for row in range(first, last_row + 1):
        _max_of_three(below[row + 1], middle[row + 1], above[row + 1], tallest[(row + 1) % 3])
        _max_of_three(tallest[0], tallest[1], tallest[2], around)
        _mark_peaks(middle[row], around, threshold, first, last_column, is_peak)
        for word in range(eight_at_once.size):
            if eight_at_once[word] == 0:
                continue
            for column in range(word * 8, word * 8 + 8):
                if is_peak[column] and _is_first_of_equals(below, middle, above, row, column):
                    entry = table[found]
                    if not _interpolate(below, middle, above, lobes, step, row, column, entry):
                        continue
                    positive = is_laplacian_positive(integral, row * step, column * step, lobes[1])
                    entry[SIGN] = 1.0 if positive else -1.0
                    found += 1
    return found


@inline_kernel
def _max_of_three(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    out: NDArray[np.float32],
) -> None:
    """Largest of three rows in every column."""
    for k in range(out.size):
        m = a[k] if a[k] > b[k] else b[k]
        out[k] = m if m > c[k] else c[k]


@inline_kernel
def _mark_peaks(
    values: NDArray[np.float32],
    around: NDArray[np.float32],
    threshold: np.float32,
    first: int,
    last: int,
    is_peak: NDArray[np.uint8],
) -> None:
    """Mark where a value is above the threshold and no smaller than its 26 neighbors."""
    v = values[first:]
    left, here, right = around[first - 1 :], around[first:], around[first + 1 :]
    out = is_peak[first:]
    for k in range(last - first + 1):
        high = v[k] > threshold
        out[k] = high & (v[k] >= left[k]) & (v[k] >= here[k]) & (v[k] >= right[k])


@inline_kernel
def _is_first_of_equals(
    below: NDArray[np.float32],
    middle: NDArray[np.float32],
    above: NDArray[np.float32],
    r: int,
    c: int,
) -> bool:
    """Keep one keypoint of a plateau: strictly above the earlier neighbors."""
    v = middle[r, c]
    if middle[r, c - 1] == v:
        return False
    for k in range(c - 1, c + 2):
        if middle[r - 1, k] == v:
            return False
        for row in range(r - 1, r + 2):
            if below[row, k] == v:
                return False
    return True


@inline_kernel
def _interpolate(
    below: NDArray[np.float32],
    middle: NDArray[np.float32],
    above: NDArray[np.float32],
    lobes: tuple[int, int, int],
    step: int,
    r: int,
    c: int,
    entry: NDArray[np.float32],
) -> bool:
    """Fit a quadratic to the 27 values around a maximum (Brown and Lowe 2002); fill in its peak.

    False if the peak is more than one sample away: then the maximum is no blob.
    """
    v = middle[r, c]
    gx = 0.5 * (middle[r, c + 1] - middle[r, c - 1])
    gy = 0.5 * (middle[r + 1, c] - middle[r - 1, c])
    gs = 0.5 * (above[r, c] - below[r, c])
    hxx = middle[r, c + 1] - 2 * v + middle[r, c - 1]
    hyy = middle[r + 1, c] - 2 * v + middle[r - 1, c]
    hss = above[r, c] - 2 * v + below[r, c]
    hxy = 0.25 * (
        middle[r + 1, c + 1] - middle[r + 1, c - 1] - middle[r - 1, c + 1] + middle[r - 1, c - 1]
    )
    hxs = 0.25 * (above[r, c + 1] - above[r, c - 1] - below[r, c + 1] + below[r, c - 1])
    hys = 0.25 * (above[r + 1, c] - above[r - 1, c] - below[r + 1, c] + below[r - 1, c])
    # Cramer's rule for H (dx, dy, ds) = -g, H symmetric 3x3.
    axx = hyy * hss - hys * hys
    axy = hxs * hys - hxy * hss
    axs = hxy * hys - hxs * hyy
    det = hxx * axx + hxy * axy + hxs * axs
    if det == 0.0:
        return False
    ayy = hxx * hss - hxs * hxs
    ays = hxy * hxs - hxx * hys
    ass = hxx * hyy - hxy * hxy
    dx = -(axx * gx + axy * gy + axs * gs) / det
    dy = -(axy * gx + ayy * gy + ays * gs) / det
    ds = -(axs * gx + ays * gy + ass * gs) / det
    if not (abs(dx) <= 1.0 and abs(dy) <= 1.0 and abs(ds) <= 1.0):
        return False
    lobe_step = (lobes[2] - lobes[1]) if ds > 0 else (lobes[1] - lobes[0])
    entry[X] = (c + dx) * step
    entry[Y] = (r + dy) * step
    entry[SCALE] = SCALE_PER_LOBE * (lobes[1] + ds * lobe_step)
    entry[RESPONSE] = v
    return True
