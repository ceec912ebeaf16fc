"""Motion state of the camera: the prediction, and its fusion with a measured pose.

An alpha-beta filter averages many frames of a calm camera. It blends the pose predicted by a
constant velocity with the measured one; at a large innovation the measured pose is used alone. The
velocity gain follows from the pose gain as in Kalata, "The Tracking Index: A Generalized Parameter
for alpha-beta and alpha-beta-gamma Target Trackers" (IEEE Transactions on Aerospace and Electronic
Systems 20, 1984).

In a degenerate view the prediction fills in for the unconstrained directions. Predicted and
measured pose are fused by their information: Kalman, "A New Approach to Linear Filtering and
Prediction Problems" (Journal of Basic Engineering 82, 1960). The information that noise alone adds
is suppressed, as it would look like a constraint.
"""

from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np

from drivers.core.geometry import Array, adjoint, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.direct.gauss_newton import (
    MotionPrior,
    solve_cholesky,
    velocity_information,
)
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.motion import (
    body_motion,
    compose,
    constant_velocity_motion,
    invert,
    se3_exp,
    se3_log,
)
from vo_service.odometry.direct.parameters import (
    DARK_BRIGHTNESS,
    INNOVATION_DECAY,
    MAX_DEGENERATE_S,
    MAX_EXTRAPOLATION_S,
    MAX_PREDICTION_S,
    MAX_STEADY_BRIGHTNESS_CHANGE,
    MIN_FRAME_INTERVAL_S,
    MIN_POSE_GAIN,
    MIN_VELOCITY_NOISE_RATIO,
    PREDICTION_SIGMA_GROWTH,
    VELOCITY_NOISE_DECAY,
    VELOCITY_SIGMA,
    VELOCITY_SIGMA_RANGE,
)
from vo_service.odometry.direct.quality import TrackingResult

# A normalized innovation at which the measured pose is used alone.
UNFILTERED_INNOVATION = 2.0
# Range of the sigma of the velocity, m/s and rad/s.
MAX_VELOCITY_SIGMA = np.array(VELOCITY_SIGMA)
MIN_VELOCITY_SIGMA = VELOCITY_SIGMA_RANGE[0] * MAX_VELOCITY_SIGMA
# Its sigma if the last frame is too old to tell the velocity.
UNKNOWN_VELOCITY_SIGMA = VELOCITY_SIGMA_RANGE[1] * MAX_VELOCITY_SIGMA


