"""Filtered look-up in a skin with mip levels, so that nothing aliases."""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.jit import kernel

MOST_TAPS = 4
Colour3 = tuple[float, float, float]
Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]


@kernel
def texels_along(
    u: float,
    w: float,
    across_u: float,
    across_w: float,
    down_u: float,
    down_w: float,
    texels: Bytes,
    level: Table,
) -> Colour3:
    """Mean over a pixel's footprint: samples along its longer side, as broad as its shorter."""
    across = math.sqrt(across_u * across_u + across_w * across_w)
    down = math.sqrt(down_u * down_u + down_w * down_w)
    long_u, long_w, longest = (
        (across_u, across_w, across) if across >= down else (down_u, down_w, down)
    )
    area = abs(across_u * down_w - across_w * down_u)
    breadth = area / max(longest, 1e-9)
    taps = min(MOST_TAPS, int(longest / max(breadth, 1e-9) + 0.5))
    if taps <= 1:
        return texel(u, w, longest, texels, level)
    lod = level_of(max(breadth, longest / taps), level)
    b, g, r = 0.0, 0.0, 0.0
    for i in range(taps):
        along = (i + 0.5) / taps - 0.5
        # One level will do: the taps overlap, which hides the step to the next.
        tb, tg, tr = bilinear(u + along * long_u, w + along * long_w, texels, level, int(lod + 0.5))
        b, g, r = b + tb, g + tg, r + tr
    return b / taps, g / taps, r / taps


@kernel
def texel(u: float, w: float, size: float, texels: Bytes, level: Table) -> Colour3:
    """Trilinear sample at (u, w), in pixels of level 0, of a footprint `size` pixels wide."""
    lod = level_of(size, level)
    k = int(lod)
    part = lod - k
    b, g, r = bilinear(u, w, texels, level, k)
    if part < 0.02:
        return b, g, r
    cb, cg, cr = bilinear(u, w, texels, level, k + 1)
    return b + part * (cb - b), g + part * (cg - g), r + part * (cr - r)


@kernel
def level_of(size: float, level: Table) -> float:
    """Mip level, with a fraction, whose texels are `size` texels of level 0 wide."""
    return min(max(math.log2(max(size, 1e-6)), 0.0), len(level) - 1.001)


@kernel
def bilinear(u: float, w: float, texels: Bytes, level: Table, k: int) -> Colour3:
    """Sample of one level; (u, w) in pixels of level 0, whose first pixel's centre is 0.5."""
    first, width, height = level[k, 0], level[k, 1], level[k, 2]
    x = min(max(u * width / level[0, 1] - 0.5, 0.0), width - 1.0)
    y = min(max(w * height / level[0, 2] - 0.5, 0.0), height - 1.0)
    column, row = int(x), int(y)
    fx, fy = x - column, y - row
    a = first + row * width + column
    right = 1 if column + 1 < width else 0
    c = a + (width if row + 1 < height else 0)
    p, q, m, n = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    return (
        p * texels[a, 0] + q * texels[a + right, 0] + m * texels[c, 0] + n * texels[c + right, 0],
        p * texels[a, 1] + q * texels[a + right, 1] + m * texels[c, 1] + n * texels[c + right, 1],
        p * texels[a, 2] + q * texels[a + right, 2] + m * texels[c, 2] + n * texels[c + right, 2],
    )
