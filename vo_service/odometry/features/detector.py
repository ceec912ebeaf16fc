"""Detection of SURF keypoints: maxima of the Hessian's determinant in scale space.

Bay et al. 2008: box filters on the integral image (Section 3.2), non-maximum suppression and
interpolation (Section 3.4).

A filter is named by its lobe l, an odd number of pixels; its side is 3 l and it approximates
second Gaussian derivatives of sigma 0.4 l. Sums over boxes come from the integral image, so the
cost does not depend on the size of the filter.

A layer is the responses of one filter. It is searched row by row, and only three rows are kept,
which stay in the processor's cache. The filters of the layers below and above are evaluated around
the maxima of these rows only.
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


class BoxRows(NamedTuple):
    """Rows of the integral image that bound the boxes of a filter, at one row of the image.

    `x` bounds the lobes of Dxx, `y` all lobes of Dyy, `y_mid` the middle one, `above` and `below`
    those of Dxy; each has (W+1,) int32.
    """

    x_start: NDArray[np.int32]
    x_end: NDArray[np.int32]
    y_start: NDArray[np.int32]
    y_end: NDArray[np.int32]
    y_mid_start: NDArray[np.int32]
    y_mid_end: NDArray[np.int32]
    above_start: NDArray[np.int32]
    above_end: NDArray[np.int32]
    below_start: NDArray[np.int32]
    below_end: NDArray[np.int32]


@inline_kernel
def box_rows(integral: NDArray[np.int32], lobe: int, r: int) -> BoxRows:
    """The bounds of a filter's boxes at image row `r`; the filter must fit there.

    Args:
        integral: (H + 1, W + 1) integral image.
        lobe: Length of a lobe of the filter, pixels.
        r: Row of the image.
    """
    half, center = lobe_margin(lobe), lobe // 2
    return BoxRows(
        integral[r - lobe + 1],
        integral[r + lobe],
        integral[r - half],
        integral[r + half + 1],
        integral[r - center],
        integral[r + center + 1],
        integral[r - lobe],
        integral[r],
        integral[r + 1],
        integral[r + lobe + 1],
    )


class RowSums(NamedTuple):
    """Vertical half of the box sums of one row of the image, by column; scratch of `fill_row`.

    Attributes:
        xx: (W+1,) int32 of Dxx.
        yy: (W+1,) int32 of Dyy, the middle lobe weighted.
        xy: (W+1,) int32 of Dxy, above minus below.
    """

    xx: NDArray[np.int32]
    yy: NDArray[np.int32]
    xy: NDArray[np.int32]


@inline_kernel
def make_row_sums(width: int) -> RowSums:
    """Scratch for an image of this width."""
    return RowSums(
        np.empty(width + 1, np.int32), np.empty(width + 1, np.int32), np.empty(width + 1, np.int32)
    )


@inline_kernel
def fill_row(
    rows: BoxRows, lobe: int, c: int, step: int, sums: RowSums, out: NDArray[np.float32]
) -> None:
    """Fill in det(H) along a row of the image, at every `step`-th pixel from column `c`.

    Args:
        rows: Of the filter.
        lobe: Size of the filter; it must fit at all columns.
        c: First column.
        step: Distance of the samples, pixels.
        sums: Scratch.
        out: (N,) in gray levels^2, normalized by the area of a lobe pair so that one threshold
            fits all sizes (eq. 3).
    """
    _sum_rows(rows, sums)
    if step == 1:
        # A stride known at compile time lets the loop become vector instructions.
        _det_along_row(sums, lobe, c, 1, out)
    else:
        _det_along_row(sums, lobe, c, step, out)


@inline_kernel
def _sum_rows(rows: BoxRows, sums: RowSums) -> None:
    """Combine the integral's rows once for all columns: the vertical half of each box sum."""
    x_start, x_end, y_start, y_end, y_mid_start, y_mid_end = rows[:6]
    above_start, above_end, below_start, below_end = rows[6:]
    xx, yy, xy = sums
    for k in range(xx.size):
        xx[k] = x_end[k] - x_start[k]
        yy[k] = y_end[k] - y_start[k] - np.int32(3) * (y_mid_end[k] - y_mid_start[k])
        xy[k] = above_end[k] - above_start[k] - below_end[k] + below_start[k]


@inline_kernel
def _det_along_row(sums: RowSums, lobe: int, c: int, step: int, out: NDArray[np.float32]) -> None:
    """Finish the box sums of the samples along one row from column `c`; combine them to det(H)."""
    half, center = lobe_margin(lobe), lobe // 2
    x_end, x_start = sums.xx[c + half + 1 :], sums.xx[c - half :]
    x_mid_end, x_mid_start = sums.xx[c + center + 1 :], sums.xx[c - center :]
    y_end, y_start = sums.yy[c + lobe :], sums.yy[c - lobe + 1 :]
    right_end, right_start = sums.xy[c + lobe + 1 :], sums.xy[c + 1 :]
    left_end, left_start = sums.xy[c:], sums.xy[c - lobe :]
    scale = _normalization(lobe)
    for k in range(out.size):
        j = k * step
        xx = np.int32(x_end[j] - x_start[j] - np.int32(3) * (x_mid_end[j] - x_mid_start[j]))
        yy = np.int32(y_end[j] - y_start[j])
        xy = np.int32(right_end[j] - right_start[j] - left_end[j] + left_start[j])
        out[k] = _determinant(xx, yy, xy, scale)


