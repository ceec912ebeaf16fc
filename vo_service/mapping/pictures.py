"""Pictures of a map: from above with axes, from a corner of the room, and through the camera."""

import io

import cv2
import numpy as np

from drivers.camera import PinholeCamera
from drivers.geometry import Array, inverse, rigid_transform, transform_points
from vo_service.mapping.mesh import Mesh
from vo_service.mapping.render import Image, Sheet, draw_perspective, draw_sheet

# Pixels of the longer side of a view from above, without its axes.
SHEET_PX = 1100
DOTS_PER_INCH = 110
FAR_VIEW = PinholeCamera(1100, 800, 1200.0, 1200.0, 549.5, 399.5)
# From how high the room is looked into, and the part of the picture that it fills.
LOOK_DOWN_RAD = 0.9
FILLED = 0.94


def top_view(mesh: Mesh, T_level_world: Array, path_m: Array, title: str) -> bytes:
    """PNG, from above: the map, and the camera's path (N, 3) in the world; axes in metres."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    path = transform_points(T_level_world, path_m)
    level_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64))
    sheet = _sheet_around(np.vstack([level_m, path]), T_level_world)
    left, top = sheet.corner_m[0], -sheet.corner_m[1]
    right, bottom = left + sheet.width * sheet.pixel_m, top - sheet.height * sheet.pixel_m
    size_in = np.array([sheet.width, sheet.height]) / DOTS_PER_INCH + [1.2, 1.2]
    figure = Figure(figsize=(size_in[0], size_in[1]), layout="constrained")
    FigureCanvasAgg(figure)
    plot = figure.subplots()
    plot.imshow(draw_sheet(mesh, sheet), extent=(left, right, bottom, top))
    plot.plot(path[:, 0], path[:, 1], color="tab:orange", linewidth=1.5, label="camera's path")
    plot.plot(*path[0, :2], "o", color="tab:orange", label="its first frame")
    plot.set(title=title, xlabel="right (m)", ylabel="forward (m)")
    plot.set_aspect("equal")
    plot.legend(loc="upper right")
    image = io.BytesIO()
    figure.savefig(image, format="png", dpi=DOTS_PER_INCH)
    return image.getvalue()


def _sheet_around(level_m: Array, T_level_world: Array) -> Sheet:
    """A sheet seen from above that holds these points (N, 3)."""
    T_sheet_level = rigid_transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))
    seen_m = transform_points(T_sheet_level, level_m)
    low, high = seen_m.min(axis=0), seen_m.max(axis=0)
    pixel_m = float(max(high[:2] - low[:2])) / SHEET_PX
    width, height = (int(np.ceil(side / pixel_m)) + 1 for side in high[:2] - low[:2])
    return Sheet(T_sheet_level @ T_level_world, (low[0], low[1]), pixel_m, width, height)


def far_view(mesh: Mesh, T_level_world: Array) -> bytes:
    """PNG: into the room from above and behind the first camera; walls in the way are left out."""
    sine, cosine = np.sin(LOOK_DOWN_RAD), np.cos(LOOK_DOWN_RAD)
    R = np.array([[1.0, 0.0, 0.0], [0.0, -sine, -cosine], [0.0, cosine, -sine]])
    turned_m = transform_points(T_level_world, mesh.vertices_m.astype(np.float64)) @ R.T
    centre_m = (turned_m.min(axis=0) + turned_m.max(axis=0)) / 2
    around_m = turned_m - centre_m
    # As near as everything still fits.
    reach = FILLED / 2 * np.array([FAR_VIEW.width / FAR_VIEW.fx, FAR_VIEW.height / FAR_VIEW.fy])
    away_m = float(np.max(np.abs(around_m[:, :2]) / reach - around_m[:, 2:]))
    T_eye_level = rigid_transform(R, np.array([0.0, 0.0, away_m]) - centre_m)
    return _png(draw_perspective(mesh, FAR_VIEW, T_eye_level @ T_level_world))


def camera_view(mesh: Mesh, camera: PinholeCamera, T_world_camera: Array) -> bytes:
    """PNG: what the camera would see of the map from one of its own poses."""
    return _png(draw_perspective(mesh, camera, inverse(T_world_camera)))


def _png(image_rgb: Image) -> bytes:
    return cv2.imencode(".png", np.ascontiguousarray(image_rgb[:, :, ::-1]))[1].tobytes()
