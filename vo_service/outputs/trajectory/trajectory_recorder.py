"""The trajectory kept in memory, for the figures at the end of a run."""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from vo_service.types import OdometryUpdate, Status


class TrajectoryRecorder:
    """Remembers the pose of every good frame, under the stamp that the camera gave it."""

    warning = ""

    def __init__(self) -> None:
        self._stamps_s: list[float] = []
        self._poses: list[Array] = []
        self.publish_offset_s = 0.0  # published stamp minus the frame's

    def on_update(self, update: OdometryUpdate) -> None:
        """Remember one pose, if this frame has one of its own."""
        if update.estimate.ok:
            self._stamps_s.append(update.frame.stamp_s)
            self._poses.append(update.T_world_camera)
            self.publish_offset_s = update.stamp_s - update.frame.stamp_s

    def on_status(self, status: Status) -> None:
        """Nothing to remember."""

    def close(self) -> None:
        """Nothing to release; the trajectory can still be asked for."""

    @property
    def trajectory(self) -> Trajectory:
        """Everything so far, by rising stamps: of poses that went back in time, the last."""
        stamps_s = np.array(self._stamps_s)
        poses = np.array(self._poses).reshape(-1, 4, 4)
        _, last = np.unique(stamps_s[::-1], return_index=True)
        chosen = len(stamps_s) - 1 - last
        return Trajectory(stamps_s[chosen], poses[chosen])
