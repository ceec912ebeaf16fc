"""Colors of the cast rays: sampling of the textures, shading, and smooth edges."""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from drivers.synthetic.raycast import CYLINDER, ROOM, Floats, Indices, cast_ray, in_unit_cube
from drivers.synthetic.solids import FACE_FLIP, FACE_U_AXIS, FACE_V_AXIS

MAX_TAPS = 4
Color3 = tuple[float, float, float]
Bytes = NDArray[np.uint8]
Table = NDArray[np.int64]


@kernel
def _sample_anisotropic(
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
        return _sample_trilinear(u, w, longest, s, face, texels, levels)
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
def _sample_trilinear(
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
    """Bilinear sample of level k at (u, w) in its pixels; the first pixel's center is 0.5.

    Args:
        u: Column in pixels of the level.
        w: Row in pixels of the level.
        k: Level of the texture's pyramid.
        levels: (S, F, K, 3) first pixel, width and height of each level.
    """
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

    Args:
        rays: (H, W, 2) x, y of each pixel on the plane z = 1, camera axes.
        depth_m: (H, W) depth from `cast_rays`, m.
        solid: (H, W) index of the solid from `cast_rays`.
        kind: (S,) kind of each solid.
        frames: (H, S, 3, 4), see `cast_rays`.
        levels: (S, F, K, 3), see `sample_bilinear`.
        pixel: Size of a pixel on the plane z = 1.
    """
    height, width = depth_m.shape
    image = np.zeros((height, width, 3), dtype=np.float32)
    surface = np.empty((height, width), dtype=np.int32)
    for v in range(height):
        for u in range(width):
            s = int(np.int64(solid[v, u]))  # types as in `smooth_edges`: one version is compiled
            if s < 0:
                surface[v, u] = -1
                continue
            face, b, g, r = _color_at(
                rays[v, u, 0],
                rays[v, u, 1],
                np.float64(depth_m[v, u]),
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
    """Average four rays in each pixel of `image` where two surfaces meet, in place.

    Args:
        image: (H, W, 3) colors from `shade`; changed in place.
        surface: (H, W) numbers of the surfaces from `shade`.
        candidates: Solids of each tile, see `RaycastScene`.
        near_m: (S,) smallest depth of each solid, m.
    """
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
                        _, b, g, r = _color_at(
                            x, y, t, v, s, kind[s], frames, texels, levels, pixel
                        )
                        image[v, u, 0] += 0.25 * b
                        image[v, u, 1] += 0.25 * g
                        image[v, u, 2] += 0.25 * r


@kernel
def _color_at(
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
        b, g, r = _round_surface_color(px, py, pz, t, v, s, frames, texels, levels, pixel)
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
    b, g, r = _sample_anisotropic(
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
def _round_surface_color(
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
    face = int(np.int64(0))  # a literal would be another type
    return _sample_trilinear(turn * wide, 0.5 * (1.0 - pz) * high, size, s, face, texels, levels)
