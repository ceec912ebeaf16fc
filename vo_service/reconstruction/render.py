"""Pictures of a mesh, drawn triangle by triangle into a depth buffer, without a graphics card."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, transform_points
from drivers.core.jit import kernel
from vo_service.reconstruction.mesh import Mesh

RgbImage = NDArray[np.uint8]

NEAR_M = 0.05
BACKGROUND = 228
# What is seen edge-on is this much darker than what faces the eye.
EDGE_ON_DARKENING = 0.45
# Pixels are averages of so many by so many.
SUPERSAMPLING = 2


@dataclass(frozen=True)
class OrthographicView:
    """An orthographic picture: `T_view_world` maps to x right, y down and z away from the eye.

    The first pixel's centre is at `corner_m` (x, y); `pixel_m` is the size of a pixel.
    """

    T_view_world: Array
    corner_m: tuple[float, float]
    pixel_m: float
    width: int
    height: int


def render_perspective(mesh: Mesh, camera: PinholeCamera, T_camera_world: Array) -> RgbImage:
    """(H, W, 3) RGB: what a camera there would see. What is seen from behind is left out."""
    seen_m = transform_points(T_camera_world, mesh.vertices_m.astype(np.float64))
    depth_m = np.maximum(seen_m[:, 2], 1e-6)
    pixels = np.column_stack(
        [
            camera.fx * seen_m[:, 0] / depth_m + camera.cx,
            camera.fy * seen_m[:, 1] / depth_m + camera.cy,
            1.0 / depth_m,
        ]
    )
    directions = seen_m / np.maximum(np.linalg.norm(seen_m, axis=1, keepdims=True), 1e-9)
    facing = -np.sum((mesh.normals @ T_camera_world[:3, :3].T) * directions, axis=1)
    pixels[seen_m[:, 2] < NEAR_M] = np.nan
    return _render(mesh, pixels, facing, camera.width, camera.height)


def render_orthographic(mesh: Mesh, view: OrthographicView) -> RgbImage:
    """(H, W, 3) RGB, without perspective. What is seen from behind is left out."""
    seen_m = transform_points(view.T_view_world, mesh.vertices_m.astype(np.float64))
    pixels = np.column_stack(
        [(seen_m[:, :2] - np.array(view.corner_m)) / view.pixel_m, -seen_m[:, 2]]
    )
    facing = -mesh.normals @ view.T_view_world[2, :3]
    return _render(mesh, pixels, facing, view.width, view.height)


def _render(mesh: Mesh, pixels: Array, facing: Array, width: int, height: int) -> RgbImage:
    """`pixels` (N, 3) are column, row, and how near: greater is nearer; NaN is not drawn."""
    light = 1.0 - EDGE_ON_DARKENING * (1.0 - np.clip(facing, 0.0, 1.0))
    colors = mesh.colors_rgb * light[:, None]
    # The centre of the first pixel is that of SAMPLES x SAMPLES finer ones.
    pixels = pixels * [SUPERSAMPLING, SUPERSAMPLING, 1.0] + [
        (SUPERSAMPLING - 1) / 2,
        (SUPERSAMPLING - 1) / 2,
        0.0,
    ]
    fine = rasterize(pixels, colors, mesh.triangles, SUPERSAMPLING * width, SUPERSAMPLING * height)
    coarse: Array = fine.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3).mean(axis=(1, 3))
    return np.rint(coarse).astype(np.uint8)


@kernel
def rasterize(
    pixels: Array, colors: Array, triangles: NDArray[np.int32], width: int, height: int
) -> RgbImage:
    """(H, W, 3): the nearest triangle of each pixel, of those that turn counter-clockwise.

    pixels   (N, 3) column, row and nearness of every vertex, all linear in the image
    colors  (N, 3)
    """
    image = np.full((height, width, 3), BACKGROUND, np.uint8)
    nearest = np.full((height, width), -np.inf)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1]
        cx, cy = pixels[c, 0], pixels[c, 1]
        # Rows run down: what turns counter-clockwise for the eye has a negative area here.
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if not area < 0.0:
            continue
        first_u, last_u = max(0.0, np.ceil(min(ax, bx, cx))), min(width - 1.0, max(ax, bx, cx))
        first_v, last_v = max(0.0, np.ceil(min(ay, by, cy))), min(height - 1.0, max(ay, by, cy))
        for v in range(int(first_v), int(np.floor(last_v)) + 1):
            for u in range(int(first_u), int(np.floor(last_u)) + 1):
                of_a = ((bx - u) * (cy - v) - (by - v) * (cx - u)) / area
                of_b = ((cx - u) * (ay - v) - (cy - v) * (ax - u)) / area
                of_c = 1.0 - of_a - of_b
                if of_a < 0.0 or of_b < 0.0 or of_c < 0.0:
                    continue
                near = of_a * pixels[a, 2] + of_b * pixels[b, 2] + of_c * pixels[c, 2]
                if near <= nearest[v, u]:
                    continue
                nearest[v, u] = near
                for channel in range(3):
                    image[v, u, channel] = np.uint8(
                        of_a * colors[a, channel]
                        + of_b * colors[b, channel]
                        + of_c * colors[c, channel]
                        + 0.5
                    )
    return image
