"""What becomes of a method on one sequence that has something hard in it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.camera_frames import read_all_frames
from benchmarks.odometry import evaluate_trajectory
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory
from drivers.synthetic.config import SyntheticConfig
from drivers.tum.camera import TumCamera
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import METHODS, FeatureConfig
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.gross_errors import count_gross_errors, tracked_steps
from vo_service.tools.evaluation.metrics import PosePairs
from vo_service.types import Estimate, TrackingState

MIN_POSES = 3


@dataclass(frozen=True)
class TrackedSequence:
    """What a method said of each of F frames, and what the service makes of it."""

    stamps_s: Array
    estimates: Sequence[Estimate]
    states: Sequence[TrackingState]
    epochs: NDArray[np.int64]

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(F,) whether a frame has a pose of its own."""
        return np.array([estimate.ok for estimate in self.estimates])

    @property
    def trajectory(self) -> Trajectory:
        """Of the frames that have a pose."""
        poses = [estimate.T_world_camera for estimate in self.estimates if estimate.ok]
        return Trajectory(self.stamps_s[self.has_pose], np.array(poses).reshape(-1, 4, 4))


@dataclass(frozen=True)
class HardCaseResult:
    """One sequence. None: cannot be told.

    gross          steps off by more than 5 cm or 3 degrees between frames with a pose, and how many
                   of them end at a frame that is called tracking rather than degraded
    longest_s      longest time without a pose
    recovery_s     from the end of what is hard until a frame is called tracking; the longest of
                   all, infinite where that never comes
    ate_m, largest_m  of the poses that there are, after the best alignment
    """

    frames: int
    degraded: int
    lost: int
    epochs: int
    gross: int
    gross_tracking: int
    longest_gap_s: float
    recovery_s: float | None
    ate_m: float | None
    max_error_m: float | None


def track(method: str, frames: Iterable[RgbdFrame]) -> TrackedSequence:
    """Every frame, with the states that the service would publish."""
    odometry, tracker = METHODS[method](FeatureConfig(), CpuStageTimer()), OdomFrame()
    stamps_s, estimates, states, epochs = [], [], [], []
    for frame in frames:
        estimate = odometry.estimate(frame)
        update = tracker.update(StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0)
        stamps_s.append(frame.stamp_s)
        estimates.append(estimate)
        states.append(update.state)
        epochs.append(update.epoch)
    return TrackedSequence(np.array(stamps_s), estimates, states, np.array(epochs, np.int64))


def measure(method: str, folder: Path, config: SyntheticConfig) -> HardCaseResult:
    """A sequence that was rendered from `config`, from its first frame to its last."""
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        followed = track(method, read_all_frames(camera))
        truth = camera.ground_truth
    evaluation = evaluate_trajectory(list(followed.estimates), list(followed.stamps_s), truth)
    is_gross, is_tracking = _count_gross_errors(followed, truth)
    begin_s = followed.stamps_s[0] if len(followed.stamps_s) else 0.0
    return HardCaseResult(
        frames=len(followed.stamps_s),
        degraded=followed.states.count(TrackingState.DEGRADED),
        lost=followed.states.count(TrackingState.LOST),
        epochs=int(followed.epochs[-1]) if len(followed.epochs) else 0,
        gross=is_gross,
        gross_tracking=is_tracking,
        longest_gap_s=longest_gap_s(followed.stamps_s, followed.has_pose),
        recovery_s=max_recovery_s(
            followed, [begin_s + end_s for end_s in fault_end_times_s(config)]
        ),
        ate_m=None if evaluation is None else evaluation.ate_rmse_m,
        max_error_m=None if evaluation is None else evaluation.ate_max_m,
    )


def fault_end_times_s(config: SyntheticConfig) -> list[float]:
    """When each of the things that are hard is over, in seconds from the first frame."""
    faults = [(fault.first + fault.count) / config.rate_hz for fault in config.faults]
    return [*faults, *(mover.end_s for mover in config.movers)]


def max_recovery_s(tracked: TrackedSequence, fault_ends_s: Sequence[float]) -> float | None:
    """The longest time from one of the instants until a frame is called tracking."""
    is_tracking = np.array([state is TrackingState.TRACKING for state in tracked.states])
    tracked_s = tracked.stamps_s[is_tracking]
    waits_s = []
    for over_s in fault_ends_s:
        after_s = tracked_s[tracked_s >= over_s - 1e-6]
        waits_s.append(float(after_s[0] - over_s) if len(after_s) else np.inf)
    return max(0.0, *waits_s) if waits_s else None


def longest_gap_s(stamps_s: Array, has_pose: NDArray[np.bool_]) -> float:
    """From the last frame with a pose to the next one, beyond the usual time between frames."""
    with_pose_s = stamps_s[has_pose]
    if not len(with_pose_s):
        return float("inf")
    marks_s = np.concatenate([stamps_s[:1], with_pose_s, stamps_s[-1:]])
    usual_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 0.0
    return max(0.0, float(np.diff(marks_s).max()) - usual_s)


def _count_gross_errors(tracked: TrackedSequence, truth: Trajectory | None) -> tuple[int, int]:
    """How many in all, and those that end at a frame called tracking."""
    trajectory = tracked.trajectory
    if truth is None or len(trajectory) < MIN_POSES:
        return 0, 0
    matched = associate(trajectory, truth)
    steps = tracked_steps(matched, trajectory.stamps_s, tracked.epochs[tracked.has_pose])
    frames = np.searchsorted(tracked.stamps_s, matched.stamps_s[steps.later])
    sure = [tracked.states[frame] is TrackingState.TRACKING for frame in frames]
    is_sure = np.array(sure, np.bool_)
    sure_steps = PosePairs(steps.earlier[is_sure], steps.later[is_sure])
    return count_gross_errors(matched, steps), count_gross_errors(matched, sure_steps)
