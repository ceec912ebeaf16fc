"""The colour of what a ray meets: filtered look-up in the skins, so that nothing aliases."""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import kernel
from drivers.synthetic.raycast import ROOM, TILE, TUBE, Floats, Indices, closest
from drivers.synthetic.solids import FACE_FLIP, FACE_U, FACE_V

MOST_TAPS = 4
Colour3 = tuple[float, float, float]
Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]


@kernel
def shade(
    rays: Array,
    depth_m: Floats,
    solid: Indices,
    kind: Table,
    frames: Array,
    texels: Bytes,
    levels: Table,
    pixel: float,
) -> tuple[Floats, Indices]:
    """Colour (H, W, 3) of what was cast, and a number (H, W) for each surface met.

    `pixel` is the size of a pixel on the plane z = 1.
    """
    height, width = depth_m.shape
    image = np.zeros((height, width, 3), dtype=np.float32)
    surface = np.empty((height, width), dtype=np.int32)
    for v in range(height):
        for u in range(width):
            s = solid[v, u]
            if s < 0:
                surface[v, u] = -1
                continue
            x, y = rays[v, u, 0], rays[v, u, 1]
            face, b, g, r = colour_at(
                x, y, depth_m[v, u], kind[s], frames[v, s], texels, levels[s], pixel
            )
            image[v, u, 0], image[v, u, 1], image[v, u, 2] = b, g, r
            surface[v, u] = s * 8 + face
    return image, surface


@kernel
def smooth_edges(
    image: Floats,
    surface: Indices,
    rays: Array,
    kind: Table,
    frames: Array,
    candidates: Indices,
    near_m: Array,
    texels: Bytes,
    levels: Table,
    pixel: float,
) -> None:
    """Average four rays in each pixel of `image` where two surfaces meet, in place."""
    height, width = surface.shape
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            here = surface[v, u]
            if (
                here == surface[v, u - 1]
                and here == surface[v, u + 1]
                and here == surface[v - 1, u]
                and here == surface[v + 1, u]
            ):
                continue
            across, down = rays[v, u + 1] - rays[v, u - 1], rays[v + 1, u] - rays[v - 1, u]
            image[v, u] = 0.0
            for i in (-0.125, 0.125):
                for j in (-0.125, 0.125):
                    x = rays[v, u, 0] + i * across[0] + j * down[0]
                    y = rays[v, u, 1] + i * across[1] + j * down[1]
                    t, s = closest(x, y, kind, frames[v], candidates[v // TILE, u // TILE], near_m)
                    if s >= 0:
                        _, b, g, r = colour_at(
                            x, y, t, kind[s], frames[v, s], texels, levels[s], pixel
                        )
                        image[v, u, 0] += 0.25 * b
                        image[v, u, 1] += 0.25 * g
                        image[v, u, 2] += 0.25 * r


@kernel
def colour_at(
    x: float,
    y: float,
    t: float,
    kind: int,
    F: Array,
    texels: Bytes,
    levels: Table,
    pixel: float,
) -> tuple[int, float, float, float]:
    """Face and colour where the ray (x, y, 1) meets a solid at depth t."""
    dx = F[0, 0] * x + F[0, 1] * y + F[0, 2]
    dy = F[1, 0] * x + F[1, 1] * y + F[1, 2]
    dz = F[2, 0] * x + F[2, 1] * y + F[2, 2]
    px, py, pz = F[0, 3] + t * dx, F[1, 3] + t * dy, F[2, 3] + t * dz
    if kind >= TUBE:
        width, height = levels[0, 0, 1], levels[0, 0, 2]
        u = math.atan2(py, px) / (2.0 * math.pi) + 0.5
        scale = math.sqrt(F[0, 0] ** 2 + F[1, 0] ** 2 + F[2, 0] ** 2)
        size = t * pixel * scale * width / (2.0 * math.pi)
        b, g, r = texel(u * width, 0.5 * (1.0 - pz) * height, size, texels, levels[0])
        return 0, b, g, r
    ax, ay, az = abs(px), abs(py), abs(pz)
    axis = 0 if ax >= ay and ax >= az else (1 if ay >= az else 2)
    p, d = (px, py, pz), (dx, dy, dz)
    face = 2 * axis + (1 if p[axis] > 0.0 else 0)
    level = levels[face]
    i, j = FACE_U[axis], FACE_V[axis]
    flip = FACE_FLIP[axis] * (1.0 if p[axis] > 0.0 else -1.0) * (-1.0 if kind == ROOM else 1.0)
    half_w, half_h = 0.5 * flip * level[0, 1], -0.5 * level[0, 2]
    u = 0.5 * level[0, 1] + half_w * p[i]
    w = 0.5 * level[0, 2] + half_h * p[j]
    # How the texel under the ray moves from one pixel to the next, across and down.
    step = t * pixel
    kx, ky = F[axis, 0] / d[axis], F[axis, 1] / d[axis]
    across_u = half_w * step * (F[i, 0] - d[i] * kx)
    across_w = half_h * step * (F[j, 0] - d[j] * kx)
    down_u = half_w * step * (F[i, 1] - d[i] * ky)
    down_w = half_h * step * (F[j, 1] - d[j] * ky)
    b, g, r = texels_along(u, w, across_u, across_w, down_u, down_w, texels, level)
    return face, b, g, r


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
