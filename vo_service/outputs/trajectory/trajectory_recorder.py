"""Output that keeps the trajectory in memory, for the summary at the end of a run."""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from vo_service.types import OdometryUpdate, Status


class TrajectoryRecorder:
    """Stores the pose of every tracked frame with the camera's stamp.

    Attributes:
        publish_offset_s: Published stamp minus the frame's stamp, s.
    """

    warning = ""

    def __init__(self) -> None:
        self._stamps_s: list[float] = []
        self._poses: list[Array] = []
        self.publish_offset_s = 0.0

    def on_update(self, update: OdometryUpdate) -> None:
        """Store one pose if this frame has its own."""
        if update.estimate.ok:
            self._stamps_s.append(update.frame.stamp_s)
            self._poses.append(update.T_world_camera)
            self.publish_offset_s = update.stamp_s - update.frame.stamp_s

    def on_status(self, status: Status) -> None:
        """Do nothing: only poses are stored."""

    def close(self) -> None:
        """Do nothing: the trajectory stays available."""

    @property
    def trajectory(self) -> Trajectory:
        """All poses so far, sorted by stamp; of poses with the same stamp, the last."""
        stamps_s = np.array(self._stamps_s)
        poses = np.array(self._poses).reshape(-1, 4, 4)
        _, last = np.unique(stamps_s[::-1], return_index=True)
        selected = len(stamps_s) - 1 - last
        return Trajectory(stamps_s[selected], poses[selected])
