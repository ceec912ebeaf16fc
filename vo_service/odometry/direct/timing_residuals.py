"""Brightness residuals between frames with known poses, from which their timing is estimated."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import IDENTITY_BRIGHTNESS, align, uniform_weights
from vo_service.odometry.direct.gauss_newton import MotionPrior
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    ImagePyramid,
    ImageTiming,
    build_image_pyramid,
)
from vo_service.odometry.direct.keyframe_points import select_points
from vo_service.odometry.direct.motion import (
    MOTION_SIZE,
    change_frame,
    constant_velocity_motion,
)
from vo_service.odometry.direct.residuals import SIGMA_BRIGHTNESS

# Information of a fixed motion, which no image changes.
FIXED_INFORMATION = np.full(MOTION_SIZE, 1e12)


@dataclass(frozen=True)
class PosedFrame:
    """A frame with the camera's pose and velocity at its stamp.

    Attributes:
        images: Its image pyramid.
        T_world_camera: 4x4 pose.
        velocity: (6,) twist of the camera in its own axes, m/s and rad/s.
    """

    images: ImagePyramid
    T_world_camera: Array
    velocity: Array

    def with_timing(self, readout_s: float, skew_s: float) -> "PosedFrame":
        """Return a copy with other row times; the skew is added to the frame's own."""
        shutter = ImageTiming(readout_s, self.images.shutter.skew_s + skew_s)
        return replace(self, images=replace(self.images, shutter=shutter))


def make_posed_frame(frame: RgbdFrame, T_world_camera: Array, velocity: Array) -> PosedFrame:
    """Make a posed frame of an RGB-D frame."""
    return PosedFrame(build_image_pyramid(frame), T_world_camera, velocity)


def brightness_sigmas(reference: PosedFrame, others: Iterable[PosedFrame]) -> list[float]:
    """Brightness sigma of each other frame aligned with the reference, gray levels.

    The given poses are refined; the velocities stay fixed.
    """
    points = select_points(
        reference.images, constant_velocity_motion(reference.velocity), ALL_STATIC
    )
    sigmas = []
    for other in others:
        T_reference_other = inverse(reference.T_world_camera) @ other.T_world_camera
        # The motion of the points in the reference's axes is minus that of the camera.
        motion = change_frame(constant_velocity_motion(-other.velocity), T_reference_other)
        prior = MotionPrior(T_reference_other, 0.0, motion, FIXED_INFORMATION)
        alignment = align(
            points,
            other.images,
            [inverse(T_reference_other)],
            prior,
            IDENTITY_BRIGHTNESS,
            uniform_weights(),
        )
        sigmas.append(float(alignment.residual_model[SIGMA_BRIGHTNESS]))
    return sigmas
