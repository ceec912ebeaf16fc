"""What the service asks of whoever knows places, and what stands in where nobody does."""

from typing import Protocol

from vo_service.odometry.estimate import Odometry
from vo_service.outputs.map_snapshot import NO_MAP, MapSnapshot


class Loops(Protocol):
    """Knows where the camera has been, and how far `odom` has drifted since."""

    @property
    def snapshot(self) -> MapSnapshot:
        """The map as it is now; the same object as long as nothing has changed."""
        ...

    def around(self, odometry: Odometry) -> Odometry:
        """The same odometry, that finds back to places that are known."""
        ...


class NoLoops:
    """Where no place is remembered."""

    snapshot = NO_MAP

    def around(self, odometry: Odometry) -> Odometry:
        """As it is."""
        return odometry
