"""How level `odom` stays in an hour of simulated driving, with drift, accelerometer and floor."""

import argparse

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, option
from drivers.camera import AccelerometerReading, PinholeCamera, RgbdFrame
from drivers.core.geometry import (
    R_BODY_OPTICAL,
    STANDARD_GRAVITY_M_S2,
    Array,
    inverse,
    orthonormalize,
    rigid_transform,
    so3_exp,
    so3_log,
)
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.types.estimate import Estimate

RATE_HZ = 30.0
# A camera 0.5 m above the floor that looks 10 degrees down; the depth image is small, as it shows
# a plane only.
CAMERA = PinholeCamera(160, 120, 131.25, 131.25, 79.5, 59.5)
HEIGHT_M, DOWN_RAD = 0.5, np.radians(10.0)
DEPTH_NOISE_PER_M, MAX_DEPTH_M = 3e-3, 4.5
# The robot stops and starts with 0.5 m/s^2, and drives curves.
SPEED_M_S, PERIOD_S, ACCELERATION_M_S2, TURN_RAD_S = 0.3, 20.0, 0.5, 0.4
ACCELEROMETER_SIGMA_M_S2 = ACCELEROMETER_BIAS_M_S2 = 0.02 * STANDARD_GRAVITY_M_S2
# The floor comes into view and leaves it after times of this mean.
FLOOR_PERIOD_S = 20.0
TABLE = Table(
    *(10, "drift deg:10.2f", "floor in view:15s", "tilt rms deg:14.3f", "largest:8.2f"),
    *("z m:8.3f", "step deg:9.4f", "step mm:8.3mm", "bias error g:13.4f"),
)


@option("--minutes", type=float, default=60.0)
@option("--seeds", type=int, default=3)
def main(args: argparse.Namespace) -> None:
    """Simulate the drives and print a table."""
    print(TABLE.head)
    for drift_deg in (0.02, 0.07):
        for has_floor in (True, False):
            results = [
                simulate(drift_deg, has_floor, args.minutes, seed) for seed in range(args.seeds)
            ]
            name = f"median {args.seeds}"
            view = "half" if has_floor else "never"
            print(TABLE.row(name, drift_deg, view, *np.median(results, axis=0)))


