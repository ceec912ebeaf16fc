"""The colour of what a ray meets."""

import math

import numpy as np

from drivers.geometry import Array
from drivers.jit import kernel
from drivers.synthetic.raycast import ROOM, TILE, TUBE, Floats, Indices, closest
from drivers.synthetic.sampling import Bytes, Table, texel, texels_along
from drivers.synthetic.solids import FACE_FLIP, FACE_U, FACE_V


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
