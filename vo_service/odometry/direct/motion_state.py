"""Where the camera was last, how it moved then, and so where it may be now."""

from dataclasses import dataclass, field

import numpy as np

from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import MotionPrior, velocity_information
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.parameters import (
    DECAY,
    HALF,
    SLIGHT,
    TIME_SPANS_S,
    VELOCITY_SIGMA,
    VELOCITY_SIGMA_RANGE,
)
from vo_service.odometry.direct.rolling_shutter import change_frame, constant_velocity_motion
from vo_service.odometry.direct.se3 import se3_exp

# For so long it is known where the camera may be, and how it moves.
_, MAX_PREDICTION_S, MAX_STEP_S = TIME_SPANS_S
# Gain and offset of a view's brightness against its own.
IDENTITY_BRIGHTNESS = (1.0, 0.0)


@dataclass(frozen=True)
class MotionState:
    """The last good frame.

    T_world_camera   4x4
    velocity         (6,) twist of the camera in its own axes, m/s and rad/s
    stamp_s          of that frame
    light            gain and offset of its brightness against the keyframe's
    mean_brightness  of the whole image, gray levels
    agitation        (2,) how much the velocity changes from frame to frame, m/s and rad/s: root of
                     a fading mean of squares over its three components; infinite: not known
    unrest           how far poses are from where they are expected: 1 is as far as their covariance
                     says; a fading mean of normalised squares, not below the last of them
    held_s           stamp of the last frame whose view held the camera in all six directions
    """

    T_world_camera: Array
    velocity: Array
    stamp_s: float
    affine_brightness: tuple[float, float]
    mean_brightness: float
    velocity_noise: Array = field(default_factory=lambda: np.full(2, np.inf))
    normalized_innovation: float = 0.0
    well_constrained_stamp_s: float = 0.0

    def initial_guesses(self, T_world_keyframe: Array, stamp_s: float) -> list[Array]:
        """4x4 motions T_camera_keyframe to begin with: as it moves on, and as it stands still."""
        T_last_keyframe = inverse(self.T_world_camera) @ T_world_keyframe
        if not self.is_recent(stamp_s):
            return [T_last_keyframe]
        T_camera_last = se3_exp((self.stamp_s - stamp_s) * self.velocity)
        return [T_camera_last @ T_last_keyframe, T_last_keyframe]

    def predict_pose(self, stamp_s: float) -> Array:
        """4x4 pose T_world_camera at a stamp, at the velocity of the last good frame."""
        moved: Array = se3_exp((stamp_s - self.stamp_s) * self.velocity)
        return np.asarray(self.T_world_camera @ moved, np.float64)

    def motion_prior(self, T_world_keyframe: Array, stamp_s: float) -> MotionPrior:
        """What is known of the velocity at a stamp: it changes no more than it did of late."""
        T_keyframe_last = inverse(T_world_keyframe) @ self.T_world_camera
        usual = np.array(VELOCITY_SIGMA)
        information = velocity_information(
            np.clip(self.velocity_noise, VELOCITY_SIGMA_RANGE[0] * usual, usual)
        )
        movement = change_frame(constant_velocity_motion(-self.velocity), T_keyframe_last)
        duration_s = stamp_s - self.stamp_s
        tie = MotionPrior(T_keyframe_last, 1.0 / max(duration_s, 1e-3), movement, information)
        return tie if self.is_recent(stamp_s) else tie.relaxed()

    def is_stale(self, stamp_s: float) -> bool:
        """Whether the camera may be far from where it is expected at a stamp."""
        return abs(stamp_s - self.stamp_s) > MAX_PREDICTION_S

    def innovation_ratio(self, velocity: Array, stamp_s: float) -> float:
        """How many times as much as of late a velocity (6,) has changed; 0 after a long time."""
        if self.is_stale(stamp_s):
            return 0.0
        usual = np.maximum(self.velocity_noise, HALF * np.array(VELOCITY_SIGMA))
        return float((_velocity_change(velocity, self.velocity) / usual).max())

    def update_velocity_noise(self, velocity: Array) -> Array:
        """The agitation, the next frame's velocity (6,) included."""
        squared = _velocity_change(velocity, self.velocity) ** 2
        # The first change from rest is that of a camera that was moving already.
        first = np.minimum(squared, np.square(VELOCITY_SIGMA))
        before = np.where(np.isfinite(self.velocity_noise), self.velocity_noise**2, first)
        agitation = np.sqrt(DECAY * before + (1.0 - DECAY) * squared)
        return np.asarray(agitation, np.float64)

    def update_normalized_innovation(self, normalized_square: float) -> float:
        """The unrest, the next frame's normalised square included: a start counts at once."""
        return max(
            DECAY * self.normalized_innovation + (1.0 - DECAY) * normalized_square,
            normalized_square,
        )

    def advance(
        self,
        T_world_camera: Array,
        velocity: Array,
        images: ImagePyramid,
        affine_brightness: tuple[float, float],
        normalized_innovation: float,
        well_constrained_stamp_s: float,
    ) -> "MotionState":
        """The way up to the next good frame; the arguments are this class's."""
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
        """Gain and offset to begin with: as they were, or changed as the mean brightness."""
        change = (images.mean_brightness + 1.0) / (self.mean_brightness + 1.0)
        if abs(change - 1.0) <= SLIGHT:
            return self.affine_brightness
        return change * self.affine_brightness[0], change * self.affine_brightness[1]

    def is_recently_constrained(self, stamp_s: float) -> bool:
        """Whether a view may leave directions open at a stamp: it was held a moment ago.

        Not between frames further apart: how it moved before says too little then.
        """
        return (
            not self.is_stale(stamp_s)
            and 0.0 < stamp_s - self.well_constrained_stamp_s <= MAX_STEP_S
        )

    @property
    def is_extrapolated(self) -> bool:
        """Whether the last good frame was too plain a view, carried on from those before it."""
        return self.well_constrained_stamp_s < self.stamp_s

    def is_recent(self, stamp_s: float) -> bool:
        """Whether the last frames say anything of where the camera is at a stamp."""
        return 0.0 < stamp_s - self.stamp_s <= MAX_STEP_S


def _velocity_change(velocity: Array, before: Array) -> Array:
    """(2,) root mean square of the change over its three components, m/s and rad/s."""
    return np.asarray(np.sqrt(((velocity - before) ** 2).reshape(2, 3).mean(axis=1)), np.float64)
