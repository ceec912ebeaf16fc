"""Rendered views with exact ground truth and a rolling shutter, for the direct odometry.

The planes have a texture of waves in space: brightness is a smooth function of the position,
without interpolation and aliasing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.direct.gauss_newton import MotionPrior, velocity_information
from vo_service.odometry.direct.motion import zero_motion

# Prior of a camera of which nothing is known but that it moves by hand.
UNKNOWN_MOTION = MotionPrior(
    np.eye(4), 0.0, zero_motion(), velocity_information(np.array([0.3, 1.0]))
)
CAMERA = PinholeCamera(320, 240, 290.0, 290.0, 159.5, 119.5)
# Fine steps, for exact depth.
DEPTH_FACTOR = 15000.0
# Noise as of a Kinect: gray levels, and 1/m of disparity.
GRAY_NOISE, DISPARITY_NOISE_PER_M = 1.5, 8e-4

# A plane is n . X = d in the world.
Plane = tuple[tuple[float, float, float], float]
WALL: Plane = ((0.1, 0.05, 1.0), 2.2)
FLOOR: Plane = ((0.0, 1.0, 0.15), 0.7)
SIDE: Plane = ((1.0, 0.05, 0.2), 1.1)
CORNER = (WALL, FLOOR, SIDE)


def series_exponential(twists: Array) -> Array:
    """(..., 4, 4) exponentials of twists (..., 6), by the matrix series."""
    vx, vy, vz, x, y, z = np.moveaxis(np.asarray(twists, np.float64) / 64, -1, 0)
    o = np.zeros_like(x)
    rows = ([o, -z, y, vx], [z, o, -x, vy], [-y, x, o, vz], [o, o, o, o])
    A = np.stack([np.stack(row, -1) for row in rows], -2)
    total, term = np.eye(4), np.eye(4)
    for n in range(1, 16):
        term = term @ A / n
        total = total + term
    return np.linalg.matrix_power(total, 64)


@dataclass(frozen=True, eq=False)
class MovingCamera:
    """A camera that moves by a twist.

    Attributes:
        velocity: (6,) twist in its own axes, m/s and rad/s.
        T_world_start: 4x4 pose at time 0.
        acceleration_rad_s2: (3,) angular, at the start; the motion is known only there.
    """

    velocity: Array = field(default_factory=lambda: np.zeros(6))
    T_world_start: Array = field(default_factory=lambda: np.eye(4))
    acceleration_rad_s2: Array = field(default_factory=lambda: np.zeros(3))

    def pose_at(self, time_s: float) -> Array:
        """4x4 T_world_camera."""
        return np.asarray(self.poses_at(np.array([time_s]))[0], np.float64)

    def poses_at(self, times_s: Array) -> Array:
        """(T, 4, 4) T_world_camera."""
        twists = times_s[:, None] * self.velocity
        twists[:, 3:] += 0.5 * times_s[:, None] ** 2 * self.acceleration_rad_s2
        return np.asarray(self.T_world_start @ series_exponential(twists), np.float64)

    @property
    def motion(self) -> Array:
        """(9,) at the start; of a constant twist, at any time."""
        return np.concatenate([self.velocity, self.acceleration_rad_s2])


STILL = MovingCamera()
# 0.3 m/s and 20 degrees/s, in no special direction.
BRISK = MovingCamera(np.array([0.2, -0.12, 0.18, -0.15, 0.25, 0.2]))
# The same with hand tremor.
SHAKING = MovingCamera(BRISK.velocity, acceleration_rad_s2=np.array([15.0, -20.0, 12.0]))


def render_view(
    motion: MovingCamera = STILL,
    stamp_s: float = 0.0,
    planes: Sequence[Plane] = CORNER,
    readout_s: float = 0.0,
    skew_s: float = 0.0,
    camera: PinholeCamera = CAMERA,
    paint: float = 1.0,
) -> RgbdFrame:
    """Render a frame without noise; paint 0 makes it a uniform gray."""
    rows_s = readout_s * (np.arange(camera.height) / (camera.height - 1) - 0.5)
    color = _cast_rays(planes, motion, stamp_s + rows_s, camera)
    depth = _cast_rays(planes, motion, stamp_s + skew_s + rows_s, camera) if skew_s else color
    gray = 128.0 + paint * (texture_at(color.points) - 128.0)
    return RgbdFrame(
        seq=round(stamp_s * 30),
        stamp_s=stamp_s,
        receive_time_s=stamp_s,
        color_bgr=_to_bgr(gray),
        depth_raw=np.rint(depth.z_m * DEPTH_FACTOR).astype(np.uint16),
        depth_factor=DEPTH_FACTOR,
        camera=camera,
        skew_s=skew_s,
        readout_s=readout_s,
    )


def render_sequence(
    motion: MovingCamera, frames: int, readout_s: float = 0.0, skew_s: float = 0.0
) -> list[RgbdFrame]:
    """Render frames of the corner at 30 Hz."""
    return [render_view(motion, k / 30, readout_s=readout_s, skew_s=skew_s) for k in range(frames)]


def add_noise(frame: RgbdFrame, seed: int, times: float = 1.0) -> RgbdFrame:
    """Return the frame with a Kinect's noise."""
    random = np.random.default_rng(seed)
    shape = frame.depth_raw.shape
    gray = frame.gray + random.normal(0.0, times * GRAY_NOISE, shape)
    w = frame.depth_factor / np.maximum(frame.depth_raw, 1)
    w += random.normal(0.0, times * DISPARITY_NOISE_PER_M, shape)
    depth_raw = np.clip(np.rint(frame.depth_factor / np.maximum(w, 0.1)), 0, 65535)
    depth_raw[frame.depth_raw == 0] = 0
    return replace(frame, color_bgr=_to_bgr(gray), depth_raw=depth_raw.astype(np.uint16))


