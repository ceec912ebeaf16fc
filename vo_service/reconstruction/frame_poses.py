"""Camera poses of the frames, from a trajectory file or from the odometry."""

from collections.abc import Callable

import numpy as np

from drivers.core.geometry import Array
from drivers.core.trajectory import MAX_STAMP_DIFFERENCE_S, Trajectory, nearest_indices
from vo_service.types import OdometryUpdate, Status, TrackingState


class FramePoses:
    """Lookup of poses by stamp: the nearest in time, at most 20 ms away."""

    def __init__(self, poses: Trajectory) -> None:
        """`poses` must not be empty."""
        self._poses = poses

    def find(self, stamp_s: float) -> Array | None:
        """Return T_world_camera (4x4) of the frame with this stamp; None if it is unknown."""
        index = int(nearest_indices(self._poses.stamps_s, np.array([stamp_s]))[0])
        is_near = abs(float(self._poses.stamps_s[index]) - stamp_s) <= MAX_STAMP_DIFFERENCE_S
        return self._poses.T_world_camera[index] if is_near else None

    @property
    def time_span(self) -> str:
        """First and last stamp as text."""
        stamps_s = self._poses.stamps_s
        return f"{stamps_s[0]:.3f}..{stamps_s[-1]:.3f} s"


class TrackedPoseRecorder:
    """Output that stores the poses for a map: those in state `tracking`.

    Each epoch has its own list, as poses before and after a loss are not in one world frame.
    """

    warning = ""

    def __init__(self) -> None:
        self._poses_by_epoch: dict[int, list[tuple[float, Array]]] = {}
        self.frame_count = 0

    def on_update(self, update: OdometryUpdate) -> None:
        """Store the pose if its state is `tracking`."""
        self.frame_count += 1
        if update.state is TrackingState.TRACKING:
            poses = self._poses_by_epoch.setdefault(update.epoch, [])
            poses.append((update.frame.stamp_s, update.T_world_camera))

    def on_status(self, status: Status) -> None:
        """Do nothing: only poses are stored."""

    def close(self) -> None:
        """Do nothing: there is nothing to release."""

    def apply_correction(
        self, corrected: Trajectory, are_connected: Callable[[int, int], bool]
    ) -> None:
        """Replace the poses by those of a corrected trajectory and merge connected epochs.

        Args:
            corrected: The corrected trajectory; a frame without a pose in it is dropped.
            are_connected: Whether the transform between two epochs is known.
        """
        corrected_poses = dict(
            zip(corrected.stamps_s.tolist(), corrected.T_world_camera, strict=True)
        )
        merged: dict[int, list[tuple[float, Array]]] = {}
        for epoch, poses in self._poses_by_epoch.items():
            target = next((other for other in merged if are_connected(other, epoch)), epoch)
            merged.setdefault(target, []).extend(
                (stamp_s, corrected_poses[stamp_s])
                for stamp_s, _ in poses
                if stamp_s in corrected_poses
            )
        self._poses_by_epoch = merged

    @property
    def epoch_count(self) -> int:
        """Number of epochs that are not connected to each other."""
        return len(self._poses_by_epoch)

    @property
    def longest_trajectory(self) -> Trajectory:
        """Poses of the epoch with the most poses; empty if nothing was tracked."""
        longest = max(self._poses_by_epoch.values(), key=len, default=[])
        stamps_s = np.array([stamp_s for stamp_s, _ in longest])
        return Trajectory(stamps_s, np.array([T for _, T in longest]).reshape(-1, 4, 4))
