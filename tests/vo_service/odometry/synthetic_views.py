"""Rendered images and frames with ground truth."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
from hypothesis import settings
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array

# A kernel may have to be compiled before its first call returns.
FIRST_CALL_COMPILES = settings(deadline=None)

CAMERA = PinholeCamera(320, 240, 290.0, 290.0, 159.5, 119.5)
DEPTH_FACTOR = 5000.0

# Planes n.X = d in the world, and how many pixels of texture lie on a meter.
WALL = (np.array([0.25, 0.1, 1.0]), 2.4)
FLOOR = (np.array([0.0, 1.0, 0.35]), 1.25)
TEXELS_PER_M = 130.0


def make_textured_image(height: int, width: int, seed: int = 0) -> NDArray[np.uint8]:
    """Blobs, corners and grain of many sizes."""
    random = np.random.default_rng(seed)
    image = np.full((height, width), 128.0, np.float32)
    for sigma in (1.5, 3.0, 6.0, 12.0):
        noise = random.normal(size=(height, width)).astype(np.float32)
        image += cv2.GaussianBlur(noise, (0, 0), sigma) * np.float32(45.0 * sigma)
    for _ in range(height * width // 1500):
        x, y = int(random.integers(width)), int(random.integers(height))
        w, h = random.integers(4, 30, 2)
        cv2.rectangle(image, (x, y), (x + int(w), y + int(h)), float(random.integers(256)), -1)
    blurred = cv2.GaussianBlur(image, (0, 0), 0.8)
    return np.clip(np.rint(blurred), 0, 255).astype(np.uint8)


def make_blob_image(
    height: int, width: int, center_px: tuple[float, float], sigma_px: float, dark: bool = False
) -> NDArray[np.uint8]:
    """One Gaussian blob on flat ground, bright unless dark."""
    y, x = np.mgrid[:height, :width]
    squared = (x - center_px[0]) ** 2 + (y - center_px[1]) ** 2
    blob = 40 + 180 * np.exp(-squared / (2 * sigma_px**2))
    image: NDArray[np.uint8] = np.rint(255 - blob if dark else blob).astype(np.uint8)
    return image


def make_frame(
    gray: NDArray[np.uint8], depth_m: Array, seq: int = 0, camera: PinholeCamera = CAMERA
) -> RgbdFrame:
    """A frame of a gray image and its depth."""
    return RgbdFrame(
        seq=seq,
        stamp_s=seq / 30.0,
        receive_time_s=0.0,
        color_bgr=np.repeat(gray[:, :, None], 3, axis=2),
        depth_raw=np.rint(depth_m * DEPTH_FACTOR).astype(np.uint16),
        depth_factor=DEPTH_FACTOR,
        camera=camera,
    )


def render_corner(T_world_camera: Array, seq: int = 0, camera: PinholeCamera = CAMERA) -> RgbdFrame:
    """A textured wall above a textured floor, seen from a pose, with exact depth."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    R, origin = T_world_camera[:3, :3], T_world_camera[:3, 3]

    def along_rays(direction: Array) -> Array:
        """(H, W) component of the rays, whose z in the camera is 1."""
        on_x, on_y, on_z = direction @ R
        return np.asarray(on_x * x + (on_y * y + on_z)[:, None])

    depth_m = np.full((camera.height, camera.width), np.inf)
    gray = np.zeros(depth_m.shape, np.uint8)
    for seed, (normal, distance) in enumerate((WALL, FLOOR)):
        with np.errstate(divide="ignore"):
            z = (distance - normal @ origin) / along_rays(normal)
        z[z <= 0] = np.inf
        is_seen = z < depth_m
        depth_m[is_seen] = z[is_seen]
        z[~is_seen] = 0.0
        along = np.cross(normal, [0.3, 0.5, 1.0])
        along /= np.linalg.norm(along)
        across = np.cross(normal, along) / np.linalg.norm(normal)
        column, row = (
            (TEXELS_PER_M * (origin @ axis + z * along_rays(axis)) + 512.0).astype(np.float32)
            for axis in (along, across)
        )
        colors = cv2.remap(_plane(seed), column, row, cv2.INTER_LINEAR)
        gray[is_seen] = colors[is_seen]
    return make_frame(gray, depth_m, seq, camera)


@cache
def _plane(seed: int) -> NDArray[np.uint8]:
    return make_textured_image(1024, 1024, seed)


def add_depth_noise(frame: RgbdFrame, sigma_per_m: float, blur_px: float, seed: int) -> RgbdFrame:
    """The frame with noise of inverse depth; blurred, neighbors share errors. 0 px: not blurred."""
    noise = np.random.default_rng(seed).standard_normal(frame.depth_raw.shape)
    if blur_px:
        noise = np.asarray(cv2.GaussianBlur(noise, (0, 0), blur_px), np.float64)
    inverse_depth = 1.0 / frame.depth_m + sigma_per_m / noise.std() * noise
    return replace(frame, depth_raw=np.rint(frame.depth_factor / inverse_depth).astype(np.uint16))
