"""Pictures of a mesh: rendering by rasterization, and views as PNG."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, inverse, rigid_transform, transform_points
from drivers.core.jit import kernel
from drivers.recording.image_encoding import ColorFormat, encode_image
from vo_service.figures import new_figure, render_figure
from vo_service.reconstruction.mesh import Mesh

RgbImage = NDArray[np.uint8]

NEAR_M = 0.05
BACKGROUND = 228
# A surface seen edge-on is darker by this share than one that faces the camera.
EDGE_ON_DARKENING = 0.45
# Each pixel is the mean of this many by this many samples.
SUPERSAMPLING = 2


@dataclass(frozen=True)
class OrthographicView:
    """An orthographic view.

    Attributes:
        T_view_world: 4x4, to x right, y down and z away from the viewer.
        corner_m: (x, y) of the first pixel's center.
        pixel_m: Size of a pixel.
        width: Pixels per row.
        height: Number of rows.
    """

    T_view_world: Array
    corner_m: tuple[float, float]
    pixel_m: float
    width: int
    height: int


def render_perspective(mesh: Mesh, camera: PinholeCamera, T_camera_world: Array) -> RgbImage:
    """Render the view of a camera, without back faces.

    Args:
        T_camera_world: 4x4.

    Returns:
        (H, W, 3) RGB image.
    """
    camera_m = transform_points(T_camera_world, mesh.vertices_m.astype(np.float64))
    depth_m = np.maximum(camera_m[:, 2], 1e-6)
    pixels = np.column_stack(
        [
            camera.fx * camera_m[:, 0] / depth_m + camera.cx,
            camera.fy * camera_m[:, 1] / depth_m + camera.cy,
            1.0 / depth_m,
        ]
    )
    directions = camera_m / np.maximum(np.linalg.norm(camera_m, axis=1, keepdims=True), 1e-9)
    facing = -np.sum((mesh.normals @ T_camera_world[:3, :3].T) * directions, axis=1)
    pixels[camera_m[:, 2] < NEAR_M] = np.nan
    return _render(mesh, pixels, facing, camera.width, camera.height)


def render_orthographic(mesh: Mesh, view: OrthographicView) -> RgbImage:
    """Render an orthographic view, without back faces. Returns a (H, W, 3) RGB image."""
    view_m = transform_points(view.T_view_world, mesh.vertices_m.astype(np.float64))
    pixels = np.column_stack(
        [(view_m[:, :2] - np.array(view.corner_m)) / view.pixel_m, -view_m[:, 2]]
    )
    facing = -mesh.normals @ view.T_view_world[2, :3]
    return _render(mesh, pixels, facing, view.width, view.height)


def _render(mesh: Mesh, pixels: Array, facing: Array, width: int, height: int) -> RgbImage:
    """Shade and rasterize. `pixels` (N, 3) hold column, row and nearness; NaN is not drawn."""
    shading = 1.0 - EDGE_ON_DARKENING * (1.0 - np.clip(facing, 0.0, 1.0))
    colors = mesh.colors_rgb * shading[:, None]
    # The center of the first pixel is the center of its samples.
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
    """Draw the nearest counterclockwise triangle of each pixel.

    Args:
        pixels: (N, 3) column, row and nearness of each vertex, all linear in the image.
        colors: (N, 3) RGB of each vertex.
        triangles: (M, 3) indices of vertices.
        width: Pixels per row.
        height: Number of rows.

    Returns:
        (H, W, 3) RGB image.
    """
    image = np.full((height, width, 3), BACKGROUND, np.uint8)
    nearest = np.full((height, width), -np.inf)
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        ax, ay, bx, by = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1]
        cx, cy = pixels[c, 0], pixels[c, 1]
        # Rows run down, so a triangle that looks counterclockwise has a negative area.
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if not area < 0.0:
            continue
        first_u, last_u = max(0.0, np.ceil(min(ax, bx, cx))), min(width - 1.0, max(ax, bx, cx))
        first_v, last_v = max(0.0, np.ceil(min(ay, by, cy))), min(height - 1.0, max(ay, by, cy))
        for v in range(int(first_v), int(np.floor(last_v)) + 1):
            for u in range(int(first_u), int(np.floor(last_u)) + 1):
                weight_a = ((bx - u) * (cy - v) - (by - v) * (cx - u)) / area
                weight_b = ((cx - u) * (ay - v) - (cy - v) * (ax - u)) / area
                weight_c = 1.0 - weight_a - weight_b
                if weight_a < 0.0 or weight_b < 0.0 or weight_c < 0.0:
                    continue
                near = weight_a * pixels[a, 2] + weight_b * pixels[b, 2] + weight_c * pixels[c, 2]
                if near <= nearest[v, u]:
                    continue
                nearest[v, u] = near
                for channel in range(3):
                    image[v, u, channel] = np.uint8(
                        weight_a * colors[a, channel]
                        + weight_b * colors[b, channel]
                        + weight_c * colors[c, channel]
                        + 0.5
                    )
    return image


# Longer side of a top view, without its axes.
MAX_TOP_VIEW_PX = 1100
DOTS_PER_INCH = 110
OVERVIEW_CAMERA = PinholeCamera(1100, 800, 1200.0, 1200.0, 549.5, 399.5)
# Pitch of the overview, and the share of the image that the room fills.
OVERVIEW_PITCH_RAD = 0.9
OVERVIEW_FILL = 0.94


def render_top_view(mesh: Mesh, T_level_world: Array, trajectory_m: Array, title: str) -> bytes:
    """Render the map from above, with the camera's trajectory and axes in meters.

    Args:
        T_level_world: 4x4 transform to level axes.
        trajectory_m: (N, 3) positions of the camera in the world.

    Returns:
        PNG bytes.
    """
    path = transform_points(T_level_world, trajectory_m)
    level_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64))
    view = _fit_orthographic_view(np.vstack([level_m, path]), T_level_world)
    left, top = view.corner_m[0], -view.corner_m[1]
    right, bottom = left + view.width * view.pixel_m, top - view.height * view.pixel_m
    figure = new_figure(view.width / DOTS_PER_INCH + 1.2, view.height / DOTS_PER_INCH + 1.2)
    plot = figure.subplots()
    plot.imshow(render_orthographic(mesh, view), extent=(left, right, bottom, top))
    plot.plot(path[:, 0], path[:, 1], color="tab:orange", linewidth=1.5, label="trajectory")
    plot.plot(*path[0, :2], "o", color="tab:orange", label="first frame")
    plot.set(title=title, xlabel="right (m)", ylabel="forward (m)")
    plot.set_aspect("equal")
    plot.legend(loc="upper right")
    return render_figure(figure, "png", dpi=DOTS_PER_INCH)


def _fit_orthographic_view(level_m: Array, T_level_world: Array) -> OrthographicView:
    """Fit a view from above to points (N, 3) in level axes."""
    T_view_level = rigid_transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    view_m = transform_points(T_view_level, level_m)
    low, high = view_m.min(axis=0), view_m.max(axis=0)
    pixel_m = float(max(high[:2] - low[:2])) / MAX_TOP_VIEW_PX
    width, height = (int(np.ceil(side / pixel_m)) + 1 for side in high[:2] - low[:2])
    return OrthographicView(T_view_level @ T_level_world, (low[0], low[1]), pixel_m, width, height)


def render_overview(mesh: Mesh, T_level_world: Array) -> bytes:
    """Render the room from above and behind the first camera, without back faces.

    Args:
        T_level_world: 4x4 transform to level axes.

    Returns:
        PNG bytes.
    """
    sine, cosine = np.sin(OVERVIEW_PITCH_RAD), np.cos(OVERVIEW_PITCH_RAD)
    R = np.array([[1.0, 0.0, 0.0], [0.0, -sine, -cosine], [0.0, cosine, -sine]])
    rotated_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64)) @ R.T
    center_m = (rotated_m.min(axis=0) + rotated_m.max(axis=0)) / 2
    centered_m = rotated_m - center_m
    # The least distance at which the whole map is in view.
    camera = OVERVIEW_CAMERA
    tangents = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    half_extent = OVERVIEW_FILL * tangents
    distance_m = float(np.max(np.abs(centered_m[:, :2]) / half_extent - centered_m[:, 2:]))
    T_view_level = rigid_transform(R, np.array([0.0, 0.0, distance_m]) - center_m)
    return _encode_png(render_perspective(mesh, OVERVIEW_CAMERA, T_view_level @ T_level_world))


def render_camera_view(mesh: Mesh, camera: PinholeCamera, T_world_camera: Array) -> bytes:
    """Render the map from one of the camera's own poses, as PNG bytes.

    Args:
        mesh: The mesh, in the world.
        T_world_camera: 4x4 pose of the optical camera, m.
    """
    return _encode_png(render_perspective(mesh, camera, inverse(T_world_camera)))


def _encode_png(image_rgb: RgbImage) -> bytes:
    return encode_image(np.ascontiguousarray(image_rgb[:, :, ::-1]), ColorFormat.PNG)
