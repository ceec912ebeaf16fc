"""The color of the surface that a ray hits."""

import math

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic.raytracing.raycast import (
    CYLINDER,
    ROOM,
    Floats,
    Indices,
    cast_ray,
    in_unit_cube,
)
from drivers.synthetic.raytracing.texture_sampling import (
    Bytes,
    Color3,
    Table,
    sample_anisotropic,
    sample_trilinear,
)
from drivers.synthetic.solids import FACE_FLIP, FACE_U_AXIS, FACE_V_AXIS


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
    """Compute the color (H, W, 3) of the cast rays, and a number (H, W) for each surface.

    `depth_m` and `solid` come from `cast_rays`; `pixel` is a pixel's size on the plane z = 1.
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
            face, b, g, r = color_at(
                rays[v, u, 0],
                rays[v, u, 1],
                depth_m[v, u],
                v,
                s,
                kind[s],
                frames,
                texels,
                levels,
                pixel,
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
            across_x = rays[v, u + 1, 0] - rays[v, u - 1, 0]
            across_y = rays[v, u + 1, 1] - rays[v, u - 1, 1]
            down_x = rays[v + 1, u, 0] - rays[v - 1, u, 0]
            down_y = rays[v + 1, u, 1] - rays[v - 1, u, 1]
            image[v, u] = 0.0
            for i in (-0.125, 0.125):
                for j in (-0.125, 0.125):
                    x = rays[v, u, 0] + i * across_x + j * down_x
                    y = rays[v, u, 1] + i * across_y + j * down_y
                    t, s = cast_ray(x, y, v, u, kind, frames, candidates, near_m)
                    if s >= 0:
                        _, b, g, r = color_at(x, y, t, v, s, kind[s], frames, texels, levels, pixel)
                        image[v, u, 0] += 0.25 * b
                        image[v, u, 1] += 0.25 * g
                        image[v, u, 2] += 0.25 * r


@kernel
def color_at(
    x: float,
    y: float,
    t: float,
    v: int,
    s: int,
    kind: int,
    frames: Array,
    texels: Bytes,
    levels: Table,
    pixel: float,
) -> tuple[int, float, float, float]:
    """Face and color where the ray (x, y, 1) of row v hits solid s at depth t."""
    ox, oy, oz, dx, dy, dz = in_unit_cube(x, y, v, s, frames)
    px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
    if kind >= CYLINDER:
        b, g, r = round_surface_color(px, py, pz, t, v, s, frames, texels, levels, pixel)
        return 0, b, g, r
    ax, ay, az = abs(px), abs(py), abs(pz)
    axis = 0 if ax >= ay and ax >= az else (1 if ay >= az else 2)
    p, d = (px, py, pz), (dx, dy, dz)
    outside = p[axis] > 0.0
    face = 2 * axis + (1 if outside else 0)
    wide, high = levels[s, face, 0, 1], levels[s, face, 0, 2]
    i, j = FACE_U_AXIS[axis], FACE_V_AXIS[axis]
    flip = FACE_FLIP[axis] * (1.0 if outside != (kind == ROOM) else -1.0)
    half_w, half_h = 0.5 * flip * wide, -0.5 * high
    # Movement of the texel under the ray from one pixel to the next, across and down.
    step = t * pixel
    kx, ky = frames[v, s, axis, 0] / d[axis], frames[v, s, axis, 1] / d[axis]
    b, g, r = sample_anisotropic(
        0.5 * wide + half_w * p[i],
        0.5 * high + half_h * p[j],
        half_w * step * (frames[v, s, i, 0] - d[i] * kx),
        half_h * step * (frames[v, s, j, 0] - d[j] * kx),
        half_w * step * (frames[v, s, i, 1] - d[i] * ky),
        half_h * step * (frames[v, s, j, 1] - d[j] * ky),
        s,
        face,
        texels,
        levels,
    )
    return face, b, g, r


@kernel
def round_surface_color(
    px: float,
    py: float,
    pz: float,
    t: float,
    v: int,
    s: int,
    frames: Array,
    texels: Bytes,
    levels: Table,
    pixel: float,
) -> Color3:
    """Color of a cylinder or sphere at (px, py, pz) in its unit cube."""
    wide, high = levels[s, 0, 0, 1], levels[s, 0, 0, 2]
    turn = math.atan2(py, px) / (2.0 * math.pi) + 0.5
    scale = math.sqrt(frames[v, s, 0, 0] ** 2 + frames[v, s, 1, 0] ** 2 + frames[v, s, 2, 0] ** 2)
    size = t * pixel * scale * wide / (2.0 * math.pi)
    return sample_trilinear(turn * wide, 0.5 * (1.0 - pz) * high, size, s, 0, texels, levels)
