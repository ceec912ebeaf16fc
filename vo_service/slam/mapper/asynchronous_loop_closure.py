"""Loops in the running service: the map's process knows the places, the loop asks and goes on."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse
from vo_service.odometry.relocalization import RelocalizationResult, RelocalizingOdometry
from vo_service.slam.mapper.messages import RelocalizationQuery
from vo_service.types import NO_MAP, MapSnapshot, Odometry, OdometryUpdate

# Answers that nobody has come for.
_MAX_PENDING_RESULTS = 10


class AsynchronousLoopClosure:
    """The finder of a `RelocalizingOdometry`, and the map as the process told it last.

    `hear` and `begin_anew` are called on another thread than the rest.
    """

    def __init__(self, submit: Callable[[OdometryUpdate, RelocalizationQuery], None]) -> None:
        """`put` passes a frame on to the process, soon."""
        self._submit = submit
        # From `odom` to the odometry's own world, and the epoch that this is for.
        self._T_world_odom, self._epoch = np.eye(4), 0
        self._last_update: OdometryUpdate | None = None
        self._results: deque[RelocalizationResult] = deque(maxlen=_MAX_PENDING_RESULTS)
        self.snapshot: MapSnapshot = NO_MAP

    def wrap(self, odometry: Odometry) -> Odometry:
        """As `LoopClosure`."""
        return RelocalizingOdometry(odometry, self)

    def on_update(self, update: OdometryUpdate) -> None:
        """Remember how the odometry's world lies in `odom`."""
        self._last_update = update
        if update.estimate.ok:
            self._T_world_odom = update.T_world_camera @ inverse(update.T_odom_camera)
            self._epoch = update.epoch

    @property
    def has_map(self) -> bool:
        """As `Relocalizer`."""
        return self.snapshot.keyframes > 0

    def query(self, frame: RgbdFrame) -> None:
        """As `Relocalizer`."""
        if self._last_update is not None:
            self._submit(
                replace(self._last_update, frame=frame, epoch=self._epoch), RelocalizationQuery()
            )

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """As `Relocalizer`."""
        found = []
        while self._results:
            found.append(self._results.popleft().transform_to(self._T_world_odom))
        return found

    def handle_message(self, message: RelocalizationResult | MapSnapshot) -> None:
        """What the process has found out."""
        if isinstance(message, RelocalizationResult):
            self._results.append(message)
        else:
            self.snapshot = message

    def reset(self) -> None:
        """The process has lost its places."""
        self.snapshot = NO_MAP
