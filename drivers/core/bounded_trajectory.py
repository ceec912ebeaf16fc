"""The positions of a trajectory, few enough to draw and to write again and again."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.rate_limits import Throttle

# A point closer than this to the last one is not visibly different.
MIN_POINT_DISTANCE_M = 0.005
# Above this, every second point is removed, so that days of driving fit.
MAX_POINTS = 4096
# At most 100 kB a second are written.
PATH_PERIOD_S = 0.5


class BoundedTrajectory:
    """Polylines of positions, one per epoch."""

    def __init__(self, max_points: int = MAX_POINTS) -> None:
        self._max_points = max_points
        self._epoch: int | None = None
        self._lines: list[list[Array]] = []
        self._count = 0

    @property
    def lines(self) -> Sequence[Sequence[Array]]:
        """Positions in the world, meters."""
        return self._lines

    def add(self, position: Array, epoch: int) -> bool:
        """Add a position. Return False if it is too close to the last one."""
        if epoch != self._epoch:
            self._epoch = epoch
            self._lines.append([])
        line = self._lines[-1]
        if line and np.linalg.norm(position - line[-1]) < MIN_POINT_DISTANCE_M:
            return False
        line.append(position)
        self._count += 1
        if self._count > self._max_points:
            self._decimate()
        return True

    def _decimate(self) -> None:
        """Remove every second point, then the oldest lines if that is not enough."""
        self._lines = [_keep_every_second(line) for line in self._lines]
        self._count = sum(map(len, self._lines))
        while self._count > self._max_points:
            self._count -= len(self._lines.pop(0))


def _keep_every_second(line: list[Array]) -> list[Array]:
    """Keep the last point: the line continues from it."""
    return line[-1::-2][::-1]


class SampledPath:
    """A path that grows, returned as a whole at most twice a second."""

    def __init__(self) -> None:
        self._trajectory = BoundedTrajectory()
        self._throttle = Throttle(PATH_PERIOD_S)
        self._has_changed = False

    def add(self, stamp_s: float, position: Array, epoch: int = 0) -> NDArray[np.float32] | None:
        """Add a position; return all if they have changed and are due.

        Args:
            stamp_s: Stamp of the position, s.
            position: (3,), m.
            epoch: Positions of different epochs are not connected.

        Returns:
            (N, 3) positions, m; None if they are not due.
        """
        self._has_changed |= self._trajectory.add(position, epoch)
        if not self._has_changed or not self._throttle.allow(stamp_s):
            return None
        self._has_changed = False
        return np.concatenate(self._trajectory.lines).astype(np.float32)
