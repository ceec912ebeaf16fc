"""Noise of a gray image, measured where it is smooth.

In the dark a camera amplifies its noise, whose gradients look like texture: of 25 pixels, the
steepest one has 2.5 times the gradient of the noise.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel

# The image is divided into blocks of this size; a quarter of them is taken to be smooth.
BLOCK_PX = 8
SMOOTH_SHARE = 0.25
# Mean absolute second difference, (1, -2, 1), of white noise with sigma 1: 2 sqrt(3 / pi).
MEAN_SECOND_DIFFERENCE = 1.954


@kernel
def measure_brightness_noise(gray: NDArray[np.uint8]) -> float:
    """Sigma of a pixel's brightness in a gray image (h, w), gray levels; 0 of a tiny image.

    Immerkaer, "Fast Noise Variance Estimation" (CVIU 64, 1996), along the rows of smooth blocks.
    """
    height, width = gray.shape
    rows, columns = height // BLOCK_PX, (width - 2) // BLOCK_PX
    if rows <= 0 or columns <= 0:
        return 0.0
    sums = np.zeros((rows, columns), np.int32)
    for v in range(rows * BLOCK_PX):
        row = gray[v]
        for j in range(columns):
            total = np.int32(0)
            for u in range(j * BLOCK_PX + 1, (j + 1) * BLOCK_PX + 1):
                total += abs(np.int32(row[u - 1]) - 2 * np.int32(row[u]) + np.int32(row[u + 1]))
            sums[v // BLOCK_PX, j] += total
    smooth = np.sort(sums.ravel())[int(SMOOTH_SHARE * sums.size)]
    return float(smooth / (BLOCK_PX * BLOCK_PX * MEAN_SECOND_DIFFERENCE))
