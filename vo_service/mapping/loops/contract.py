"""What the service asks of whoever knows places, and what stands in where nobody does."""

from typing import Protocol

import numpy as np

from drivers.geometry import Array
from vo_service.odometry.estimate import Odometry


class Loops(Protocol):
    """Knows where the camera has been, and how far `odom` has drifted since."""

    @property
    def T_map_odom(self) -> Array:
        """4x4 correction of the poses that are published now."""
        ...

    def around(self, odometry: Odometry) -> Odometry:
        """The same odometry, that finds back to places that are known."""
        ...


class NoLoops:
    """Where no place is remembered."""

    T_map_odom = np.eye(4)

    def around(self, odometry: Odometry) -> Odometry:
        """As it is."""
        return odometry
