"""Dominant direction of a keypoint's neighborhood (Bay et al. 2008, Section 4.1)."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel

RADIUS = 6  # Haar responses within 6 s of the keypoint
GRID_SIDE = 2 * RADIUS + 3  # samples per side: the responses and a margin of one
NUM_BINS = 72  # of 5 degrees
WINDOW_BINS = NUM_BINS // 6  # a sliding window of 60 degrees


def disc_weights() -> NDArray[np.float32]:
    """(13 * 13,) Gaussian of 2.5 s about the keypoint, zero beyond 6 s."""
    offsets = np.arange(-RADIUS, RADIUS + 1)
    squared = offsets[:, None] ** 2 + offsets[None, :] ** 2
    weights = np.exp(-squared / (2 * 2.5**2)) * (squared <= RADIUS**2)
    return weights.astype(np.float32).ravel()


@inline_kernel
def dominant_direction(
    gray: NDArray[np.float32],
    weights: NDArray[np.float32],
    dxs: NDArray[np.float32],
    dys: NDArray[np.float32],
    bins: NDArray[np.int32],
) -> tuple[np.float32, np.float32]:
    """(cos, sin) of the longest sum of Haar responses in any 60-degree window.

    gray (15 * 15,) has samples at the keypoint's spacing; dxs, dys and bins are scratch of at least
    13 * 13.
    """
    side = 2 * RADIUS + 1
    sum_x = np.zeros(NUM_BINS, np.float32)
    sum_y = np.zeros(NUM_BINS, np.float32)
    square = gray.reshape((GRID_SIDE, GRID_SIDE))
    for i in range(side):
        for j in range(side):
            k = i * side + j
            dxs[k] = weights[k] * (square[i + 1, j + 2] - square[i + 1, j])
            dys[k] = weights[k] * (square[i + 2, j + 1] - square[i, j + 1])
    for k in range(side * side):
        bins[k] = _direction_bin(dxs[k], dys[k])
    for k in range(side * side):
        sum_x[bins[k]] += dxs[k]
        sum_y[bins[k]] += dys[k]
    return _find_longest_window(sum_x, sum_y)


@inline_kernel
def _direction_bin(dx: np.float32, dy: np.float32) -> np.int32:
    """Bin of the angle of (dx, dy); a polynomial without branches, accurate to 0.3 degrees."""
    ax, ay = abs(dx), abs(dy)
    small = ax if ax < ay else ay
    large = ax if ax > ay else ay
    a = small / (large + np.float32(1e-20))
    s = a * a
    angle = (
        (np.float32(-0.0464964749) * s + np.float32(0.15931422)) * s - np.float32(0.327622764)
    ) * s * a + a
    angle = np.float32(np.pi / 2) - angle if ay > ax else angle
    angle = np.float32(np.pi) - angle if dx < 0 else angle
    angle = np.float32(2 * np.pi) - angle if dy < 0 else angle
    direction = np.int32(angle * np.float32(NUM_BINS / (2 * np.pi)))
    return direction if direction < NUM_BINS else np.int32(NUM_BINS - 1)


@inline_kernel
def _find_longest_window(
    sum_x: NDArray[np.float32], sum_y: NDArray[np.float32]
) -> tuple[np.float32, np.float32]:
    wx = np.float32(0.0)
    wy = np.float32(0.0)
    for k in range(WINDOW_BINS):
        wx += sum_x[k]
        wy += sum_y[k]
    best_x, best_y, best = wx, wy, wx * wx + wy * wy
    for k in range(1, NUM_BINS):
        last = (k + WINDOW_BINS - 1) % NUM_BINS
        wx += sum_x[last] - sum_x[k - 1]
        wy += sum_y[last] - sum_y[k - 1]
        length = wx * wx + wy * wy
        if length > best:
            best_x, best_y, best = wx, wy, length
    if best <= 0.0:
        return np.float32(1.0), np.float32(0.0)
    norm = np.float32(np.sqrt(best))
    return best_x / norm, best_y / norm
