"""Accuracy of a method on the frames of a recording, which may be changed."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from benchmarks.camera_frames import read_all_frames
from benchmarks.hard_cases_measure import TrackedSequence, track
from benchmarks.odometry import evaluate_trajectory
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.errors import InputError
from drivers.core.trajectory import Trajectory
from drivers.tum.camera import TumCamera

FrameChange = Callable[[RgbdFrame], RgbdFrame]


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

    Raises:
        InputError: The folder cannot be used, or has no ground truth.
    """
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
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