@dataclass(frozen=True)
class MotionState:
    """State of the camera at the last good frame.

    Attributes:
        T_world_camera: 4x4 pose.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
        stamp_s: Stamp of the frame.
        affine_brightness: Gain and offset of its brightness against the keyframe's.
        mean_brightness: Of the whole image, gray levels.
        velocity_noise: (2,) change of the velocity from frame to frame, m/s and rad/s: root of a
            fading mean square over three components; infinite if unknown.
        normalized_innovation: Fading mean of the squared innovations of the pose, each divided by
            its covariance; at least the last one. 1 is as large as the covariance.
        well_constrained_stamp_s: Stamp of the last frame that constrained all six degrees of
            freedom.
    """

    T_world_camera: Array
    velocity: Array
    stamp_s: float
    affine_brightness: tuple[float, float]
    mean_brightness: float
    velocity_noise: Array = field(default_factory=lambda: np.full(2, np.inf))
    normalized_innovation: float = 0.0
    well_constrained_stamp_s: float = 0.0

    def initial_guesses(self, T_world_keyframe: Array, stamp_s: float) -> Array:
        """(K, 4, 4) initial guesses of T_camera_keyframe: at constant velocity, and at rest."""
        guesses = _guess_poses(
            self.T_world_camera, T_world_keyframe, self.velocity, self.stamp_s - stamp_s
        )
        return guesses if self.is_recent(stamp_s) else guesses[1:]

    def predict_pose(self, stamp_s: float) -> Array:
        """4x4 pose T_world_camera at a stamp, at the velocity of the last good frame."""
        moved: Array = se3_exp((stamp_s - self.stamp_s) * self.velocity)
        return np.asarray(self.T_world_camera @ moved, np.float64)

    def motion_prior(self, T_world_keyframe: Array, stamp_s: float) -> MotionPrior:
        """Prior of the motion at a stamp: the velocity changes no more than it did recently."""
        is_recent = self.is_recent(stamp_s)
        T_keyframe_last, motion, information = _predict_motion(
            self.T_world_camera,
            T_world_keyframe,
            self.velocity,
            self.velocity_noise,
            is_recent,
        )
        rate_hz = 1.0 / max(stamp_s - self.stamp_s, MIN_FRAME_INTERVAL_S) if is_recent else 0.0
        return MotionPrior(T_keyframe_last, rate_hz, motion, information)

    def is_stale(self, stamp_s: float) -> bool:
        """Whether the camera may be far from its predicted pose at a stamp."""
        return abs(stamp_s - self.stamp_s) > MAX_PREDICTION_S

    def innovation_ratio(self, velocity: Array, stamp_s: float) -> float:
        """Change of the velocity (6,) relative to its noise; 0 if the state is stale."""
        if self.is_stale(stamp_s):
            return 0.0
        return _innovation_ratio(velocity, self.velocity, self.velocity_noise)

    def update_velocity_noise(self, velocity: Array) -> Array:
        """Velocity noise (2,) including the velocity (6,) of the next frame."""
        return _fade_velocity_noise(self.velocity_noise, velocity, self.velocity)

    def update_normalized_innovation(self, normalized_square: float) -> float:
        """Normalized innovation including that of the next frame; a rise counts at once."""
        decay = INNOVATION_DECAY
        faded = decay * self.normalized_innovation + (1.0 - decay) * normalized_square
        return max(faded, normalized_square)

    def advance(
        self,
        T_world_camera: Array,
        velocity: Array,
        images: ImagePyramid,
        affine_brightness: tuple[float, float],
        normalized_innovation: float,
        well_constrained_stamp_s: float,
    ) -> "MotionState":
        """Return the state at the next good frame; the arguments are this class's attributes.

        Args:
            T_world_camera: 4x4 pose.
            velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
            images: The frame.
            affine_brightness: Gain and offset against the keyframe's brightness.
            normalized_innovation: See `MotionState`.
            well_constrained_stamp_s: See `MotionState`.
        """
        return MotionState(
            T_world_camera,
            velocity,
            images.stamp_s,
            affine_brightness,
            images.mean_brightness,
            self.update_velocity_noise(velocity),
            normalized_innovation,
            well_constrained_stamp_s,
        )

    def predict_affine_brightness(self, images: ImagePyramid) -> tuple[float, float]:
        """Initial gain and offset: the last ones, scaled if the mean brightness has changed."""
        before = self.mean_brightness + DARK_BRIGHTNESS
        ratio = (images.mean_brightness + DARK_BRIGHTNESS) / before
        if abs(ratio - 1.0) <= MAX_STEADY_BRIGHTNESS_CHANGE:
            return self.affine_brightness
        return ratio * self.affine_brightness[0], ratio * self.affine_brightness[1]

    def is_recently_constrained(self, stamp_s: float) -> bool:
        """Whether a degenerate view is acceptable at a stamp: the last good one is recent.

        It is not if the last frame is older: then the prediction is too uncertain.
        """
        return (
            not self.is_stale(stamp_s)
            and 0.0 < stamp_s - self.well_constrained_stamp_s <= MAX_DEGENERATE_S
        )

    @property
    def is_extrapolated(self) -> bool:
        """Whether the last good frame was a degenerate view, extrapolated from those before it."""
        return self.well_constrained_stamp_s < self.stamp_s

    def is_recent(self, stamp_s: float) -> bool:
        """Whether the last frames predict the camera's pose at a stamp."""
        return 0.0 < stamp_s - self.stamp_s <= MAX_EXTRAPOLATION_S


@kernel
def _guess_poses(
    T_world_camera: Array, T_world_keyframe: Array, velocity: Array, backward_s: float
) -> Array:
    """(2, 4, 4) guesses of T_camera_keyframe after a time, see `MotionState.initial_guesses`."""
    guesses = np.empty((2, 4, 4))
    guesses[1] = compose(invert(T_world_camera), T_world_keyframe)
    guesses[0] = compose(se3_exp(backward_s * velocity), guesses[1])
    return guesses


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
def _compare_with_prediction(
    motion_state: tuple[Array, Array], elapsed_s: float, T_world_camera: Array, covariance: Array
) -> tuple[Array, Array, float]:
    """Predicted pose 4x4, innovation (6,) of a measured pose, and its mean normalized square.

    Args:
        motion_state: Pose 4x4 and velocity (6,) at the last good frame.
        elapsed_s: Time since that frame.
        T_world_camera: 4x4 measured pose.
        covariance: 6x6 of the measured pose, as a small motion in the camera's axes.
    """
    T_world_last, velocity = motion_state
    T_world_expected = compose(T_world_last, se3_exp(elapsed_s * velocity))
    innovation = se3_log(compose(invert(T_world_expected), T_world_camera))
    squared = innovation * solve_cholesky(covariance, innovation)
    return T_world_expected, innovation, squared.mean()


