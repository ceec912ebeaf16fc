"""The box filters of SURF written out pixel by pixel (Bay et al. 2008, Figure 2), no integral."""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from drivers.core.geometry import Array


def vertical_filter(lobe: int) -> NDArray[np.int64]:
    """Dyy: three lobes one below the other with weights 1, -2, 1, each 2 lobe - 1 wide."""
    kernel = np.zeros((3 * lobe, 3 * lobe), np.int64)
    columns = slice((lobe + 1) // 2, (lobe + 1) // 2 + 2 * lobe - 1)
    kernel[:, columns] = np.repeat([1, -2, 1], lobe)[:, None]
    return kernel


def cross_filter(lobe: int) -> NDArray[np.int64]:
    """Dxy: four square lobes, one pixel from each other."""
    kernel = np.zeros((3 * lobe, 3 * lobe), np.int64)
    middle = 3 * lobe // 2
    for rows, down in ((slice(middle - lobe, middle), -1), (slice(middle + 1, None), 1)):
        for columns, right in ((slice(middle - lobe, middle), -1), (slice(middle + 1, None), 1)):
            kernel[rows, columns][:lobe, :lobe] = down * right
    return kernel


def apply_filter(image: NDArray[np.uint8], kernel: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sums of pixel times weight, where the kernel fits."""
    windows = sliding_window_view(image.astype(np.int64), kernel.shape)
    sums: NDArray[np.int64] = np.einsum("rcij,ij->rc", windows, kernel)
    return sums


def hessian_products(image: NDArray[np.uint8], lobe: int) -> tuple[Array, Array]:
    """Dxx Dyy and Dxy^2 of the whole image, normalized by a lobe pair's area; 0 at the border."""
    area = lobe * (2 * lobe - 1)
    tall = vertical_filter(lobe)
    xx, yy = apply_filter(image, tall.T) / area, apply_filter(image, tall) / area
    xy = apply_filter(image, cross_filter(lobe)) / area
    border = 3 * lobe // 2
    return np.pad(xx * yy, border), np.pad(xy * xy, border)
