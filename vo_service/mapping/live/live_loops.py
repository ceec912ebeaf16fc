"""Loops in the running service: the map's process knows the places, the loop asks and goes on."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import inverse
from vo_service.mapping.live.messages import Asked
from vo_service.odometry.relocalising import Located, RelocalisingOdometry
from vo_service.types import NO_MAP, MapSnapshot, Odometry, PoseUpdate

# Answers that nobody has come for.
_MOST_ANSWERS = 10


class LiveLoops:
    """The finder of a `RelocalisingOdometry`, and the map as the process told it last.

    `hear` and `begin_anew` are called on another thread than the rest.
    """

    def __init__(self, put: Callable[[PoseUpdate, Asked], None]) -> None:
        """`put` passes a frame on to the process, soon."""
        self._put = put
        # From `odom` to the odometry's own world, and the epoch that this is for.
        self._T_world_odom, self._epoch = np.eye(4), 0
        self._last: PoseUpdate | None = None
        self._answers: deque[Located] = deque(maxlen=_MOST_ANSWERS)
        self.snapshot: MapSnapshot = NO_MAP

    def around(self, odometry: Odometry) -> Odometry:
        """As `Loops`."""
        return RelocalisingOdometry(odometry, self)

    def pose(self, update: PoseUpdate) -> None:
        """Remember how the odometry's world lies in `odom`."""
        self._last = update
        if update.estimate.ok:
            self._T_world_odom = update.T_world_camera @ inverse(update.T_odom_camera)
            self._epoch = update.epoch

    @property
    def knows_places(self) -> bool:
        """As `PlaceFinder`."""
        return self.snapshot.places > 0

    def look(self, frame: RgbdFrame) -> None:
        """As `PlaceFinder`."""
        if self._last is not None:
            self._put(replace(self._last, frame=frame, epoch=self._epoch), Asked())

    def answers(self) -> Sequence[Located]:
        """As `PlaceFinder`."""
        found = []
        while self._answers:
            found.append(self._answers.popleft().carried(self._T_world_odom))
        return found

    def hear(self, said: Located | MapSnapshot) -> None:
        """What the process has found out."""
        if isinstance(said, Located):
            self._answers.append(said)
        else:
            self.snapshot = said

    def begin_anew(self) -> None:
        """The process has lost its places."""
        self.snapshot = NO_MAP
