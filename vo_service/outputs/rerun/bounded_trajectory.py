"""Where the camera has been, within bounds: to draw it again in a new file or for a new viewer."""

from collections.abc import Sequence

import numpy as np

from drivers.core.geometry import Array

# A point closer than this to the one before adds nothing that can be seen.
MIN_POINT_DISTANCE_M = 0.005
# Days of driving must fit: beyond this, every other point goes.
MAX_POINTS = 4096


class BoundedTrajectory:
    """Lines of points, a line for each epoch."""

    def __init__(self, max_points: int = MAX_POINTS) -> None:
        self._max_points = max_points
        self._epoch: int | None = None
        self._lines: list[list[Array]] = []
        self._count = 0

    @property
    def lines(self) -> Sequence[Sequence[Array]]:
        """Positions in the world, metres."""
        return self._lines

    def add(self, position: Array, epoch: int) -> bool:
        """Go on to a position. False if it is as good as the last one."""
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
        """Half the points; whole lines, the oldest, where they are too short for that."""
        self._lines = [_keep_every_second(line) for line in self._lines]
        self._count = sum(map(len, self._lines))
        while self._count > self._max_points:
            self._count -= len(self._lines.pop(0))


def _keep_every_second(line: list[Array]) -> list[Array]:
    """The last point stays: the line goes on from there."""
    return line[-1::-2][::-1]
