"""Pictures of a map: from above with axes, from a corner of the room, and through the camera."""

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

# Pixels of the longer side of a view from above, without its axes.
MAX_TOP_VIEW_PX = 1100
DOTS_PER_INCH = 110
OVERVIEW_CAMERA = PinholeCamera(1100, 800, 1200.0, 1200.0, 549.5, 399.5)
# From how high the room is looked into, and the part of the picture that it fills.
OVERVIEW_PITCH_RAD = 0.9
OVERVIEW_FILL = 0.94


def render_top_view(mesh: Mesh, T_level_world: Array, trajectory_m: Array, title: str) -> bytes:
    """PNG, from above: the map, and the camera's path (N, 3) in the world; axes in metres."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = transform_points(T_level_world, trajectory_m)
    level_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64))
    sheet = _fit_orthographic_view(np.vstack([level_m, path]), T_level_world)
    left, top = sheet.corner_m[0], -sheet.corner_m[1]
    right, bottom = left + sheet.width * sheet.pixel_m, top - sheet.height * sheet.pixel_m
    size_in = np.array([sheet.width, sheet.height]) / DOTS_PER_INCH + [1.2, 1.2]
    figure = Figure(figsize=(size_in[0], size_in[1]), layout="constrained")
    FigureCanvasAgg(figure)
    plot = figure.subplots()
    plot.imshow(render_orthographic(mesh, sheet), extent=(left, right, bottom, top))
    plot.plot(path[:, 0], path[:, 1], color="tab:orange", linewidth=1.5, label="camera's path")
    plot.plot(*path[0, :2], "o", color="tab:orange", label="its first frame")
    plot.set(title=title, xlabel="right (m)", ylabel="forward (m)")
    plot.set_aspect("equal")
    plot.legend(loc="upper right")
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=DOTS_PER_INCH)
    return image.getvalue()


def _fit_orthographic_view(level_m: Array, T_level_world: Array) -> OrthographicView:
    """A sheet seen from above that holds these points (N, 3)."""
    T_sheet_level = rigid_transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    seen_m = transform_points(T_sheet_level, level_m)
    low, high = seen_m.min(axis=0), seen_m.max(axis=0)
    pixel_m = float(max(high[:2] - low[:2])) / MAX_TOP_VIEW_PX
    width, height = (int(np.ceil(side / pixel_m)) + 1 for side in high[:2] - low[:2])
    return OrthographicView(T_sheet_level @ T_level_world, (low[0], low[1]), pixel_m, width, height)


def render_overview(mesh: Mesh, T_level_world: Array) -> bytes:
    """PNG: into the room from above and behind the first camera; walls in the way are left out."""
    sine, cosine = np.sin(OVERVIEW_PITCH_RAD), np.cos(OVERVIEW_PITCH_RAD)
    R = np.array([[1.0, 0.0, 0.0], [0.0, -sine, -cosine], [0.0, cosine, -sine]])
    turned_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64)) @ R.T
    centre_m = (turned_m.min(axis=0) + turned_m.max(axis=0)) / 2
    around_m = turned_m - centre_m
    # As near as everything still fits.
    reach = (
        OVERVIEW_FILL
        / 2
        * np.array(
            [
                OVERVIEW_CAMERA.width / OVERVIEW_CAMERA.fx,
                OVERVIEW_CAMERA.height / OVERVIEW_CAMERA.fy,
            ]
        )
    )
    away_m = float(np.max(np.abs(around_m[:, :2]) / reach - around_m[:, 2:]))
    T_eye_level = rigid_transform(R, np.array([0.0, 0.0, away_m]) - centre_m)
    return _encode_png(render_perspective(mesh, OVERVIEW_CAMERA, T_eye_level @ T_level_world))


def render_camera_view(mesh: Mesh, camera: PinholeCamera, T_world_camera: Array) -> bytes:
    """PNG: what the camera would see of the map from one of its own poses."""
    return _encode_png(render_perspective(mesh, camera, inverse(T_world_camera)))


def _encode_png(image_rgb: RgbImage) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(image_rgb[:, :, ::-1]))[1].tobytes()
