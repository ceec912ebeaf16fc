"""Motion state of the camera at the last good frame, and what it predicts: a constant velocity."""

from dataclasses import dataclass, field, replace

import numpy as np

from drivers.camera import PosePrior
from drivers.core.geometry import Array, inverse, transport_covariance
from drivers.core.jit import kernel
from vo_service.odometry.direct.gauss_newton import MotionPrior, velocity_information
from vo_service.odometry.direct.motion import (
    body_motion,
    compose,
    constant_velocity_motion,
    invert,
    se3_adjoint,
    se3_exp,
    se3_log,
)
from vo_service.odometry.direct.parameters import (
    MAX_EXTRAPOLATION_S,
    MAX_PREDICTION_S,
    MIN_FRAME_INTERVAL_S,
    MOTION_DECAY,
    VELOCITY_SIGMA,
    VELOCITY_SIGMA_RANGE,
)

# Range of the sigma of the velocity, m/s and rad/s.
MAX_VELOCITY_SIGMA = np.array(VELOCITY_SIGMA)
MIN_VELOCITY_SIGMA = VELOCITY_SIGMA_RANGE[0] * MAX_VELOCITY_SIGMA
# Its sigma if the last frame is too old to tell the velocity.
UNKNOWN_VELOCITY_SIGMA = VELOCITY_SIGMA_RANGE[1] * MAX_VELOCITY_SIGMA


@dataclass(frozen=True)
class ToldMotionDrift:
    """Error of a told motion since the last frame that constrained all six degrees of freedom.

    Attributes:
        covariance: 6x6 of the pose, as a small motion in the camera's axes.
        frames: Number of frames since then.
    """

    covariance: Array
    frames: int

    def after(self, prior: PosePrior) -> "ToldMotionDrift":
        """Return the drift after the motion to the next frame.

        The errors of wheels have one sign, so standard deviations add up, and not variances.
        """
        frames = self.frames + 1
        step = np.asarray(np.linalg.inv(prior.information - prior.floor_information), np.float64)
        if self.frames == 0:
            return ToldMotionDrift(step, frames)
        before = transport_covariance(self.covariance, prior.T_last_camera)
        return ToldMotionDrift(frames / self.frames * before + frames * step, frames)


NO_DRIFT = ToldMotionDrift(np.zeros((6, 6)), 0)


