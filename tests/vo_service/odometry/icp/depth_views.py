"""Depth images whose truth is known, for the tests of ICP: planes, seen from a pose."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, rigid_transform, so3_exp

CAMERA = PinholeCamera(320, 240, 280.0, 280.0, 159.5, 119.5)
DEPTH_FACTOR = 5000.0

# A plane is n . X = d in the world.
Plane = tuple[tuple[float, float, float], float]
WALL: Plane = ((0.1, 0.0, 1.0), 2.2)
FLOOR: Plane = ((0.0, 1.0, 0.1), 0.9)
SIDE: Plane = ((1.0, 0.05, 0.2), 1.0)
ROOM = (WALL, FLOOR, SIDE)


def render_view(
    planes: Sequence[Plane], T_world_camera: Array, seq: int = 0, camera: PinholeCamera = CAMERA
) -> RgbdFrame:
    """The nearest of some planes at every pixel, exact to the sensor's units; without color."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    rays = rays @ T_world_camera[:3, :3].T
    depth_m = np.full(u.shape, np.inf)
    for normal, distance in planes:
        along = rays @ np.array(normal)
        with np.errstate(divide="ignore"):
            z = (distance - np.dot(normal, T_world_camera[:3, 3])) / along
        depth_m = np.where((z > 0) & (z < depth_m), z, depth_m)
    return make_frame(np.where(depth_m < 8.0, depth_m, 0.0), seq, camera)


def make_frame(depth_m: Array, seq: int = 0, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    """A black frame with a depth image."""
    return RgbdFrame(
        seq=seq,
        stamp_s=seq / 30.0,
        receive_time_s=0.0,
        color_bgr=np.zeros((camera.height, camera.width, 3), np.uint8),
        depth_raw=np.rint(depth_m * DEPTH_FACTOR).astype(np.uint16),
        depth_factor=DEPTH_FACTOR,
        camera=camera,
    )


def add_noise(frame: RgbdFrame, seed: int) -> RgbdFrame:
    """The same frame as a Kinect would measure it: noise and steps of 1/z."""
    random = np.random.default_rng(seed)
    depth_m = frame.depth_m.astype(np.float64)
    w = 1.0 / np.maximum(depth_m, 0.1) + random.normal(0.0, 1e-3, depth_m.shape)
    stepped = np.maximum(np.rint(w / 2.87e-3) * 2.87e-3, 0.1)
    return make_frame(np.where(depth_m > 0, 1.0 / stepped, 0.0), frame.seq, frame.camera)


def remove_blocks(frame: RgbdFrame, fraction: float, seed: int) -> RgbdFrame:
    """The same frame with a share of its depth missing, in blocks of 8 by 8 pixels."""
    random = np.random.default_rng(seed)
    height, width = frame.depth_raw.shape
    blocks = random.uniform(size=(height // 8, width // 8)) < fraction
    missing: NDArray[np.bool_] = np.kron(blocks, np.ones((8, 8), np.bool_)).astype(np.bool_)
    return make_frame(np.where(missing, 0.0, frame.depth_m), frame.seq, frame.camera)


def hand_held_pose(k: float) -> Array:
    """Where a hand-held camera is after k frames: 16 mm and 0.6 degrees a frame."""
    turn, shift = np.array([-0.004, 0.008, 0.006]), np.array([0.010, -0.005, 0.011])
    return rigid_transform(so3_exp(k * turn), k * shift)
