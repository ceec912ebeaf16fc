"""What the odometry has said since the last place: the motion, how sure it is, how long."""

from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, inverse, rotation_vector
from vo_service.mapping.spacing import Gate
from vo_service.pose_covariance import PoseCovariance
from vo_service.types import PoseUpdate

# From one place to the next, in steps of 15 cm or 10 degrees.
PLACE_STEPS = 2.0
# Two frames further apart in time say nothing of the velocity.
LONGEST_STEP_S = 0.2


@dataclass(frozen=True)
class Hop:
    """From one place to the next.

    velocity    (6,) twist of the camera in its own axes at the end, m/s and rad/s
    covariance  6x6 of the motion, as a small motion in the camera's axes
    length_m    how far the camera has travelled
    """

    velocity: Array
    covariance: Array
    length_m: float


class Hops:
    """Sees every result of the odometry, and says which frames are to be places."""

    def __init__(self) -> None:
        self._gate = Gate(PLACE_STEPS)
        self._covariance = PoseCovariance()
        self._length_m = 0.0
        self._last: tuple[int, float, Array] | None = None  # epoch, stamp and pose

    def next(self, update: PoseUpdate) -> Hop | None:
        """The hop that ends with this frame, if it is to be a place."""
        if not update.estimate.ok:
            return None
        velocity = self._add(update)
        if not self._gate.lets_through(update):
            return None
        hop = Hop(velocity, self._covariance.pose, self._length_m)
        self._covariance.begin()
        self._length_m = 0.0
        return hop

    def forget(self) -> None:
        """Let the next good frame be a place. Safe from any thread."""
        self._gate.forget()

    def _add(self, update: PoseUpdate) -> Array:
        """Go on to the next good frame; the velocity there."""
        epoch, stamp_s, T_world_camera = update.epoch, update.frame.stamp_s, update.T_world_camera
        last, self._last = self._last, (epoch, stamp_s, T_world_camera)
        if last is None or last[0] != epoch:
            self._covariance.begin()
            self._length_m = 0.0
            return np.zeros(6)
        T_last_camera = inverse(last[2]) @ T_world_camera
        self._covariance.add(update.estimate, T_last_camera)
        self._length_m += float(np.linalg.norm(T_last_camera[:3, 3]))
        duration_s = stamp_s - last[1]
        if not 0.0 < duration_s <= LONGEST_STEP_S:
            return np.zeros(6)
        step = [-inverse(T_last_camera)[:3, 3], rotation_vector(T_last_camera[:3, :3])]
        return np.concatenate(step) / duration_s


class NoHops:
    """Where no place is remembered."""

    def next(self, update: PoseUpdate) -> None:
        """Never."""

    def forget(self) -> None:
        """Nothing is known."""
