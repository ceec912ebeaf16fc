"""How well frames fit one another whose camera motion is known: that tells their timing."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, inverse
from vo_service.odometry.keyframe.alignment import Tie, align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.images import Images, Shutter, make_images
from vo_service.odometry.keyframe.movement import COLUMNS, at_constant, in_axes
from vo_service.odometry.keyframe.points import find_points
from vo_service.odometry.keyframe.system import SIGMA_BRIGHTNESS

# Information of a movement that is given: no image changes it.
GIVEN = np.full(COLUMNS, 1e12)


@dataclass(frozen=True)
class Moment:
    """A frame and the camera's motion at its stamp.

    T_world_camera  4x4
    velocity        (6,) twist of the camera in its own axes, m/s and rad/s
    """

    images: Images
    T_world_camera: Array
    velocity: Array

    def timed(self, readout_s: float, skew_s: float) -> "Moment":
        """The same, as if its rows had been taken at other times; the skew is added to its own."""
        shutter = Shutter(readout_s, self.images.shutter.skew_s + skew_s)
        return replace(self, images=replace(self.images, shutter=shutter))


def moment(frame: RgbdFrame, T_world_camera: Array, velocity: Array) -> Moment:
    """Prepare a frame."""
    return Moment(make_images(frame), T_world_camera, velocity)


def brightness_spreads(reference: Moment, others: Iterable[Moment]) -> list[float]:
    """Of each of the others laid on the reference: the spread of brightness, grey levels.

    Only the poses are found anew, from those that are given; the velocities are taken as they are.
    """
    points = find_points(reference.images, at_constant(reference.velocity), ALL_STILL)
    spreads = []
    for other in others:
        T_reference_other = inverse(reference.T_world_camera) @ other.T_world_camera
        # The motion's twist in the reference's axes: minus the camera's.
        movement = in_axes(at_constant(-other.velocity), T_reference_other)
        tie = Tie(T_reference_other, 0.0, movement, GIVEN)
        start = inverse(T_reference_other)
        found = align(points, other.images, [start], tie, (1.0, 0.0), all_alike())
        spreads.append(float(found.fit[SIGMA_BRIGHTNESS]))
    return spreads
