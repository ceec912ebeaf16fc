"""Images of a map: top view with axes, overview of the room, and the camera's view."""

import io

import cv2
import numpy as np

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array, inverse, rigid_transform, transform_points
from vo_service.reconstruction.mesh import Mesh
from vo_service.reconstruction.render import (
    OrthographicView,
    RgbImage,
    render_orthographic,
    render_perspective,
)

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
        mesh: The map.
        T_level_world: 4x4 transform to level axes.
        trajectory_m: (N, 3) positions of the camera in the world.
        title: Title of the plot.

    Returns:
        PNG bytes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = transform_points(T_level_world, trajectory_m)
    level_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64))
    view = _fit_orthographic_view(np.vstack([level_m, path]), T_level_world)
    left, top = view.corner_m[0], -view.corner_m[1]
    right, bottom = left + view.width * view.pixel_m, top - view.height * view.pixel_m
    size_in = np.array([view.width, view.height]) / DOTS_PER_INCH + [1.2, 1.2]
    figure = Figure(figsize=(size_in[0], size_in[1]), layout="constrained")
    FigureCanvasAgg(figure)
    plot = figure.subplots()
    plot.imshow(render_orthographic(mesh, view), extent=(left, right, bottom, top))
    plot.plot(path[:, 0], path[:, 1], color="tab:orange", linewidth=1.5, label="trajectory")
    plot.plot(*path[0, :2], "o", color="tab:orange", label="first frame")
    plot.set(title=title, xlabel="right (m)", ylabel="forward (m)")
    plot.set_aspect("equal")
    plot.legend(loc="upper right")
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=DOTS_PER_INCH)
    return image.getvalue()


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
        mesh: The map.
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
    half_extent = (
        OVERVIEW_FILL
        / 2
        * np.array(
            [
                OVERVIEW_CAMERA.width / OVERVIEW_CAMERA.fx,
                OVERVIEW_CAMERA.height / OVERVIEW_CAMERA.fy,
            ]
        )
    )
    distance_m = float(np.max(np.abs(centered_m[:, :2]) / half_extent - centered_m[:, 2:]))
    T_view_level = rigid_transform(R, np.array([0.0, 0.0, distance_m]) - center_m)
    return _encode_png(render_perspective(mesh, OVERVIEW_CAMERA, T_view_level @ T_level_world))


def render_camera_view(mesh: Mesh, camera: PinholeCamera, T_world_camera: Array) -> bytes:
    """Render the map from one of the camera's own poses, as PNG bytes."""
    return _encode_png(render_perspective(mesh, camera, inverse(T_world_camera)))


def _encode_png(image_rgb: RgbImage) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(image_rgb[:, :, ::-1]))[1].tobytes()
