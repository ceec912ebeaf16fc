"""Depth images of a floor with a box on it, by geometry."""

from dataclasses import replace

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import T_BODY_CAMERA, Array, rigid_transform, so3_exp
from tests.vo_service.fakes import good_estimate
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.types.odometry_update import OdometryUpdate

CAMERA = PinholeCamera(320, 240, 290.0, 290.0, 159.5, 119.5)
MAX_DEPTH_M = 8.0


def mounted(height_m: float, down_deg: float = 0.0, roll_rad: float = 0.0) -> Array:
    """T_base_camera of a camera above the base's origin, which looks down."""
    R = so3_exp([0.0, np.radians(down_deg), 0.0]) @ so3_exp([roll_rad, 0.0, 0.0])
    return rigid_transform(R, (0.0, 0.0, height_m)) @ T_BODY_CAMERA


def frame_of(depth_m: Array, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    """A frame with a depth image (rows, columns) in meters, 0 = no reading."""
    return RgbdFrame(
        seq=0,
        stamp_s=0.0,
        receive_time_s=0.0,
        color_bgr=np.zeros((camera.height, camera.width, 3), np.uint8),
        depth_raw=np.rint(5000.0 * depth_m).astype(np.uint16),
        depth_factor=5000.0,
        camera=camera,
    )


def rays_in_base(T_base_camera: Array) -> Array:
    """(rows, columns, 3) directions whose length along the optical axis is 1."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    x, y = (u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy
    rays: Array = np.stack([x, y, np.ones_like(x)], axis=-1) @ T_base_camera[:3, :3].T
    return rays


def wall_on_floor(
    T_base_camera: Array, wall_m: float, low_m: float = 0.0, high_m: float = 10.0
) -> RgbdFrame:
    """A floor, and a wall across x at a distance between two heights above the floor."""
    rays, (x, _, z) = rays_in_base(T_base_camera), T_base_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_floor = np.where(rays[..., 2] < 0, -z / rays[..., 2], np.inf)
        to_wall = np.where(rays[..., 0] > 0, (wall_m - x) / rays[..., 0], np.inf)
        height = z + to_wall * rays[..., 2]
    to_wall[~((height >= low_m) & (height <= high_m))] = np.inf
    depth = np.minimum(to_floor, to_wall)
    return frame_of(np.where(depth <= MAX_DEPTH_M, depth, 0.0))


def update_of(frame: RgbdFrame, T_base_camera: Array, stamp_s: float) -> OdometryUpdate:
    """The update of a base at the origin of `odom` and of the world."""
    frame = replace(frame, stamp_s=stamp_s)
    estimate = good_estimate(np.eye(4))
    return OdomFrame(T_base_camera).update(StampedFrame(frame, stamp_s), estimate, {}, 0.0)
