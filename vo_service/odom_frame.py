"""The odom frame: turn estimates into updates with state, epoch, base pose and covariance."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import (
    T_BODY_CAMERA,
    Array,
    adjoint,
    inverse,
    rigid_transform,
    so3_exp,
    so3_log,
)
from vo_service.leveling.leveling import Leveling
from vo_service.odometry.uncertainty import CovarianceAccumulator, diagonal_covariance
from vo_service.pose_prior import PosePriors
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate, TrackingState
from vo_service.wheel_odometry.wheel_odometry import NullWheelOdometry, WheelOdometrySource

# With fewer inliers than this, the estimated motion may be wrong: the state is degraded.
MIN_INLIERS_TRACKING = 30
# Growth of the pose's standard deviation while tracking is lost, per second, for a hand-held camera
# or a slow robot.
LOST_SIGMA_M_PER_S, LOST_SIGMA_RAD_PER_S = 0.5, 1.0
# The velocity is unknown if two frames are closer in time than this.
MIN_STEP_S = 1e-3
# What a planar base cannot do: move along z, roll, pitch. Readers do not take a variance of 0.
NOT_PLANAR, PLANAR_VARIANCE = [2, 3, 4], 1e-6


@dataclass(frozen=True)
class StampedFrame:
    """A frame and its published stamp.

    Attributes:
        published_s: Its stamp on the published clock, s.
    """

    frame: RgbdFrame
    published_s: float


@dataclass(frozen=True)
class _PendingOrigin:
    """Pose of the base at the next good frame: 4x4, or None for level at the origin."""

    T_odom_base: Array | None


class OdomFrame:
    """Accumulates estimates into the pose of the base in `odom`, and its covariance.

    Attributes:
        epoch: Number of the epoch; changes whenever the pose is not continuous.
        leveling: Keeps `odom` level.
    """

    def __init__(
        self,
        T_base_camera: Array = T_BODY_CAMERA,
        is_planar: bool = False,
        wheels: WheelOdometrySource | None = None,
    ) -> None:
        """Start the first epoch.

        Args:
            T_base_camera: 4x4 pose of the optical camera in the robot's base.
            is_planar: Whether the base stays on a level floor: z, roll and pitch of its pose are 0.
            wheels: The odometry of its wheels; None = none.
        """
        self.leveling = Leveling(T_base_camera, is_planar)
        self._is_planar = is_planar
        self._pose_priors = PosePriors(
            T_base_camera, self.leveling if is_planar else None, wheels or NullWheelOdometry()
        )
        self._T_base_camera = T_base_camera
        self._T_camera_base = inverse(T_base_camera)
        self._Ad_base_camera = adjoint(T_base_camera)
        self._T_odom_start = np.eye(4)  # valid while no origin is pending
        self._pending_origin: _PendingOrigin | None = _PendingOrigin(None)
        self._seq = 0
        self.epoch = 0
        self._epoch_reason = ""
        self._last_good_s: float | None = None
        self._covariance_stamp_s: float | None = (
            None  # until then, the covariance covers the motion
        )
        self._covariance = CovarianceAccumulator()
        self._T_world_last = np.eye(4)  # pose of the last good frame

    def start_epoch(self, reason: str) -> None:
        """Start an epoch: the next pose is not continuous with the last.

        Args:
            reason: Reason of the next update.
        """
        self.epoch += 1
        self._epoch_reason = reason
        self._last_good_s = self._covariance_stamp_s = None
        self._covariance.reset()

    def reset(self, T_odom_base: Array | None) -> None:
        """Start an epoch with the base at a given pose.

        While tracking is lost, the base keeps this pose until the next good frame.

        Args:
            T_odom_base: 4x4 pose of the base; None: level, at the origin.
        """
        self.start_epoch("reset")
        if T_odom_base is not None and self._is_planar:
            T_odom_base = project_to_floor(T_odom_base)
        self._pending_origin = _PendingOrigin(T_odom_base)

    def add_pose_prior(self, frame: RgbdFrame, published_s: float) -> RgbdFrame:
        """Return the next frame with what wheels and floor tell of its pose.

        Args:
            frame: The frame.
            published_s: Its stamp on the published clock, s.
        """
        return self._pose_priors.add_to(frame, published_s)

    def update(
        self,
        stamped: StampedFrame,
        estimate: Estimate,
        stage_ms: Mapping[str, float],
        latency_s: float,
    ) -> OdometryUpdate:
        """Make the update of one frame.

        Args:
            stamped: The frame, with its published stamp.
            estimate: The odometry's estimate of it.
            stage_ms: CPU time by stage, ms.
            latency_s: Time from the frame's arrival to the estimate, s.
        """
        if estimate.is_reset:
            self.start_epoch("tracking restarted after a loss")
        frame = stamped.frame
        twist, twist_covariance = self._update_twist(estimate, frame.stamp_s)
        covariance = self._pose_covariance(frame.stamp_s)
        state, reason = _tracking_state(estimate)
        T_odom_base = self._T_odom_base(frame, estimate)
        T_odom_camera = T_odom_base @ self._T_base_camera
        pose_covariance = self._rotate_to_odom(covariance, T_odom_base)
        if self._is_planar:
            T_odom_base = project_to_floor(T_odom_base)
            _make_planar(pose_covariance)
            _make_planar(twist_covariance)
            twist[NOT_PLANAR] = 0.0
        update = OdometryUpdate(
            seq=self._seq,
            stamp_s=stamped.published_s,
            state=state,
            reason=self._epoch_reason or reason,
            epoch=self.epoch,
            T_world_camera=estimate.T_world_camera,
            T_odom_base=T_odom_base,
            T_odom_camera=T_odom_camera,
            pose_covariance=pose_covariance,
            twist=twist,
            twist_covariance=twist_covariance,
            frame=frame,
            estimate=estimate,
            stage_ms=stage_ms,
            latency_s=latency_s,
            level=self.leveling.level,
        )
        self._seq += 1
        self._epoch_reason = ""
        self._pose_priors.add_update(update)
        return update

    def measure_level(self, update: OdometryUpdate) -> None:
        """Measure by a frame how level `odom` is, for the next poses."""
        if update.estimate.ok:
            self.leveling.add_frame(update.frame, update.T_odom_camera)

    def _T_odom_base(self, frame: RgbdFrame, estimate: Estimate) -> Array:
        """Pose of the base. The first good frame after the start or a reset fixes the origin.

        A restart of tracking after a loss keeps the origin.
        """
        T_start_base = self._T_base_camera @ estimate.T_world_camera @ self._T_camera_base
        if self._pending_origin is None:
            if estimate.ok:
                correction = self.leveling.correct(self._T_odom_start @ T_start_base, frame.stamp_s)
                self._T_odom_start = correction @ self._T_odom_start
            return self._T_odom_start @ T_start_base
        T_odom_base = self._pending_origin.T_odom_base
        if T_odom_base is None:
            T_odom_base = align_to_up(self._T_base_camera[:3, :3] @ self.leveling.start(frame))
        elif estimate.ok:
            self.leveling.forget_floor()
        if estimate.ok:
            self._T_odom_start = T_odom_base @ inverse(T_start_base)
            self._pending_origin = None
        return T_odom_base

    def _update_twist(self, estimate: Estimate, stamp_s: float) -> tuple[Array, Array]:
        """Velocity (m/s, rad/s) of the base in its own axes, and its covariance."""
        last_s = self._last_good_s
        if not estimate.ok:
            return _unknown_twist()
        T_last_camera = inverse(self._T_world_last) @ estimate.T_world_camera
        self._covariance.add(estimate, T_last_camera)
        self._T_world_last = estimate.T_world_camera
        self._last_good_s = self._covariance_stamp_s = stamp_s
        if last_s is None or stamp_s - last_s < MIN_STEP_S:
            return _unknown_twist()
        step = np.concatenate([-inverse(T_last_camera)[:3, 3], so3_log(T_last_camera[:3, :3])])
        Ad = self._Ad_base_camera / (stamp_s - last_s)
        return Ad @ step, Ad @ self._covariance.step @ Ad.T

    def _pose_covariance(self, stamp_s: float) -> Array:
        """Covariance of the pose since the epoch began, in the camera's axes."""
        self._covariance_stamp_s = (
            stamp_s if self._covariance_stamp_s is None else self._covariance_stamp_s
        )
        lost_s = stamp_s - self._covariance_stamp_s
        return self._covariance.pose + diagonal_covariance(
            LOST_SIGMA_M_PER_S * lost_s, LOST_SIGMA_RAD_PER_S * lost_s
        )

    def _rotate_to_odom(self, covariance: Array, T_odom_base: Array) -> Array:
        in_base = self._Ad_base_camera @ covariance @ self._Ad_base_camera.T
        turn = np.zeros((6, 6))
        turn[:3, :3] = turn[3:, 3:] = T_odom_base[:3, :3]
        turned = turn @ in_base @ turn.T
        return 0.5 * (turned + turned.T)