@inline_kernel
def _normalization(lobe: int) -> np.float32:
    """One by the area of a lobe pair."""
    return np.float32(1.0 / (lobe * (2 * lobe - 1)))


@inline_kernel
def _determinant(xx: np.int32, yy: np.int32, xy: np.int32, scale: np.float32) -> np.float32:
    """det(H) of the three box sums (eq. 3)."""
    dxx = np.float32(xx) * scale
    dyy = np.float32(yy) * scale
    dxy = np.float32(xy) * scale
    return dxx * dyy - np.float32(CROSS_WEIGHT) * dxy * dxy


@inline_kernel
def response_at(rows: BoxRows, lobe: int, c: int) -> np.float32:
    """det(H) of one pixel, to the bit that of `fill_row`.

    Args:
        rows: Of `box_rows`, at the pixel's row.
        lobe: Length of a lobe of the filter, pixels.
        c: Column of the pixel.
    """
    xx, yy = straight_sums(rows, lobe, c)
    above = _box(rows.above_start, rows.above_end, c + 1, c + lobe + 1) - _box(
        rows.above_start, rows.above_end, c - lobe, c
    )
    below = _box(rows.below_start, rows.below_end, c + 1, c + lobe + 1) - _box(
        rows.below_start, rows.below_end, c - lobe, c
    )
    return _determinant(xx, yy, np.int32(above - below), _normalization(lobe))


@inline_kernel
def straight_sums(rows: BoxRows, lobe: int, c: int) -> tuple[np.int32, np.int32]:
    """Dxx and Dyy of one pixel, not normalized.

    Args:
        rows: Of `box_rows`, at the pixel's row.
        lobe: Length of a lobe of the filter, pixels.
        c: Column of the pixel.
    """
    half, center = lobe_margin(lobe), lobe // 2
    start, end = c - lobe + 1, c + lobe
    wide = _box(rows.x_start, rows.x_end, c - half, c + half + 1)
    wide_mid = _box(rows.x_start, rows.x_end, c - center, c + center + 1)
    tall = _box(rows.y_start, rows.y_end, start, end)
    tall_mid = _box(rows.y_mid_start, rows.y_mid_end, start, end)
    return np.int32(wide - 3 * wide_mid), np.int32(tall - 3 * tall_mid)


@inline_kernel
def _box(upper: NDArray[np.int32], lower: NDArray[np.int32], start: int, end: int) -> np.int32:
    """Sum of the pixels between two rows and two columns of the integral image."""
    # Unsigned: a signed index would be tested for being negative.
    i, j = np.uint64(start), np.uint64(end)
    return np.int32(lower[j] - lower[i] - upper[j] + upper[i])


@kernel
def is_laplacian_positive(rows: BoxRows, lobe: int, c: int) -> bool:
    """Sign of Dxx + Dyy at one pixel: dark blobs on bright ground are positive (Section 4.3).

    Args:
        rows: Of `box_rows`, at the pixel's row.
        lobe: Length of a lobe of the filter, pixels.
        c: Column of the pixel.
    """
    xx, yy = straight_sums(rows, lobe, c)
    return bool(xx + yy > 0)


class Layer(NamedTuple):
    """One layer of an octave.

    Attributes:
        lobes: Of the filters of the layer below, of the layer itself and of the layer above.
        step: Distance of the samples, pixels.
    """

    lobes: tuple[int, int, int]
    step: int


