"""Detection of SURF keypoints: maxima of the Hessian's determinant in scale space.

Bay et al. 2008: box filters on the integral image (Section 3.2), non-maximum suppression and
interpolation (Section 3.4).

A filter is named by its lobe l, an odd number of pixels; its side is 3 l and it approximates
second Gaussian derivatives of sigma 0.4 l. Sums over boxes come from the integral image, so the
cost does not depend on the size of the filter.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel

# Balances Dxy against Dxx and Dyy in det(H) = Dxx Dyy - w Dxy^2 (eq. 3). The paper's 0.9^2 is for
# one common area normalization; 1.2 matches more features at the same precision.
CROSS_WEIGHT = 1.2
# Sigma, in pixels, of the Gaussian that a filter of lobe 1 would approximate: 1.2 for the 9x9.
SCALE_PER_LOBE = 0.4
# Columns of a keypoint table, float32, one keypoint per row.
X, Y, SCALE, RESPONSE, SIGN = 0, 1, 2, 3, 4
NUM_COLUMNS = 5


@inline_kernel
def lobe_margin(lobe: int) -> int:
    """Pixels from a filter's center to its edge; it fits from there inwards."""
    return (3 * lobe) // 2


@kernel
def fill_responses(
    integral: NDArray[np.int32], lobe: int, step: int, response: NDArray[np.float32]
) -> None:
    """Fill in det(H) at every `step`-th pixel; 0 where the filter leaves the image.

    Args:
        integral: (H+1, W+1) int32.
        lobe: Size of the filter.
        step: Distance of the samples, pixels.
        response: (ceil(H/step), ceil(W/step)) float32, out, in gray levels^2, normalized by the
            area of a lobe pair so that one threshold fits all sizes (eq. 3).
    """
    width = integral.shape[1] - 1
    height = integral.shape[0] - 1
    half = lobe_margin(lobe)
    first = (half + step - 1) // step
    last_row = (height - 1 - half) // step
    last_column = (width - 1 - half) // step
    n = last_column - first + 1
    response[:first] = 0
    response[last_row + 1 :] = 0
    if n <= 0:
        response[:] = 0
        return
    response[:, :first] = 0
    response[:, last_column + 1 :] = 0
    band_xx = np.empty(width + 1, np.int32)
    band_yy = np.empty(width + 1, np.int32)
    band_xy = np.empty(width + 1, np.int32)
    for row in range(first, last_row + 1):
        _sum_rows(integral, row * step, lobe, band_xx, band_yy, band_xy)
        c = first * step
        out = response[row, first:]
        if step == 1:
            # A stride known at compile time lets the loop become vector instructions.
            _det_along_row(band_xx, band_yy, band_xy, c, n, 1, lobe, out)
        else:
            _det_along_row(band_xx, band_yy, band_xy, c, n, step, lobe, out)


@inline_kernel
def _sum_rows(
    integral: NDArray[np.int32],
    r: int,
    lobe: int,
    band_xx: NDArray[np.int32],
    band_yy: NDArray[np.int32],
    band_xy: NDArray[np.int32],
) -> None:
    """Combine the integral's rows once for all columns: the vertical half of each box sum."""
    half, center = lobe_margin(lobe), lobe // 2
    x_end, x_start = integral[r + lobe], integral[r - lobe + 1]
    y_end, y_start = integral[r + half + 1], integral[r - half]
    y_mid_end, y_mid_start = integral[r + center + 1], integral[r - center]
    above_end, above_start = integral[r], integral[r - lobe]
    below_end, below_start = integral[r + lobe + 1], integral[r + 1]
    for k in range(band_xx.size):
        band_xx[k] = x_end[k] - x_start[k]
        band_yy[k] = y_end[k] - y_start[k] - np.int32(3) * (y_mid_end[k] - y_mid_start[k])
        band_xy[k] = above_end[k] - above_start[k] - below_end[k] + below_start[k]


