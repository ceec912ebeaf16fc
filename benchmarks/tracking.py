"""Tracking of a sequence by an odometry, and its accuracy."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.camera import EndOfStream, PlaybackMode, RgbdCamera, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory
from drivers.recording_camera import RecordingCamera
from drivers.synthetic import SyntheticConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry import METHODS, CpuStageTimer, MethodConfig
from vo_service.tools.evaluation import Evaluation, evaluate
from vo_service.tools.evaluation.metrics import (
    PosePairs,
    associate,
    count_gross_errors,
    tracked_steps,
)
from vo_service.types import Estimate, TrackingState

READ_TIMEOUT_S = 60.0
MIN_POSES = 3
FrameChange = Callable[[RgbdFrame], RgbdFrame]


def read_all_frames(camera: RgbdCamera) -> Iterator[RgbdFrame]:
    """Yield the frames of an open camera until it ends."""
    while True:
        try:
            yield camera.read(READ_TIMEOUT_S)
        except EndOfStream:
            return


@dataclass(frozen=True)
class TrackedSequence:
    """Estimates of a method for F frames, with the states and epochs of the service."""

    stamps_s: Array
    estimates: Sequence[Estimate]
    states: Sequence[TrackingState]
    epochs: NDArray[np.int64]

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(F,) whether a frame has a pose."""
        return np.array([estimate.ok for estimate in self.estimates])

    @property
    def trajectory(self) -> Trajectory:
        """Trajectory of the frames that have a pose."""
        poses = [estimate.T_world_camera for estimate in self.estimates if estimate.ok]
        return Trajectory(self.stamps_s[self.has_pose], np.array(poses).reshape(-1, 4, 4))


@dataclass(frozen=True)
class HardCaseResult:
    """Result of one sequence. None: not available.

    Attributes:
        frames: Number of frames.
        degraded: Frames in state `degraded`.
        lost: Frames in state `lost`.
        epochs: Epochs begun after the first.
        gross: Steps between frames with a pose with an error above 5 cm or 3 degrees.
        gross_tracking: Those that end at a frame in state `tracking`.
        longest_gap_s: Longest time without a pose.
        recovery_s: Longest time from the end of a fault until a frame in state `tracking`;
            infinite if there is none.
        ate_m: ATE RMSE of the poses.
        max_error_m: Largest error of the poses, after the best alignment.
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
    """Track all frames, with the states that the service would publish."""
    odometry, tracker = METHODS[method](MethodConfig(), CpuStageTimer()), OdomFrame()
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
    """Track a sequence that was rendered from `config`, and evaluate it.

    Args:
        method: The method.
        folder: The rendered sequence.
        config: Its configuration.
    """
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        tracked = track(method, read_all_frames(camera))
        truth = camera.ground_truth
    evaluation = evaluate_trajectory(list(tracked.estimates), list(tracked.stamps_s), truth)
    is_gross, is_tracking = _count_gross_errors(tracked, truth)
    begin_s = tracked.stamps_s[0] if len(tracked.stamps_s) else 0.0
    return HardCaseResult(
        frames=len(tracked.stamps_s),
        degraded=tracked.states.count(TrackingState.DEGRADED),
        lost=tracked.states.count(TrackingState.LOST),
        epochs=int(tracked.epochs[-1]) if len(tracked.epochs) else 0,
        gross=is_gross,
        gross_tracking=is_tracking,
        longest_gap_s=longest_gap_s(tracked.stamps_s, tracked.has_pose),
        recovery_s=max_recovery_s(
            tracked, [begin_s + end_s for end_s in fault_end_times_s(config)]
        ),
        ate_m=None if evaluation is None else evaluation.ate_rmse_m,
        max_error_m=None if evaluation is None else evaluation.ate_max_m,
    )


def fault_end_times_s(config: SyntheticConfig) -> list[float]:
    """When each fault and each moving object ends, in seconds from the first frame."""
    faults = [(fault.first + fault.count) / config.rate_hz for fault in config.faults]
    return [*faults, *(moving.end_s for moving in config.movers)]


def max_recovery_s(tracked: TrackedSequence, fault_ends_s: Sequence[float]) -> float | None:
    """Longest time from the end of a fault until a frame in state `tracking`; None if no fault."""
    is_tracking = np.array([state is TrackingState.TRACKING for state in tracked.states])
    tracked_s = tracked.stamps_s[is_tracking]
    waits_s = []
    for end_s in fault_ends_s:
        after_s = tracked_s[tracked_s >= end_s - 1e-6]
        waits_s.append(float(after_s[0] - end_s) if len(after_s) else np.inf)
    return max(0.0, *waits_s) if waits_s else None


def longest_gap_s(stamps_s: Array, has_pose: NDArray[np.bool_]) -> float:
    """Longest time from a frame with a pose to the next, beyond the median frame interval."""
    with_pose_s = stamps_s[has_pose]
    if not len(with_pose_s):
        return float("inf")
    marks_s = np.concatenate([stamps_s[:1], with_pose_s, stamps_s[-1:]])
    usual_s = float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 0.0
    return max(0.0, float(np.diff(marks_s).max()) - usual_s)


def _count_gross_errors(tracked: TrackedSequence, truth: Trajectory | None) -> tuple[int, int]:
    """Count gross errors: all, and those that end at a frame in state `tracking`."""
    trajectory = tracked.trajectory
    if truth is None or len(trajectory) < MIN_POSES:
        return 0, 0
    matched = associate(trajectory, truth)
    steps = tracked_steps(matched, trajectory.stamps_s, tracked.epochs[tracked.has_pose])
    frames = np.searchsorted(tracked.stamps_s, matched.stamps_s[steps.later])
    states = [tracked.states[frame] is TrackingState.TRACKING for frame in frames]
    is_tracking = np.array(states, np.bool_)
    tracking_steps = PosePairs(steps.earlier[is_tracking], steps.later[is_tracking])
    return count_gross_errors(matched, steps), count_gross_errors(matched, tracking_steps)


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of one run. None: the trajectory is too short.

    Attributes:
        failed: Frames without a pose.
        resets: Epochs begun after the first.
        ate_m: ATE RMSE.
        rpe_1s_m: RPE over a second.
    """

    frames: int
    failed: int
    resets: int
    ate_m: float | None
    rpe_1s_m: float | None


