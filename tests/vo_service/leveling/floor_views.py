"""Depth images of a bare floor, for tests."""

import numpy as np
from numpy.typing import NDArray

from drivers.camera import AccelerometerReading, PinholeCamera, RgbdFrame
from drivers.core.geometry import (
    R_BODY_OPTICAL,
    STANDARD_GRAVITY_M_S2,
    Array,
    rigid_transform,
    so3_exp,
)

Depth = NDArray[np.uint16]

CAMERA = PinholeCamera(320, 240, 262.5, 262.5, 159.5, 119.5)
NO_DEPTH = np.zeros((CAMERA.height, CAMERA.width), np.uint16)
MAX_DEPTH_M = 4.0


def mount(height_m: float, down_rad: float = 0.2) -> Array:
    """T_base_camera (4x4) of a camera above the base that looks down."""
    R = so3_exp([0.0, down_rad, 0.0]) @ R_BODY_OPTICAL
    return rigid_transform(R, (0.0, 0.0, height_m))


def floor_depth(up: Array, height_m: float, noise_per_m: float = 0.0, seed: int = 0) -> Depth:
    """Depth (H, W) of a floor with a normal (3,) in camera axes, 0.1 mm a unit."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)])
    inverse_depth = np.tensordot(-np.asarray(up) / height_m, rays, 1)
    inverse_depth += noise_per_m * np.random.default_rng(seed).normal(size=inverse_depth.shape)
    is_near = inverse_depth > 1.0 / MAX_DEPTH_M
    depth_m = np.where(is_near, 1.0 / np.where(is_near, inverse_depth, 1.0), 0.0)
    return np.rint(1e4 * depth_m).astype(np.uint16)


def make_view(
    depth_raw: Depth,
    stamp_s: float = 0.0,
    up: Array | None = None,
    bias_m_s2: Array | None = None,
) -> RgbdFrame:
    """Make a frame with this depth; with `up` (3,), its accelerometer measures it."""
    force = None if up is None else STANDARD_GRAVITY_M_S2 * np.asarray(up)
    if force is not None and bias_m_s2 is not None:
        force = force + bias_m_s2
    x, y, z = (0.0, 0.0, 0.0) if force is None else force.tolist()
    return RgbdFrame(
        seq=round(30 * stamp_s),
        stamp_s=stamp_s,
        receive_time_s=stamp_s,
        color_bgr=np.zeros((CAMERA.height, CAMERA.width, 3), np.uint8),
        depth_raw=depth_raw,
        depth_factor=1e4,
        camera=CAMERA,
        gravity_m_s2=None if force is None else (-x, -y, -z),
        accelerometer=() if force is None else (AccelerometerReading(stamp_s, (x, y, z)),),
    )