@dataclass(frozen=True)
class MotionState:
    """State of the camera at the last good frame.

    Attributes:
        T_world_camera: 4x4 pose.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
        stamp_s: Stamp of the frame.
        gain: Ratio of its brightness to the keyframe's, which the next frame starts with.
        velocity_noise: (2,) change of the velocity from frame to frame, m/s and rad/s: root of a
            fading mean square over three components; infinite if unknown.
        normalized_innovation: Fading mean of the squared innovations of the pose, each divided by
            its covariance; at least the last one. 1 is as large as the covariance.
        well_constrained_stamp_s: Stamp of the last frame that constrained all six degrees of
            freedom.
        pose_prior: What else tells of the motion to the next frame; None = nothing.
        drift: Of the told motions, since `well_constrained_stamp_s`.
    """

    T_world_camera: Array
    velocity: Array
    stamp_s: float
    gain: float = 1.0
    velocity_noise: Array = field(default_factory=lambda: np.full(2, np.inf))
    normalized_innovation: float = 0.0
    well_constrained_stamp_s: float = 0.0
    pose_prior: PosePrior | None = None
    drift: ToldMotionDrift = NO_DRIFT

    @classmethod
    def at_rest(cls, T_world_camera: Array, stamp_s: float) -> "MotionState":
        """Make the state at a first frame with pose T_world_camera (4x4)."""
        return cls(T_world_camera, np.zeros(6), stamp_s, well_constrained_stamp_s=stamp_s)

    def with_pose_prior(self, pose_prior: PosePrior | None) -> "MotionState":
        """Return this state if it has this prior, or a copy with it."""
        return self if pose_prior is self.pose_prior else replace(self, pose_prior=pose_prior)

    @property
    def told_motion(self) -> PosePrior | None:
        """The `pose_prior` if it tells all of the motion."""
        return self.pose_prior if self.pose_prior and self.pose_prior.source else None

    def predict_alignment(self, T_world_keyframe: Array, stamp_s: float) -> Array:
        """4x4 T_camera_keyframe at a stamp, by what tells all of the motion, or at its velocity."""
        if self.told_motion is not None:
            return inverse(self.predict_pose(stamp_s)) @ T_world_keyframe
        elapsed_s = stamp_s - self.stamp_s
        return _predict_alignment(self.T_world_camera, T_world_keyframe, self.velocity, elapsed_s)

    def resting_alignment(self, T_world_keyframe: Array) -> Array:
        """4x4 T_camera_keyframe if the camera has not moved since the last good frame."""
        return np.asarray(inverse(self.T_world_camera) @ T_world_keyframe, np.float64)

    def predict_pose(self, stamp_s: float) -> Array:
        """4x4 pose T_world_camera at a stamp, see `predict_alignment`."""
        if self.told_motion is not None:
            return self.T_world_camera @ self.told_motion.T_last_camera
        moved: Array = se3_exp((stamp_s - self.stamp_s) * self.velocity)
        return np.asarray(self.T_world_camera @ moved, np.float64)

    def predict_velocity(self, stamp_s: float) -> Array:
        """(6,) velocity of the camera that leads to the predicted pose, in its own axes."""
        if self.told_motion is None:
            return self.velocity
        elapsed_s = max(stamp_s - self.stamp_s, MIN_FRAME_INTERVAL_S)
        velocity: Array = se3_log(np.ascontiguousarray(self.told_motion.T_last_camera)) / elapsed_s
        return velocity

    def motion_prior(self, T_world_keyframe: Array, stamp_s: float) -> MotionPrior:
        """Prior of the motion at a stamp: the velocity changes no more than it did recently.

        With what else tells of the motion.
        """
        T_keyframe_last, motion, information = _predict_motion(
            self.T_world_camera,
            T_world_keyframe,
            self.velocity,
            self.velocity_noise,
            self.is_recent(stamp_s),
        )
        elapsed_s = stamp_s - self.stamp_s
        rate_hz = 1.0 / max(elapsed_s, MIN_FRAME_INTERVAL_S) if elapsed_s > 0.0 else 0.0
        prior = MotionPrior(T_keyframe_last, rate_hz, motion, information)
        if self.pose_prior is None:
            return prior
        T_camera_last = inverse(self.pose_prior.T_last_camera)
        T_camera_keyframe = T_camera_last @ inverse(self.T_world_camera) @ T_world_keyframe
        Ad = se3_adjoint(T_camera_keyframe)
        return prior._replace(
            T_camera_keyframe=T_camera_keyframe,
            pose_information=Ad.T @ self.pose_prior.information @ Ad,
            floor_information=Ad.T @ self.pose_prior.floor_information @ Ad,
        )

    def is_stale(self, stamp_s: float) -> bool:
        """Whether the camera may be far from its predicted pose at a stamp."""
        return abs(stamp_s - self.stamp_s) > MAX_PREDICTION_S

    def update_velocity_noise(self, velocity: Array) -> Array:
        """Velocity noise (2,) including the velocity (6,) of the next frame."""
        return _fade_velocity_noise(self.velocity_noise, velocity, self.velocity)

    def advance(
        self,
        T_world_camera: Array,
        velocity: Array,
        stamp_s: float,
        gain: float,
        normalized_innovation: float,
        well_constrained_stamp_s: float,
    ) -> "MotionState":
        """Return the state at the next good frame; the arguments are this class's attributes.

        Args:
            T_world_camera: 4x4 pose.
            velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
            stamp_s: Stamp of the frame.
            gain: Ratio of its brightness to the keyframe's.
            normalized_innovation: See `MotionState`.
            well_constrained_stamp_s: See `MotionState`.
        """
        is_measured = well_constrained_stamp_s == stamp_s
        return MotionState(
            T_world_camera,
            velocity,
            stamp_s,
            gain,
            self.update_velocity_noise(velocity) if is_measured else self.velocity_noise,
            normalized_innovation,
            well_constrained_stamp_s,
            drift=NO_DRIFT if is_measured else self.next_drift,
        )

    @property
    def next_drift(self) -> ToldMotionDrift:
        """Drift of the told motions at the next frame."""
        return self.drift if self.told_motion is None else self.drift.after(self.told_motion)

    def is_predictable(self, stamp_s: float) -> bool:
        """Whether a degenerate view is acceptable at a stamp.

        Something else tells the motion; or the last good view is recent, so that the extrapolation
        is not yet too uncertain.
        """
        if self.told_motion is not None:
            return True
        return 0.0 < stamp_s - self.well_constrained_stamp_s <= MAX_EXTRAPOLATION_S

    @property
    def is_extrapolated(self) -> bool:
        """Whether the last good frame was a degenerate view, extrapolated from those before it."""
        return self.well_constrained_stamp_s < self.stamp_s

    def is_recent(self, stamp_s: float) -> bool:
        """Whether the last frames predict the camera's pose at a stamp."""
        return 0.0 < stamp_s - self.stamp_s <= MAX_EXTRAPOLATION_S


@kernel
def _predict_alignment(
    T_world_camera: Array, T_world_keyframe: Array, velocity: Array, elapsed_s: float
) -> Array:
    """4x4 T_camera_keyframe after a time, see `MotionState.predict_alignment`."""
    T_last_keyframe = compose(invert(T_world_camera), T_world_keyframe)
    return compose(se3_exp(-elapsed_s * velocity), T_last_keyframe)


@kernel
def _predict_motion(
    T_world_camera: Array,
    T_world_keyframe: Array,
    velocity: Array,
    velocity_noise: Array,
    is_recent: bool,
) -> tuple[Array, Array, Array]:
    """T_keyframe_last 4x4, motion (9,) and information (9,) of the prior, see `MotionPrior`."""
    T_keyframe_last = compose(invert(T_world_keyframe), T_world_camera)
    motion = body_motion(T_keyframe_last, constant_velocity_motion(velocity))
    sigma = np.minimum(np.maximum(velocity_noise, MIN_VELOCITY_SIGMA), MAX_VELOCITY_SIGMA)
    if not is_recent:
        sigma = UNKNOWN_VELOCITY_SIGMA
    return T_keyframe_last, motion, velocity_information(sigma)


@kernel
def _velocity_change(velocity: Array, before: Array) -> Array:
    """(2,) root mean square of the change over three components, m/s and rad/s."""
    change = np.zeros(2)
    for k in range(6):
        change[k // 3] += (velocity[k] - before[k]) ** 2
    return np.sqrt(change / 3.0)


@kernel
def _fade_velocity_noise(noise: Array, velocity: Array, before: Array) -> Array:
    """(2,) velocity noise including the next velocity (6,); the first change is limited."""
    change, first, faded = _velocity_change(velocity, before), MAX_VELOCITY_SIGMA, np.empty(2)
    for k in range(2):
        # The first change is that of a camera that was already moving.
        last = noise[k] if np.isfinite(noise[k]) else min(change[k], first[k])
        squared = MOTION_DECAY * last**2 + (1.0 - MOTION_DECAY) * change[k] ** 2
        faded[k] = np.sqrt(squared)
    return faded