def change_lighting(frame: RgbdFrame, gain: float, offset: float = 0.0) -> RgbdFrame:
    """Return the frame with another brightness."""
    return replace(frame, color_bgr=_to_bgr(gain * frame.gray + offset))


def remove_color(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame without color."""
    return replace(frame, color_bgr=np.zeros_like(frame.color_bgr))


def remove_depth(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame without depth."""
    return replace(frame, depth_raw=np.zeros_like(frame.depth_raw))


def keep_depth_grid(frame: RgbdFrame, pitch_px: float) -> RgbdFrame:
    """Return the frame with the depth of a smaller image that was registered pixel by pixel."""
    sparse = np.zeros_like(frame.depth_raw)
    rows, columns = (
        np.arange(0.3, size - 1, pitch_px).round().astype(int) for size in frame.depth_raw.shape
    )
    grid = np.ix_(rows, columns)
    sparse[grid] = frame.depth_raw[grid]
    return replace(frame, depth_raw=sparse)


def make_empty_frame(frame: RgbdFrame) -> RgbdFrame:
    """Return the frame without color and depth."""
    return remove_color(remove_depth(frame))


def make_noise_frame(frame: RgbdFrame) -> RgbdFrame:
    """Return a frame of random noise, seeded by its number."""
    shape = frame.depth_raw.shape
    random = np.random.default_rng(frame.seq)
    color = np.repeat(random.integers(0, 256, (*shape, 1), np.uint8), 3, axis=2)
    depth = random.integers(0, 2**16, shape, np.uint16)
    return replace(frame, color_bgr=color, depth_raw=depth)


@dataclass(frozen=True, eq=False)
class _RayHits:
    z_m: Array
    points: Array


def _cast_rays(
    planes: Sequence[Plane], motion: MovingCamera, rows_s: Array, camera: PinholeCamera
) -> _RayHits:
    """Depth (H, W) and position (H, W, 3) of each pixel, each row at its own time."""
    times_s, time_of_row = np.unique(rows_s, return_inverse=True)
    T_world_rows = motion.poses_at(times_s)[time_of_row]
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    # The ray of a pixel is that of the row's middle and x times the camera's first axis.
    R_world_rows, origins = T_world_rows[:, :3, :3], T_world_rows[:, :3, 3]
    first_axis = R_world_rows[:, :, 0]
    middle = R_world_rows[:, :, 1] * y[:, None] + R_world_rows[:, :, 2]
    z_m = np.full((camera.height, camera.width), np.inf)
    for normal, distance in planes:
        ahead = (middle @ normal)[:, None] + (first_axis @ normal)[:, None] * x
        with np.errstate(divide="ignore"):
            z = (distance - origins @ normal)[:, None] / ahead
        z_m = np.where((z > 0) & (z < z_m), z, z_m)
    z_m = np.where(z_m < 4.0, z_m, 0.0)
    points = np.empty((*z_m.shape, 3))
    for axis in range(3):
        ray = middle[:, axis, None] + first_axis[:, axis, None] * x
        points[..., axis] = origins[:, axis, None] + ray * z_m
    return _RayHits(z_m, points)


def texture_at(places: Array) -> Array:
    """(...) brightness of positions (..., 3) in the world frame."""
    random = np.random.default_rng(5)
    gray = np.full(places.shape[:-1], 128.0)
    for wavelength_m in (0.09, 0.1, 0.13, 0.16, 0.2, 0.3, 0.5, 0.9):
        direction = random.normal(size=3)
        k = 2 * np.pi / wavelength_m * direction / np.linalg.norm(direction)
        phase = places @ k + random.uniform(0.0, 2 * np.pi)
        gray += 17.0 * np.sin(phase.astype(np.float32))
    return gray


def _to_bgr(gray: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    whole = np.clip(np.rint(gray), 0, 255).astype(np.uint8)
    return np.repeat(whole[:, :, None], 3, axis=2)