def _unknown_twist() -> tuple[Array, Array]:
    return np.zeros(6), diagonal_covariance(LOST_SIGMA_M_PER_S, LOST_SIGMA_RAD_PER_S)


def _tracking_state(estimate: Estimate) -> tuple[TrackingState, str]:
    if not estimate.ok:
        return TrackingState.LOST, estimate.reason
    if estimate.reason:
        return TrackingState.DEGRADED, estimate.reason
    if 0 < estimate.inliers < MIN_INLIERS_TRACKING:
        reason = f"only {estimate.inliers} of {estimate.matches} matches agree"
        return TrackingState.DEGRADED, reason
    return TrackingState.TRACKING, ""


def align_to_up(up: Array) -> Array:
    """Find the base's first pose 4x4 so that z of `odom` is up; it is at the origin with yaw 0.

    Args:
        up: (3,) up direction in the base.
    """
    # The roll and pitch of REP 103's axes that turn this into z.
    roll_rad = np.arctan2(up[1], up[2])
    pitch_rad = np.arctan2(-up[0], np.hypot(up[1], up[2]))
    rotation = _axis_rotation(1, pitch_rad) @ _axis_rotation(0, roll_rad)
    return rigid_transform(rotation, np.zeros(3))


def project_to_floor(T_odom_base: Array) -> Array:
    """Return the pose 4x4 of a level base at height 0 with the same x, y and heading."""
    heading_rad = np.arctan2(T_odom_base[1, 0], T_odom_base[0, 0])
    x_m, y_m = T_odom_base[:2, 3]
    return rigid_transform(_axis_rotation(2, heading_rad), (x_m, y_m, 0.0))


def _make_planar(covariance: Array) -> None:
    """Make a covariance 6x6 that of a planar motion, in place."""
    covariance[NOT_PLANAR, :] = covariance[:, NOT_PLANAR] = 0.0
    covariance[NOT_PLANAR, NOT_PLANAR] = PLANAR_VARIANCE


def _axis_rotation(axis: int, angle_rad: float) -> Array:
    return so3_exp(angle_rad * np.eye(3)[axis])
