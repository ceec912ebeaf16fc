"""How well frames fit one another whose camera motion is known: that tells their timing."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import MotionPrior, align, uniform_weights
from vo_service.odometry.direct.grid import ALL_STATIC
from vo_service.odometry.direct.image_pyramid import ImagePyramid, ImageTiming, build_image_pyramid
from vo_service.odometry.direct.keyframe_points import select_points
from vo_service.odometry.direct.normal_equations import SIGMA_BRIGHTNESS
from vo_service.odometry.direct.rolling_shutter import (
    MOTION_SIZE,
    change_frame,
    constant_velocity_motion,
)

# Information of a movement that is given: no image changes it.
FIXED_INFORMATION = np.full(MOTION_SIZE, 1e12)


@dataclass(frozen=True)
class PosedFrame:
    """A frame and the camera's motion at its stamp.

    T_world_camera  4x4
    velocity        (6,) twist of the camera in its own axes, m/s and rad/s
    """

    images: ImagePyramid
    T_world_camera: Array
    velocity: Array

    def with_timing(self, readout_s: float, skew_s: float) -> "PosedFrame":
        """The same, as if its rows had been taken at other times; the skew is added to its own."""
        shutter = ImageTiming(readout_s, self.images.shutter.skew_s + skew_s)
        return replace(self, images=replace(self.images, shutter=shutter))


def make_posed_frame(frame: RgbdFrame, T_world_camera: Array, velocity: Array) -> PosedFrame:
    """Prepare a frame."""
    return PosedFrame(build_image_pyramid(frame), T_world_camera, velocity)


def brightness_sigmas(reference: PosedFrame, others: Iterable[PosedFrame]) -> list[float]:
    """Of each of the others laid on the reference: the spread of brightness, gray levels.

    Only the poses are found anew, from those that are given; the velocities are taken as they are.
    """
    points = select_points(
        reference.images, constant_velocity_motion(reference.velocity), ALL_STATIC
    )
    spreads = []
    for other in others:
        T_reference_other = inverse(reference.T_world_camera) @ other.T_world_camera
        # The motion's twist in the reference's axes: minus the camera's.
        movement = change_frame(constant_velocity_motion(-other.velocity), T_reference_other)
        tie = MotionPrior(T_reference_other, 0.0, movement, FIXED_INFORMATION)
        start = inverse(T_reference_other)
        found = align(points, other.images, [start], tie, (1.0, 0.0), uniform_weights())
        spreads.append(float(found.residual_model[SIGMA_BRIGHTNESS]))
    return spreads
