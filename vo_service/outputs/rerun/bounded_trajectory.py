"""A trajectory of bounded size, to be drawn again in a new file or for a new viewer."""

from collections.abc import Sequence

import numpy as np

from drivers.core.geometry import Array

# A point closer than this to the last one is not visibly different.
MIN_POINT_DISTANCE_M = 0.005
# Above this, every second point is removed, so that days of driving fit.
MAX_POINTS = 4096


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
