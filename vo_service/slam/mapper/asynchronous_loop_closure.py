"""Asynchronous loop closure: the mapper process has the map; the main loop does not wait for it."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse
from vo_service.odometry.relocalization import RelocalizationResult, RelocalizingOdometry
from vo_service.slam.mapper.messages import RelocalizationQuery
from vo_service.types import NO_MAP, MapSnapshot, Odometry, OdometryUpdate

# Largest number of results that are not polled.
_MAX_PENDING_RESULTS = 10


class AsynchronousLoopClosure:
    """Relocalizer of a `RelocalizingOdometry`, with the last snapshot of the map.

    `handle_message` and `reset` are called on another thread than the rest.

    Args:
        submit: Sends a frame to the process.
    """

    def __init__(self, submit: Callable[[OdometryUpdate, RelocalizationQuery], None]) -> None:
        self._submit = submit
        # From `odom` to the odometry's world frame, and its epoch.
        self._T_world_odom, self._epoch = np.eye(4), 0
        self._last_update: OdometryUpdate | None = None
        self._results: deque[RelocalizationResult] = deque(maxlen=_MAX_PENDING_RESULTS)
        self.snapshot: MapSnapshot = NO_MAP

    def wrap(self, odometry: Odometry) -> Odometry:
        """Wrap the odometry so that it relocalizes after a loss."""
        return RelocalizingOdometry(odometry, self)

    def on_update(self, update: OdometryUpdate) -> None:
        """Update the transform between the odometry's world frame and `odom`."""
        self._last_update = update
        if update.estimate.ok:
            self._T_world_odom = update.T_world_camera @ inverse(update.T_odom_camera)
            self._epoch = update.epoch

    @property
    def has_map(self) -> bool:
        """Whether the map has a keyframe."""
        return self.snapshot.keyframes > 0

    def query(self, frame: RgbdFrame) -> None:
        """Send the frame to the process as a query."""
        if self._last_update is not None:
            self._submit(
                replace(self._last_update, frame=frame, epoch=self._epoch), RelocalizationQuery()
            )

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """Return the results since the last call."""
        results = []
        while self._results:
            results.append(self._results.popleft().transform_to(self._T_world_odom))
        return results

    def handle_message(self, message: RelocalizationResult | MapSnapshot) -> None:
        """Handle a message of the process."""
        if isinstance(message, RelocalizationResult):
            self._results.append(message)
        else:
            self.snapshot = message

    def reset(self) -> None:
        """Drop the map after the process has lost it."""
        self.snapshot = NO_MAP