def simulate(drift_deg: float, has_floor: bool, minutes: float, seed: int) -> tuple[float, ...]:
    """Simulate a drive; return the last six columns of the table.

    Args:
        drift_deg: Drift of the odometry's attitude about each axis, degrees per root second.
        has_floor: Whether the floor is in view half of the time, or never.
        minutes: Length.
        seed: Of the noise.
    """
    rng = np.random.default_rng(seed)
    down = so3_exp([0.0, DOWN_RAD, 0.0])
    T_base_camera = rigid_transform(down @ R_BODY_OPTICAL, (0.1, 0.0, HEIGHT_M))
    odom_frame = OdomFrame(T_base_camera)
    bias_m_s2 = rng.normal(size=3)
    bias_m_s2 *= ACCELEROMETER_BIAS_M_S2 / np.linalg.norm(bias_m_s2)
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.dstack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)])
    T_world_base, T_drifted = np.eye(4), np.eye(4)
    T_odom_last, T_drifted_last = None, T_drifted
    gravity_m_s2 = -bias_m_s2 - STANDARD_GRAVITY_M_S2 * T_base_camera[2, :3]
    heights_m, tilts_deg, steps_m, steps_deg = [], [], [], []
    is_in_view, next_change_s = has_floor, 0.0
    for seq in range(int(minutes * 60.0 * RATE_HZ)):
        stamp_s = seq / RATE_HZ
        if stamp_s >= next_change_s and seq:
            is_in_view = has_floor and not is_in_view
            next_change_s = stamp_s + rng.exponential(FLOOR_PERIOD_S)
        motion, acceleration_m_s2 = _motion(stamp_s)
        error = so3_exp(np.radians(drift_deg) / np.sqrt(RATE_HZ) * rng.normal(size=3))
        T_world_base = T_world_base @ motion
        T_drifted = orthonormalize(T_drifted @ motion @ rigid_transform(error, np.zeros(3)))
        up = inverse(T_world_base @ T_base_camera)[:3, 2]
        force_m_s2 = T_base_camera[:3, :3].T @ acceleration_m_s2 + STANDARD_GRAVITY_M_S2 * up
        force_m_s2 += bias_m_s2 + ACCELEROMETER_SIGMA_M_S2 * rng.normal(size=3)
        depth_raw = _floor_depth(rays, up, rng) if is_in_view else np.zeros(u.shape, np.uint16)
        # The Kinect's driver averages a second.
        gravity_m_s2 -= (force_m_s2 + gravity_m_s2) / RATE_HZ
        frame = RgbdFrame(
            seq=seq,
            stamp_s=stamp_s,
            receive_time_s=stamp_s,
            color_bgr=np.zeros((1, 1, 3), np.uint8),
            depth_raw=depth_raw,
            depth_factor=1000.0,
            camera=CAMERA,
            gravity_m_s2=tuple(gravity_m_s2.tolist()),
            accelerometer=(AccelerometerReading(stamp_s, tuple(force_m_s2.tolist())),),
        )
        T_world_camera = inverse(T_base_camera) @ T_drifted @ T_base_camera
        estimate = Estimate(True, "", T_world_camera, np.eye(4), np.zeros((6, 6)))
        update = odom_frame.update(StampedFrame(frame, stamp_s), estimate, {}, 0.0)
        odom_frame.measure_level(update)
        T_odom_base = update.T_odom_base
        heights_m.append(T_odom_base[2, 3])
        tilts_deg.append(np.degrees(np.arccos(min(T_odom_base[2, 2], 1.0))))
        if T_odom_last is not None:
            step = inverse(T_odom_last @ inverse(T_drifted_last) @ T_drifted) @ T_odom_base
            steps_m.append(np.linalg.norm(step[:3, 3]))
            steps_deg.append(np.degrees(np.linalg.norm(so3_log(step[:3, :3]))))
        T_odom_last, T_drifted_last = T_odom_base, T_drifted
    learned = update.level.accelerometer_bias_m_s2
    bias_error = np.inf if learned is None else np.linalg.norm(learned - bias_m_s2)
    return (
        float(np.sqrt(np.mean(np.square(tilts_deg)))),
        float(np.max(tilts_deg)),
        float(np.max(np.abs(heights_m))),
        float(np.max(steps_deg)),
        float(np.max(steps_m)),
        float(bias_error / STANDARD_GRAVITY_M_S2),
    )


def _motion(stamp_s: float) -> tuple[Array, Array]:
    """Motion 4x4 of the base in one frame, and its acceleration (3,) in its own axes."""
    phase_s = stamp_s % PERIOD_S
    ramp_s = SPEED_M_S / ACCELERATION_M_S2
    speed_m_s = min(SPEED_M_S, ACCELERATION_M_S2 * min(phase_s, PERIOD_S - phase_s))
    along_m_s2 = ACCELERATION_M_S2 * ((phase_s < ramp_s) - (phase_s > PERIOD_S - ramp_s))
    turn_rad_s = TURN_RAD_S * np.sin(2.0 * np.pi * stamp_s / 47.0)
    motion = rigid_transform(
        so3_exp([0.0, 0.0, turn_rad_s / RATE_HZ]), (speed_m_s / RATE_HZ, 0.0, 0.0)
    )
    return motion, np.array([along_m_s2, speed_m_s * turn_rad_s, 0.0])


def _floor_depth(rays: Array, up: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Depth (H, W) of the floor alone, mm."""
    inverse_depth_per_m = rays @ (-up / HEIGHT_M) + DEPTH_NOISE_PER_M * rng.normal(
        size=rays.shape[:2]
    )
    is_near = inverse_depth_per_m > 1.0 / MAX_DEPTH_M
    depth_m = np.where(is_near, 1.0 / np.where(is_near, inverse_depth_per_m, 1.0), 0.0)
    return (1000.0 * depth_m).astype(np.uint16)