@kernel
def _innovation_ratio(velocity: Array, before: Array, velocity_noise: Array) -> float:
    """Change of the velocity (6,) relative to its noise (2,), see `MotionState`."""
    ratio, change = 0.0, _velocity_change(velocity, before)
    for k in range(2):
        usual = max(velocity_noise[k], MIN_VELOCITY_NOISE_RATIO * MAX_VELOCITY_SIGMA[k])
        ratio = max(ratio, change[k] / usual)
    return ratio


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
        squared = VELOCITY_NOISE_DECAY * last**2 + (1.0 - VELOCITY_NOISE_DECAY) * change[k] ** 2
        faded[k] = np.sqrt(squared)
    return faded


def fuse_and_filter(
    result: TrackingResult,
    uncertainty: MotionUncertainty,
    motion_state: MotionState,
    stamp_s: float,
) -> tuple[TrackingResult, MotionUncertainty, float]:
    """Fuse the measured pose with the predicted one.

    Args:
        result: The measured pose and velocity.
        uncertainty: Of the measured pose; in a degenerate view the prediction fills in.
        motion_state: The state up to the last good frame.
        stamp_s: Stamp of the frame.

    Returns:
        The result, its uncertainty, and the updated normalized innovation of `MotionState`.
    """
    if uncertainty.rejection_reason:
        result, uncertainty = fuse_with_prediction(result, uncertainty, motion_state, stamp_s)
    elif motion_state.is_extrapolated:
        # The step from the extrapolated pose to this one is no motion of the camera.
        result = result.with_pose(result.T_world_camera, motion_state.velocity)
    result, normalized_innovation = alpha_beta_filter(
        result, uncertainty.covariance, motion_state, stamp_s
    )
    return result, uncertainty, normalized_innovation


def alpha_beta_filter(
    result: TrackingResult, covariance: Array, motion_state: MotionState, stamp_s: float
) -> tuple[TrackingResult, float]:
    """Blend the predicted and the measured pose.

    Args:
        result: The measured pose and velocity.
        covariance: 6x6 of the measured pose, as a small motion in the camera's axes.
        motion_state: The state up to the last good frame.
        stamp_s: Stamp of the frame.

    Returns:
        The filtered result, and the updated normalized innovation of `MotionState`.
    """
    T_world_expected, innovation, normalized_square = _compare_with_prediction(
        (motion_state.T_world_camera, motion_state.velocity),
        stamp_s - motion_state.stamp_s,
        result.T_world_camera,
        covariance,
    )
    updated_innovation = motion_state.update_normalized_innovation(normalized_square)
    pose_gain, velocity_gain = filter_gains(updated_innovation)
    if pose_gain == 1.0 or motion_state.is_stale(stamp_s):
        return result, updated_innovation
    velocity_change = result.alignment.camera_velocity - motion_state.velocity
    T_world_camera = T_world_expected @ se3_exp(pose_gain * innovation)
    return result.with_pose(
        T_world_camera, motion_state.velocity + velocity_gain * velocity_change
    ), updated_innovation


def filter_gains(normalized_innovation: float) -> tuple[float, float]:
    """Gains of the pose and of the velocity, up to 1 for an unexpected motion."""
    pose_gain = min(max(normalized_innovation - 1.0, MIN_POSE_GAIN), 1.0)
    return pose_gain, min(2.0 * (2.0 - pose_gain) - 4.0 * sqrt(1.0 - pose_gain), 1.0)


def fuse_with_prediction(
    result: TrackingResult,
    uncertainty: MotionUncertainty,
    motion_state: MotionState,
    stamp_s: float,
) -> tuple[TrackingResult, MotionUncertainty]:
    """Fuse the measured with the predicted pose, and mark the result as degraded.

    The prediction gets less weight the older the last well constrained frame is.

    Args:
        result: The measured pose and velocity.
        uncertainty: Of the measured pose.
        motion_state: The state up to the last good frame.
        stamp_s: Stamp of the frame.
    """
    T_world_expected = motion_state.predict_pose(stamp_s)
    innovation = se3_log(inverse(T_world_expected) @ result.T_world_camera)
    velocity_change = result.alignment.camera_velocity - motion_state.velocity
    T_camera_keyframe = result.alignment.T_camera_keyframe
    W = uncertainty.degeneracy.noise_suppression
    W = adjoint(T_camera_keyframe) @ W @ adjoint(inverse(T_camera_keyframe))
    information = W.T @ np.linalg.inv(uncertainty.covariance) @ W
    elapsed_s = stamp_s - motion_state.well_constrained_stamp_s
    prediction_sigma = elapsed_s * np.array(PREDICTION_SIGMA_GROWTH)
    covariance = np.linalg.inv(np.diag(np.repeat(prediction_sigma**-2.0, 3)) + information)
    gain = covariance @ information
    result = result.with_pose(
        T_world_expected @ se3_exp(gain @ innovation),
        motion_state.velocity + gain @ velocity_change,
    )
    return (
        replace(result, degradation=uncertainty.rejection_reason),
        replace(uncertainty, covariance=0.5 * (covariance + covariance.T)),
    )
