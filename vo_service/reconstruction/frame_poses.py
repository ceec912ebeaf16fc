"""Where the camera was at each frame: from a trajectory, or from the odometry's own."""

from collections.abc import Callable

import numpy as np

from drivers.core.geometry import Array
from drivers.core.trajectory import MAX_STAMP_DIFFERENCE_S, Trajectory, nearest_indices
from vo_service.types import OdometryUpdate, Status, TrackingState


class FramePoses:
    """The pose of a frame is the nearest in time, at most 20 ms away; else it has none."""

    def __init__(self, poses: Trajectory) -> None:
        """`poses` holds one at least."""
        self._poses = poses

    def find(self, stamp_s: float) -> Array | None:
        """T_world_camera of the frame with this stamp, if it is known."""
        index = int(nearest_indices(self._poses.stamps_s, np.array([stamp_s]))[0])
        is_near = abs(float(self._poses.stamps_s[index]) - stamp_s) <= MAX_STAMP_DIFFERENCE_S
        return self._poses.T_world_camera[index] if is_near else None

    @property
    def time_span(self) -> str:
        """The first and the last stamp, for people."""
        stamps_s = self._poses.stamps_s
        return f"{stamps_s[0]:.3f}..{stamps_s[-1]:.3f} s"


class TrackedPoseRecorder:
    """An output that remembers the poses good enough for a map: those tracked without a doubt.

    Poses before and after a loss are not in one world: each epoch has a list of its own.
    """

    warning = ""

    def __init__(self) -> None:
        self._poses_by_epoch: dict[int, list[tuple[float, Array]]] = {}
        self.frame_count = 0

    def on_update(self, update: OdometryUpdate) -> None:
        """Remember one pose, if it is a good one."""
        self.frame_count += 1
        if update.state is TrackingState.TRACKING:
            known = self._poses_by_epoch.setdefault(update.epoch, [])
            known.append((update.frame.stamp_s, update.T_world_camera))

    def on_status(self, status: Status) -> None:
        """Nothing to remember."""

    def close(self) -> None:
        """Nothing to release."""

    def apply_correction(
        self, corrected: Trajectory, are_connected: Callable[[int, int], bool]
    ) -> None:
        """The same frames, where a corrected trajectory has them.

        Epochs are one where it is known how they lie to each other.
        """
        known = dict(zip(corrected.stamps_s.tolist(), corrected.T_world_camera, strict=True))
        joined: dict[int, list[tuple[float, Array]]] = {}
        for epoch, poses in self._poses_by_epoch.items():
            first = next((each for each in joined if are_connected(each, epoch)), epoch)
            found = ((stamp_s, known[stamp_s]) for stamp_s, _ in poses if stamp_s in known)
            joined.setdefault(first, []).extend(found)
        self._poses_by_epoch = joined

    @property
    def epoch_count(self) -> int:
        """How many worlds there are poses in that nothing joins."""
        return len(self._poses_by_epoch)

    @property
    def longest_trajectory(self) -> Trajectory:
        """The poses of the epoch that has the most; none if nothing was tracked."""
        longest = max(self._poses_by_epoch.values(), key=len, default=[])
        stamps_s = np.array([stamp_s for stamp_s, _ in longest])
        return Trajectory(stamps_s, np.array([T for _, T in longest]).reshape(-1, 4, 4))
