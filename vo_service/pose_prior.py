"""What wheels and the floor tell of the camera's motion to the next frame."""

from dataclasses import replace
from math import hypot, radians
from typing import NamedTuple

import numpy as np

from drivers.camera import PosePrior, RgbdFrame
from drivers.core.geometry import Array, adjoint, inverse, rigid_transform, so3_exp, so3_log
from vo_service.leveling.leveling import Leveling
from vo_service.types.odometry_update import OdometryUpdate, TrackingState
from vo_service.wheel_odometry.wheel_odometry import WheelMotion, WheelOdometrySource

# How far a planar base leaves its floor at bumps: height, roll and pitch.
FLOOR_SIGMA_M, FLOOR_SIGMA_RAD = 0.003, radians(0.3)
WHEEL_ODOMETRY = "wheel odometry"


class _LastPose(NamedTuple):
    """The last frame with a pose: its published stamp, and the camera's pose 4x4 in `odom`."""

    stamp_s: float
    epoch: int
    T_odom_camera: Array


class PosePriors:
    """Gives each frame what wheels and the floor of a planar base tell of its pose.

    Args:
        T_base_camera: 4x4 pose of the optical camera in the robot's base.
        leveling: Of a planar base, with its mount; None for another base.
        wheels: The wheels' odometry.
    """

    def __init__(
        self, T_base_camera: Array, leveling: Leveling | None, wheels: WheelOdometrySource
    ) -> None:
        self._T_base_camera, self._T_camera_base = T_base_camera, inverse(T_base_camera)
        self._Ad_base_camera = adjoint(T_base_camera)
        self._leveling, self._wheels = leveling, wheels
        self._last: _LastPose | None = None

    def add_to(self, frame: RgbdFrame, published_s: float) -> RgbdFrame:
        """Return the frame with what is known of its pose.

        Args:
            frame: The next frame.
            published_s: Its stamp on the published clock.
        """
        # At each frame, as faults of the wheels need its time.
        last_s = published_s if self._last is None else self._last.stamp_s
        motion = self._wheels.motion_between(last_s, published_s)
        if self._last is None:
            return frame
        by_wheels = None if motion is None else self._wheel_prior(motion)
        if self._leveling is None:
            return frame if by_wheels is None else replace(frame, pose_prior=by_wheels)
        by_floor = floor_prior(self._last.T_odom_camera, self._leveling)
        prior = by_floor if by_wheels is None else combine(by_wheels, by_floor)
        return replace(frame, pose_prior=prior)

    def add_update(self, update: OdometryUpdate) -> None:
        """Take over the pose of a frame, from which the next motion counts."""
        if not update.estimate.ok:
            return
        last = self._last
        if last is not None and last.epoch == update.epoch:
            T_from_to = (
                self._T_base_camera
                @ (inverse(last.T_odom_camera) @ update.T_odom_camera)
                @ self._T_camera_base
            )
            self._wheels.add_visual_motion(
                last.stamp_s,
                update.stamp_s,
                T_from_to,
                update.twist_covariance * (update.stamp_s - last.stamp_s) ** 2,
                is_well_constrained=update.state is TrackingState.TRACKING,
            )
        self._last = _LastPose(update.stamp_s, update.epoch, update.T_odom_camera)

    def _wheel_prior(self, motion: WheelMotion) -> PosePrior:
        Ad = self._Ad_base_camera
        return PosePrior(
            self._T_camera_base @ motion.T_from_to @ self._T_base_camera,
            Ad.T @ np.diag(motion.sigmas**-2.0) @ Ad,
            np.zeros((6, 6)),
            WHEEL_ODOMETRY,
        )


def floor_prior(T_odom_camera: Array, leveling: Leveling) -> PosePrior:
    """Prior of a planar base: the camera's height and its up direction stay as they are mounted.

    Args:
        T_odom_camera: 4x4 last pose.
        leveling: With the mount and the floor.
    """
    up = T_odom_camera[:3, :3] @ leveling.mount_up
    axis = np.array([up[1], -up[0], 0.0])
    level = so3_exp(np.arctan2(hypot(up[0], up[1]), up[2]) * axis / max(hypot(*axis), 1e-12))
    x_m, y_m, _ = T_odom_camera[:3, 3]
    T_odom_level = rigid_transform(level @ T_odom_camera[:3, :3], (x_m, y_m, leveling.mount_z_m))
    along = np.outer(leveling.mount_up, leveling.mount_up)
    information = np.zeros((6, 6))
    information[:3, :3] = along / FLOOR_SIGMA_M**2
    information[3:, 3:] = (np.eye(3) - along) / FLOOR_SIGMA_RAD**2
    return PosePrior(inverse(T_odom_camera) @ T_odom_level, information, information)


def combine(by_wheels: PosePrior, by_floor: PosePrior) -> PosePrior:
    """Prior of wheels and floor: the mean of both, weighted by their information."""
    information = by_wheels.information + by_floor.information
    T_wheels_floor = inverse(by_wheels.T_last_camera) @ by_floor.T_last_camera
    difference = np.concatenate([T_wheels_floor[:3, 3], so3_log(T_wheels_floor[:3, :3])])
    mean = np.linalg.solve(information, by_floor.information @ difference)
    T_wheels_mean = rigid_transform(so3_exp(mean[3:]), mean[:3])
    return replace(
        by_wheels,
        T_last_camera=by_wheels.T_last_camera @ T_wheels_mean,
        information=information,
        floor_information=by_floor.information,
    )