@inline_kernel
def _det_along_row(
    band_xx: NDArray[np.int32],
    band_yy: NDArray[np.int32],
    band_xy: NDArray[np.int32],
    c: int,
    n: int,
    step: int,
    lobe: int,
    out: NDArray[np.float32],
) -> None:
    """Finish the box sums of `n` samples along one row from column `c`; combine them to det(H)."""
    half, center = lobe_margin(lobe), lobe // 2
    area = np.float32(1.0 / (lobe * (2 * lobe - 1)))
    x_end, x_start = band_xx[c + half + 1 :], band_xx[c - half :]
    x_mid_end, x_mid_start = band_xx[c + center + 1 :], band_xx[c - center :]
    y_end, y_start = band_yy[c + lobe :], band_yy[c - lobe + 1 :]
    right_end, right_start = band_xy[c + lobe + 1 :], band_xy[c + 1 :]
    left_end, left_start = band_xy[c:], band_xy[c - lobe :]
    weight = np.float32(CROSS_WEIGHT)
    for k in range(n):
        j = k * step
        xx = np.int32(x_end[j] - x_start[j] - np.int32(3) * (x_mid_end[j] - x_mid_start[j]))
        yy = np.int32(y_end[j] - y_start[j])
        xy = np.int32(right_end[j] - right_start[j] - left_end[j] + left_start[j])
        dxx = np.float32(xx) * area
        dyy = np.float32(yy) * area
        dxy = np.float32(xy) * area
        out[k] = dxx * dyy - weight * dxy * dxy


@inline_kernel
def is_laplacian_positive(integral: NDArray[np.int32], r: int, c: int, lobe: int) -> bool:
    """Sign of Dxx + Dyy: dark blobs on bright ground are positive (Section 4.3).

    Args:
        integral: (H+1, W+1) integral image.
        r: Row.
        c: Column.
        lobe: Size of the filter.
    """
    half = lobe_margin(lobe)
    center = lobe // 2
    top, bottom = integral[r - lobe + 1], integral[r + lobe]
    whole = bottom[c + half + 1] - bottom[c - half] - top[c + half + 1] + top[c - half]
    inner = bottom[c + center + 1] - bottom[c - center] - top[c + center + 1] + top[c - center]
    dxx = whole - 3 * inner
    left, right = c - lobe + 1, c + lobe
    tall = (
        integral[r + half + 1, right]
        - integral[r + half + 1, left]
        - integral[r - half, right]
        + integral[r - half, left]
    )
    waist = (
        integral[r + center + 1, right]
        - integral[r + center + 1, left]
        - integral[r - center, right]
        + integral[r - center, left]
    )
    return bool(dxx + tall - 3 * waist > 0)


def max_num_maxima(rows: int, columns: int) -> int:
    """Largest number of maxima of a layer: no two are neighbors, so one per square of 2x2."""
    return -(-rows // 2) * -(-columns // 2)


class LayerTriple(NamedTuple):
    """Three neighboring layers of an octave; maxima are searched in the middle one.

    Attributes:
        below: (h, w) responses of the smaller filter.
        middle: (h, w) responses.
        above: (h, w) responses of the larger filter.
        lobes: Of the three filters.
        step: Distance of the samples, pixels.
    """

    below: NDArray[np.float32]
    middle: NDArray[np.float32]
    above: NDArray[np.float32]
    lobes: tuple[int, int, int]
    step: int


@kernel
def find_maxima(
    integral: NDArray[np.int32],
    layers: LayerTriple,
    threshold: np.float32,
    table: NDArray[np.float32],
    found: int,
) -> int:
    """Append the maxima of the middle layer to `table` from row `found`; return the new count.

    A maximum is above `threshold` and above its 26 neighbors in space and scale. Its position
    (pixels of the full image) and scale are those of the quadratic fitted to the 27 values.
    The table must have room for `max_num_maxima` of the layer.

    Args:
        integral: (H+1, W+1) integral image.
        layers: Three neighboring layers.
        threshold: Smallest response.
        table: (K, 5) keypoints, in and out.
        found: Number of keypoints in the table.
    """
    below, middle, above, lobes, step = layers
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
                if is_peak[column] and _is_first_of_equals(layers, row, column):
                    entry = table[found]
                    if not _interpolate(layers, row, column, entry):
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
def _is_first_of_equals(layers: LayerTriple, r: int, c: int) -> bool:
    """Keep one keypoint of a plateau: strictly above the earlier neighbors."""
    below, middle = layers.below, layers.middle
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
def _interpolate(layers: LayerTriple, r: int, c: int, entry: NDArray[np.float32]) -> bool:
    """Fit a quadratic to the 27 values around a maximum (Brown and Lowe 2002); fill in its peak.

    False if the peak is more than one sample away: then the maximum is no blob.
    """
    below, middle, above, lobes, step = layers
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
