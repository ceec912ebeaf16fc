"""Determinant of the Hessian by box filters (Bay et al. 2008, Section 3.2).

A filter is named by its lobe l, an odd number of pixels; its side is 3 l and it approximates
second Gaussian derivatives of sigma 0.4 l. Sums over boxes come from the integral image, so the
cost does not depend on the size of the filter.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel

# Balances Dxy against Dxx and Dyy in det(H) = Dxx Dyy - w Dxy^2 (eq. 3). The paper's 0.9^2 is for
# one common area normalization; 1.2 matches more features at the same precision.
CROSS_WEIGHT = 1.2

# Sigma, in pixels, of the Gaussian that a filter of lobe 1 would approximate: 1.2 for the 9x9.
SCALE_PER_LOBE = 0.4


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
    center = lobe // 2
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
    area = np.float32(1.0 / (lobe * (2 * lobe - 1)))
    for row in range(first, last_row + 1):
        _sum_rows(integral, row * step, lobe, half, center, band_xx, band_yy, band_xy)
        c = first * step
        out = response[row, first:]
        if step == 1:
            # A stride known at compile time lets the loop become vector instructions.
            _det_along_row(band_xx, band_yy, band_xy, c, n, 1, lobe, half, center, area, out)
        else:
            _det_along_row(band_xx, band_yy, band_xy, c, n, step, lobe, half, center, area, out)


@inline_kernel
def _sum_rows(
    integral: NDArray[np.int32],
    r: int,
    lobe: int,
    half: int,
    center: int,
    band_xx: NDArray[np.int32],
    band_yy: NDArray[np.int32],
    band_xy: NDArray[np.int32],
) -> None:
    """Combine the integral's rows once for all columns: the vertical half of each box sum."""
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
    half: int,
    center: int,
    area: np.float32,
    out: NDArray[np.float32],
) -> None:
    """Finish the box sums along one row and combine them to det(H)."""
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
    """Sign of Dxx + Dyy: dark blobs on bright ground are positive (Section 4.3)."""
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
