"""Changes that make a recording what another sensor, or one on a robot, would have seen."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from benchmarks.tracking import FrameChange
from benchmarks.virtual_sensors import correlated_noise
from drivers.camera import PinholeCamera, RgbdFrame
from tests.vo_service.odometry.direct.rolling_shutter_views import keep_depth_grid
from vo_service.odometry.direct.image_halving import halve


def make_other_sensors() -> Mapping[str, FrameChange]:
    """Changes of frames by name."""
    return {
        "unchanged": lambda frame: frame,
        "a quarter of the size": lambda frame: halve(halve(frame)),
        "half the size": halve,
        "twice the size": _double,
        **{
            f"noise {sigma_per_m} 1/m, {blur_px} px": partial(_add_noise, sigma_per_m, blur_px)
            for sigma_per_m in (0.006, 0.01)
            for blur_px in (3, 6, 12)
        },
        "grid of depth, 2.2 px": partial(keep_depth_grid, pitch_px=2.2),
        "grid of depth, 4 px": partial(keep_depth_grid, pitch_px=4.0),
        "twice the size, grid 2 px": lambda frame: keep_depth_grid(_double(frame), 2.0),
        "half of depth missing": _drop_half_of_depth,
        "depth in the middle only": _keep_middle_depth,
        "depth up to 1.5 m": partial(_keep_near_depth, 1.5),
        "each depth image twice": _DepthRepeater().repeat,
        "in the dark": _darken,
        "in the dark, noise 0.004 1/m": lambda frame: _add_noise(0.004, 3.0, _darken(frame)),
    }


def show_robot(frame: RgbdFrame) -> RgbdFrame:
    """Show a textured part of the robot in the lowest tenth of the image, half a meter away."""
    height, width = frame.depth_raw.shape
    paint = np.random.default_rng(5).integers(20, 230, (60, 80), np.uint8)
    texture = cv2.resize(paint, (width, height), interpolation=cv2.INTER_CUBIC)
    v, u = np.mgrid[:height, :width]
    is_robot = v > 0.87 * height + 0.06 * height * np.sin(10.0 * u / width)
    depth_m = 0.45 + 0.3 * (height - v) / height
    return replace(
        frame,
        color_bgr=np.where(is_robot[..., None], texture[..., None], frame.color_bgr),
        depth_raw=np.where(is_robot, np.rint(depth_m * frame.depth_factor), frame.depth_raw).astype(
            np.uint16
        ),
    )


def _darken(frame: RgbdFrame) -> RgbdFrame:
    """Reduce the light to 12 %, with the noise of a camera in the dark."""
    noise = np.random.default_rng([7, frame.seq]).normal(0.0, 4.0, frame.color_bgr.shape)
    color = np.clip(0.12 * frame.color_bgr + noise, 0.0, 255.0).astype(np.uint8)
    return replace(frame, color_bgr=color)


def _drop_half_of_depth(frame: RgbdFrame) -> RgbdFrame:
    """Remove the depth of random pixels."""
    is_kept = np.random.default_rng([7, frame.seq]).random(frame.depth_raw.shape) < 0.5
    return replace(frame, depth_raw=np.where(is_kept, frame.depth_raw, 0).astype(np.uint16))


def _keep_middle_depth(frame: RgbdFrame) -> RgbdFrame:
    """Remove the depth around the middle third of the rows and columns."""
    depth_raw = np.zeros_like(frame.depth_raw)
    middle = tuple(slice(size // 3, 2 * size // 3) for size in depth_raw.shape)
    depth_raw[middle] = frame.depth_raw[middle]
    return replace(frame, depth_raw=depth_raw)


def _keep_near_depth(range_m: float, frame: RgbdFrame) -> RgbdFrame:
    """Remove the depth beyond a range."""
    depth_raw = np.where(frame.depth_m > range_m, 0, frame.depth_raw).astype(np.uint16)
    return replace(frame, depth_raw=depth_raw)


class _DepthRepeater:
    """Gives frames with odd numbers the depth of the frame before."""

    def __init__(self) -> None:
        self._last: RgbdFrame | None = None

    def repeat(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame with its own depth or the last one."""
        if self._last is None or frame.seq % 2 == 0:
            self._last = frame
        return replace(frame, depth_raw=self._last.depth_raw)


def _double(frame: RgbdFrame) -> RgbdFrame:
    """Double the size; pixel (u, v) becomes (2 u, 2 v)."""
    camera = frame.camera
    color = cv2.resize(frame.color_bgr, None, fx=2.0, fy=2.0, interpolation=cv2.INTER_CUBIC)
    return replace(
        frame,
        color_bgr=np.asarray(color, np.uint8),
        depth_raw=frame.depth_raw.repeat(2, axis=0).repeat(2, axis=1),
        camera=PinholeCamera(
            2 * camera.width,
            2 * camera.height,
            2 * camera.fx,
            2 * camera.fy,
            2 * camera.cx + 0.5,
            2 * camera.cy + 0.5,
        ),
    )


def _add_noise(sigma_per_m: float, blur_px: float, frame: RgbdFrame) -> RgbdFrame:
    """Add noise of inverse depth that is correlated over `blur_px` pixels."""
    rng = np.random.default_rng([7, frame.seq])
    noise = sigma_per_m * correlated_noise(frame.depth_raw.shape, blur_px, rng)
    depth_m = 1.0 / np.maximum(1.0 / np.maximum(frame.depth_m, 0.1) + noise, 0.05)
    raw = np.where(frame.depth_raw > 0, np.rint(frame.depth_factor * depth_m), 0)
    return replace(frame, depth_raw=np.minimum(raw, 65534).astype(np.uint16))
