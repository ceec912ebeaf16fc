"""Where the camera was at each frame: from a trajectory, or from the odometry's own."""

from collections.abc import Callable

import numpy as np

from drivers.geometry import Array
from drivers.trajectory import WITHIN_S, StampedPoses, nearest
from vo_service.types import PoseUpdate, Status, TrackingState


class FramePoses:
    """The pose of a frame is the nearest in time, at most 20 ms away; else it has none."""

    def __init__(self, poses: StampedPoses) -> None:
        """`poses` holds one at least."""
        self._poses = poses

    def at(self, stamp_s: float) -> Array | None:
        """T_world_camera of the frame with this stamp, if it is known."""
        index = int(nearest(self._poses.stamps_s, np.array([stamp_s]))[0])
        is_near = abs(float(self._poses.stamps_s[index]) - stamp_s) <= WITHIN_S
        return self._poses.T_world_camera[index] if is_near else None

    @property
    def span(self) -> str:
        """The first and the last stamp, for people."""
        stamps_s = self._poses.stamps_s
        return f"{stamps_s[0]:.3f}..{stamps_s[-1]:.3f} s"


class TrackedPoses:
    """An output that remembers the poses good enough for a map: those tracked without a doubt.

    Poses before and after a loss are not in one world: each epoch has a list of its own.
    """

    warning = ""

    def __init__(self) -> None:
        self._epochs: dict[int, list[tuple[float, Array]]] = {}
        self.frames = 0

    def pose(self, update: PoseUpdate) -> None:
        """Remember one pose, if it is a good one."""
        self.frames += 1
        if update.state is TrackingState.TRACKING:
            known = self._epochs.setdefault(update.epoch, [])
            known.append((update.frame.stamp_s, update.T_world_camera))

    def status(self, status: Status) -> None:
        """Nothing to remember."""

    def close(self) -> None:
        """Nothing to release."""

    def correct(self, corrected: StampedPoses, are_joined: Callable[[int, int], bool]) -> None:
        """The same frames, where a corrected trajectory has them.

        Epochs are one where it is known how they lie to each other.
        """
        known = dict(zip(corrected.stamps_s.tolist(), corrected.T_world_camera, strict=True))
        joined: dict[int, list[tuple[float, Array]]] = {}
        for epoch, poses in self._epochs.items():
            first = next((each for each in joined if are_joined(each, epoch)), epoch)
            found = ((stamp_s, known[stamp_s]) for stamp_s, _ in poses if stamp_s in known)
            joined.setdefault(first, []).extend(found)
        self._epochs = joined

    @property
    def epochs(self) -> int:
        """How many worlds there are poses in that nothing joins."""
        return len(self._epochs)

    @property
    def longest(self) -> StampedPoses:
        """The poses of the epoch that has the most; none if nothing was tracked."""
        longest = max(self._epochs.values(), key=len, default=[])
        stamps_s = np.array([stamp_s for stamp_s, _ in longest])
        return StampedPoses(stamps_s, np.array([T for _, T in longest]).reshape(-1, 4, 4))
