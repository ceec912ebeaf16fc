"""Alignment of a single view with a keyframe of a map, for whoever keeps keyframes of its own.

Unlike in the odometry there is no prediction, so an alignment has to be better to be believed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.depth_noise import DepthNoise
from vo_service.odometry.direct.gauss_newton import MotionPrior, velocity_information
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    HasMeanBrightness,
    ImagePyramid,
    build_image_pyramid,
)
from vo_service.odometry.direct.motion import change_frame, constant_velocity_motion
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.points import Points, select_points
from vo_service.odometry.direct.quality import occlusion_reason, rejection_reason

# Smallest share of the keyframe's points in view.
MIN_OVERLAP = 0.3


@dataclass(frozen=True)
class AlignedPose:
    """Pose of a view relative to a keyframe.

    Attributes:
        T_keyframe_camera: 4x4.
        covariance: 6x6 of it, (translation m, rotation rad), as a small motion in the camera's
            axes.
    """

    T_keyframe_camera: Array
    covariance: Array


@dataclass(frozen=True)
class MovingView:
    """Images of a view, and the velocity of its camera.

    Attributes:
        images: Its image pyramid.
        velocity: (6,) twist in its own axes, m/s and rad/s.
        velocity_sigma: Standard deviations of the velocity, m/s and rad/s.
    """

    images: ImagePyramid
    velocity: Array
    velocity_sigma: tuple[float, float]

    @classmethod
    def of(
        cls, frame: RgbdFrame, velocity: Array, velocity_sigma: tuple[float, float]
    ) -> "MovingView":
        """Make the view of a frame, with the noise of its depth; see the attributes."""
        images = build_image_pyramid(frame)
        depth_noise = DepthNoise().update(images).value_per_m
        return cls(replace(images, depth_noise=depth_noise), velocity, velocity_sigma)

    def select_points(self) -> tuple[Points, ...]:
        """Points of each level, for a keyframe."""
        return select_points(self.images, constant_velocity_motion(self.velocity), ALL_STATIC)

    def align(
        self, points: Sequence[Points], keyframe: HasMeanBrightness, T_keyframe_camera: Array
    ) -> AlignedPose | None:
        """Align this view with a keyframe; None if the alignment is not reliable.

        Args:
            points: Those of the keyframe.
            keyframe: The keyframe, for its brightness.
            T_keyframe_camera: 4x4 initial guess.
        """
        motion = change_frame(constant_velocity_motion(-self.velocity), T_keyframe_camera)
        information = velocity_information(np.array(self.velocity_sigma))
        prior = MotionPrior(T_keyframe_camera, 0.0, motion, information)
        alignment = align(
            points,
            self.images,
            inverse(T_keyframe_camera),
            prior,
            self.images.brightness_ratio(keyframe),
            uniform_weights(),
        )
        in_view = alignment.counts.in_image / max(len(alignment.samples.cell), 1)
        if rejection_reason(alignment) or occlusion_reason(alignment) or in_view < MIN_OVERLAP:
            return None
        uncertainty = estimate_uncertainty(
            points, self.images, alignment, prior, np.array(VELOCITY_SIGMA)
        )
        if uncertainty.rejection_reason:
            return None
        return AlignedPose(inverse(alignment.T_camera_keyframe), uncertainty.covariance)