@kernel
def find_maxima(
    integral: NDArray[np.int32], layer: Layer, threshold: np.float32
) -> NDArray[np.float32]:
    """Find the maxima of a layer, row by row: keypoint table (N, 5).

    A maximum is above `threshold` and above its 26 neighbors in space and scale. Its position
    (pixels of the full image) and scale are those of the quadratic fitted to the 27 values.

    Args:
        integral: (H+1, W+1) integral image.
        threshold: Smallest response.
    """
    lobes, step = layer
    height, width = integral.shape[0] - 1, integral.shape[1] - 1
    # The filter above fits at all neighbors.
    first = (lobe_margin(lobes[2]) + step - 1) // step + 1
    last_row, last_column = (height - 1) // step - first, (width - 1) // step - first
    num_rows, num_columns = max(last_row - first + 1, 0), max(last_column - first + 1, 0)
    # Room for the worst image: no two maxima are neighbors, so one in each 2x2 square.
    table = np.empty((((num_rows + 1) // 2) * ((num_columns + 1) // 2), NUM_COLUMNS), np.float32)
    found = 0
    if table.size == 0:
        return table
    rows = np.empty((3, num_columns + 2), np.float32)  # with a neighbor at each end; used in turn
    sums = make_row_sums(width)
    is_peak = np.zeros((num_columns + 7) // 8 * 8, np.uint8)
    eight_at_once = is_peak.view(np.uint64)
    cube = np.empty((3, 3, 3), np.float32)
    for row in range(first - 1, last_row + 2):
        before, middle, after = rows[(row - 2) % 3], rows[(row - 1) % 3], rows[row % 3]
        bounds = box_rows(integral, lobes[1], row * step)
        fill_row(bounds, lobes[1], (first - 1) * step, step, sums, after)
        if row <= first:
            continue
        _mark_peaks(before, middle, after, threshold, is_peak)
        for word in range(eight_at_once.size):
            if eight_at_once[word] == 0:
                continue
            for k in range(word * 8, word * 8 + 8):
                if not is_peak[k]:
                    continue
                for j in range(3):
                    cube[1, 0, j], cube[1, 1, j] = before[k + j], middle[k + j]
                    cube[1, 2, j] = after[k + j]
                r, c = (row - 1) * step, (first + k) * step
                if not (_is_maximum(integral, layer, r, c, cube) and is_first_of_equals(cube)):
                    continue
                if interpolate(cube, layer, r, c, table[found]):
                    dark = is_laplacian_positive(box_rows(integral, lobes[1], r), lobes[1], c)
                    table[found, SIGN] = 1.0 if dark else -1.0
                    found += 1
    return table[:found].copy()


@inline_kernel
def _mark_peaks(
    before: NDArray[np.float32],
    middle: NDArray[np.float32],
    after: NDArray[np.float32],
    threshold: np.float32,
    is_peak: NDArray[np.uint8],
) -> None:
    """Mark where a row's value is above the threshold and no smaller than its four neighbors."""
    left, here, right = middle, middle[1:], middle[2:]
    upper, lower = before[1:], after[1:]
    for k in range(middle.size - 2):
        v = here[k]
        high = v > threshold
        is_peak[k] = high & (v >= left[k]) & (v >= right[k]) & (v >= upper[k]) & (v >= lower[k])


# The middle one of three neighbors is the most likely to be the largest.
MIDDLE_FIRST = (1, 0, 2)


@inline_kernel
def _is_maximum(
    integral: NDArray[np.int32], layer: Layer, r: int, c: int, cube: NDArray[np.float32]
) -> bool:
    """Whether no value around a sample is larger.

    Args:
        integral: (H+1, W+1) integral image.
        layer: The layer of the sample.
        r: Row of the sample, pixels.
        c: Column of the sample, pixels.
        cube: (3, 3, 3) values around the sample: the middle layer, of which the neighbors in row
            and column are not larger; the layers below and above are filled in, if it is a maximum.
    """
    lobes, step = layer
    v = cube[1, 1, 1]
    if max(cube[1, 0, 0], cube[1, 0, 2], cube[1, 2, 0], cube[1, 2, 2]) > v:
        return False
    for i in MIDDLE_FIRST:
        for k in (0, 2):
            rows = box_rows(integral, lobes[k], r + (i - 1) * step)
            for j in MIDDLE_FIRST:
                value = response_at(rows, lobes[k], c + (j - 1) * step)
                if value > v:
                    return False
                cube[k, i, j] = value
    return True


@kernel
def is_first_of_equals(cube: NDArray[np.float32]) -> bool:
    """Keep one keypoint of a plateau: above the earlier neighbors of 3x3x3 values."""
    v = cube[1, 1, 1]
    if cube[1, 1, 0] == v:
        return False
    for j in range(3):
        if cube[1, 0, j] == v:
            return False
        for i in range(3):
            if cube[0, i, j] == v:
                return False
    return True


@kernel
def interpolate(
    cube: NDArray[np.float32], layer: Layer, r: int, c: int, entry: NDArray[np.float32]
) -> bool:
    """Fit a quadratic to the 27 values around a maximum (Brown and Lowe 2002); fill in its peak.

    Args:
        cube: (3, 3, 3) values around the maximum.
        layer: The layer of the maximum.
        r: Row of the maximum, pixels.
        c: Column of the maximum, pixels.
        entry: (5,) keypoint, out.

    Returns:
        False if the peak is more than one sample away: then the maximum is no blob.
    """
    lobes, step = layer
    below, middle, above = cube[0], cube[1], cube[2]
    v = middle[1, 1]
    gx = 0.5 * (middle[1, 2] - middle[1, 0])
    gy = 0.5 * (middle[2, 1] - middle[0, 1])
    gs = 0.5 * (above[1, 1] - below[1, 1])
    hxx = middle[1, 2] - 2 * v + middle[1, 0]
    hyy = middle[2, 1] - 2 * v + middle[0, 1]
    hss = above[1, 1] - 2 * v + below[1, 1]
    hxy = 0.25 * (middle[2, 2] - middle[2, 0] - middle[0, 2] + middle[0, 0])
    hxs = 0.25 * (above[1, 2] - above[1, 0] - below[1, 2] + below[1, 0])
    hys = 0.25 * (above[2, 1] - above[0, 1] - below[2, 1] + below[0, 1])
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
    entry[X] = c + dx * step
    entry[Y] = r + dy * step
    entry[SCALE] = SCALE_PER_LOBE * (lobes[1] + ds * lobe_step)
    entry[RESPONSE] = v
    return True
