"""Filtered lookup in a texture with mip levels, without aliasing."""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import kernel

MAX_TAPS = 4
Color3 = tuple[float, float, float]
Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]


@kernel
def sample_anisotropic(
    u: float,
    w: float,
    across_u: float,
    across_w: float,
    down_u: float,
    down_w: float,
    s: int,
    face: int,
    texels: Bytes,
    levels: Table,
) -> Color3:
    """Average over a pixel's footprint: samples along its longer side, as wide as its shorter."""
    across = math.sqrt(across_u * across_u + across_w * across_w)
    down = math.sqrt(down_u * down_u + down_w * down_w)
    long_u, long_w, longest = (
        (across_u, across_w, across) if across >= down else (down_u, down_w, down)
    )
    area = abs(across_u * down_w - across_w * down_u)
    breadth = area / max(longest, 1e-9)
    taps = min(MAX_TAPS, int(longest / max(breadth, 1e-9) + 0.5))
    if taps <= 1:
        return sample_trilinear(u, w, longest, s, face, texels, levels)
    # One level is enough: the samples overlap, which hides the step to the next level.
    k = int(mip_level(max(breadth, longest / taps), levels.shape[2]) + 0.5)
    scale_u = levels[s, face, k, 1] / levels[s, face, 0, 1]
    scale_w = levels[s, face, k, 2] / levels[s, face, 0, 2]
    step_u, step_w = long_u * scale_u / taps, long_w * scale_w / taps
    x, y = u * scale_u - 0.5 * (taps - 1) * step_u, w * scale_w - 0.5 * (taps - 1) * step_w
    b, g, r = 0.0, 0.0, 0.0
    for _ in range(taps):
        tb, tg, tr = sample_bilinear(x, y, s, face, k, texels, levels)
        b, g, r = b + tb, g + tg, r + tr
        x, y = x + step_u, y + step_w
    return b / taps, g / taps, r / taps


@kernel
def sample_trilinear(
    u: float, w: float, size: float, s: int, face: int, texels: Bytes, levels: Table
) -> Color3:
    """Trilinear sample at (u, w), in pixels of level 0, of a footprint `size` pixels wide."""
    lod = mip_level(size, levels.shape[2])
    k = int(lod)
    part = lod - k
    x, y = u / levels[s, face, 0, 1], w / levels[s, face, 0, 2]
    wide, high = levels[s, face, k, 1], levels[s, face, k, 2]
    b, g, r = sample_bilinear(x * wide, y * high, s, face, k, texels, levels)
    if part < 0.02:
        return b, g, r
    wide, high = levels[s, face, k + 1, 1], levels[s, face, k + 1, 2]
    cb, cg, cr = sample_bilinear(x * wide, y * high, s, face, k + 1, texels, levels)
    return b + part * (cb - b), g + part * (cg - g), r + part * (cr - r)


@kernel
def mip_level(size: float, levels: int) -> float:
    """Fractional mip level whose texels are `size` texels of level 0 wide."""
    return min(max(math.log2(max(size, 1e-6)), 0.0), levels - 1.001)


@kernel
def sample_bilinear(
    u: float, w: float, s: int, face: int, k: int, texels: Bytes, levels: Table
) -> Color3:
    """Bilinear sample of level k at (u, w) in its pixels; the first pixel's center is 0.5."""
    first, width, height = levels[s, face, k, 0], levels[s, face, k, 1], levels[s, face, k, 2]
    x = min(max(u - 0.5, 0.0), width - 1.0)
    y = min(max(w - 0.5, 0.0), height - 1.0)
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    right = 1 if column + 1 < width else 0
    below = width if row + 1 < height else 0
    # Unsigned indices save the compiler the check for negative ones.
    i = np.uint64(first + row * width + column)
    j, m, n = i + np.uint64(right), i + np.uint64(below), i + np.uint64(right + below)
    a, b, c, d = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    return (
        a * texels[i, 0] + b * texels[j, 0] + c * texels[m, 0] + d * texels[n, 0],
        a * texels[i, 1] + b * texels[j, 1] + c * texels[m, 1] + d * texels[n, 1],
        a * texels[i, 2] + b * texels[j, 2] + c * texels[m, 2] + d * texels[n, 2],
    )