def track_changed(
    method: str, folder: Path, change: FrameChange, first: int = 0
) -> tuple[TrackedSequence, Accuracy]:
    """Track the changed frames of a TUM folder, from frame `first` on.

    Args:
        method: The method.
        folder: The recording.
        change: Changes each frame.
        first: First frame.

    Raises:
        InputError: The folder cannot be used, or has no ground truth.
    """
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        truth = camera.ground_truth
        if truth is None:
            raise InputError(f"{folder}: has no groundtruth.txt; name a recording with one")
        frames = (frame for frame in read_all_frames(camera) if frame.seq >= first)
        tracked = track(method, map(change, frames))
    return tracked, evaluate_accuracy(tracked, truth)


def evaluate_accuracy(tracked: TrackedSequence, truth: Trajectory) -> Accuracy:
    """Compare tracked poses with the truth."""
    evaluation = evaluate_trajectory(list(tracked.estimates), list(tracked.stamps_s), truth)
    return Accuracy(
        frames=len(tracked.estimates),
        failed=sum(not estimate.ok for estimate in tracked.estimates),
        resets=int(tracked.epochs[-1]) if len(tracked.epochs) else 0,
        ate_m=None if evaluation is None else evaluation.ate_rmse_m,
        rpe_1s_m=None if evaluation is None else evaluation.rpe_1s_m,
    )


def evaluate_trajectory(
    estimates: list[Estimate], stamps_s: list[float], truth: Trajectory | None
) -> Evaluation | None:
    """Evaluate the trajectory; None without ground truth or with too few poses.

    Args:
        estimates: Estimates of the frames.
        stamps_s: Stamps of the frames, s.
        truth: True trajectory; None if not known.
    """
    good = [n for n, estimate in enumerate(estimates) if estimate.ok]
    if truth is None or not good:
        return None
    poses = np.array([estimates[n].T_world_camera for n in good])
    try:
        return evaluate(Trajectory(np.array(stamps_s)[good], poses), truth, np.array(stamps_s))
    except InputError:
        return None
