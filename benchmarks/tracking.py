"""Tracking of a recording by a method, and its accuracy."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import measure_cpu_ms, option
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core import InputError
from drivers.core.folders import cache_folder
from drivers.core.geometry import Array, Trajectory, inverse, nearest_indices, pose_distance
from drivers.faulty_camera import Fault, FaultyCamera
from drivers.playback.camera import RecordingCamera
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.registry import DEFAULT_METHOD, METHODS, MethodConfig
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.tools.evaluation.evaluation import Evaluation, evaluate
from vo_service.tools.evaluation.metrics import (
    GROSS_ERROR_DEG,
    GROSS_ERROR_M,
    MatchedPoses,
    PosePairs,
    associate,
    tracked_steps,
)
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

MAX_SIGMAS = 3.0
METHOD = option("--method", choices=METHODS, default=DEFAULT_METHOD)
FrameChange = Callable[[RgbdFrame], RgbdFrame]


@contextmanager
def open_frames(
    folder: Path, faults: tuple[Fault, ...] = ()
) -> Iterator[tuple[Iterator[RgbdFrame], Trajectory | None]]:
    """Open a recording: all its frames, and its ground truth; None if it has none.

    Raises:
        InputError: The recording cannot be used.
    """
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        yield iter(FaultyCamera(camera, faults, seed=0)), camera.ground_truth


@contextmanager
def open_frames_with_truth(
    folder: Path, faults: tuple[Fault, ...] = ()
) -> Iterator[tuple[Iterator[RgbdFrame], Trajectory]]:
    """Open a recording as `open_frames`. Raises InputError if it has no ground truth."""
    with open_frames(folder, faults) as (frames, truth):
        if truth is None:
            raise InputError(f"{folder}: has no groundtruth.txt; name a recording with one")
        yield frames, truth


def render_with_truth(config: SyntheticConfig) -> Iterator[tuple[RgbdFrame, Array]]:
    """Yield each frame of the virtual Kinect, from the cache, and its true pose in the room."""
    with SyntheticCamera(config, cache_folder() / "sequences") as camera:
        assert camera.ground_truth is not None, "a sequence without a loop has a ground truth"
        yield from zip(camera, camera.ground_truth.T_world_camera, strict=True)


@dataclass(frozen=True)
class TrackedSequence:
    """Estimates of a method for F frames, with the states and epochs of the service.

    Attributes:
        position_sigmas_m: (F,) largest standard deviation of the published position, m.
        cpu_ms: (F,) processor time of the odometry, ms.
        stage_ms: Processor time of the stages of each frame, by name, ms.
    """

    stamps_s: Array
    estimates: Sequence[Estimate]
    states: Sequence[TrackingState]
    epochs: NDArray[np.int64]
    position_sigmas_m: Array
    cpu_ms: Array
    stage_ms: Sequence[Mapping[str, float]] = ()

    @property
    def has_pose(self) -> NDArray[np.bool_]:
        """(F,) whether a frame has a pose."""
        return np.array([estimate.ok for estimate in self.estimates], np.bool_)

    @property
    def trajectory(self) -> Trajectory:
        """Trajectory of the frames that have a pose."""
        poses = [estimate.T_world_camera for estimate in self.estimates if estimate.ok]
        return Trajectory(self.stamps_s[self.has_pose], np.array(poses).reshape(-1, 4, 4))

    @property
    def resets(self) -> int:
        """Number of epochs begun after the first."""
        return int(self.epochs[-1]) if len(self.epochs) else 0

    def count_overconfident(self, truth: Trajectory) -> int:
        """Number of poses whose position is wrong by more than `MAX_SIGMAS` of its sigma.

        The error is that of the motion since the first pose of the epoch.
        """
        count, epoch, T_truth_world = 0, -1, np.eye(4)
        indices = nearest_indices(truth.stamps_s, self.stamps_s)
        for n, estimate in enumerate(self.estimates):
            if not estimate.ok:
                continue
            T_truth_camera = truth.T_world_camera[indices[n]]
            if self.epochs[n] != epoch:
                epoch = int(self.epochs[n])
                T_truth_world = T_truth_camera @ inverse(estimate.T_world_camera)
            error_m, _ = pose_distance(T_truth_camera, T_truth_world @ estimate.T_world_camera)
            count += bool(error_m > MAX_SIGMAS * self.position_sigmas_m[n])
        return count


def track(
    method: str,
    frames: Iterable[RgbdFrame],
    odom_frame: OdomFrame | None = None,
    config: MethodConfig = MethodConfig(),  # noqa: B008 (frozen)
) -> TrackedSequence:
    """Track all frames, with the states that the service would publish.

    Args:
        odom_frame: With the mount and the wheels of the base; None: a camera without a base.
    """
    timer = CpuStageTimer()
    return track_with(METHODS[method](config, timer), timer, frames, odom_frame or OdomFrame())


def track_with(
    odometry: Odometry, timer: CpuStageTimer, frames: Iterable[RgbdFrame], odom_frame: OdomFrame
) -> TrackedSequence:
    """As `track`, with an odometry and its timer."""
    rows = []  # without the updates, which have the frames
    for update, spent_ms in track_each(odometry, frames, odom_frame):
        variance = np.linalg.eigvalsh(update.pose_covariance[:3, :3])[-1]
        published = (update.stamp_s, update.estimate, update.state, update.epoch, variance)
        rows.append((*published, spent_ms, timer.take_stage_ms()))
    columns = list(zip(*rows, strict=True)) or [()] * 7
    stamps_s, estimates, states, epochs, variances, cpu_ms, stage_ms = columns
    return TrackedSequence(
        np.array(stamps_s),
        estimates,
        states,
        np.array(epochs, np.int64),
        np.sqrt(np.array(variances)),
        np.array(cpu_ms),
        stage_ms,
    )


def track_each(
    odometry: Odometry, frames: Iterable[RgbdFrame], odom_frame: OdomFrame
) -> Iterator[tuple[OdometryUpdate, float]]:
    """Yield the update that the service would publish for each frame, and its CPU milliseconds."""
    for bare_frame in frames:
        frame = odom_frame.add_pose_prior(bare_frame, bare_frame.stamp_s)
        estimate, spent_ms = measure_cpu_ms(partial(odometry.estimate, frame))
        update = odom_frame.update(StampedFrame(frame, frame.stamp_s), estimate, {}, 0.0)
        odom_frame.measure_level(update)
        yield update, spent_ms


@dataclass(frozen=True)
class Accuracy:
    """Accuracy and cost of one run. None: the trajectory is too short.

    Attributes:
        failed: Frames without a pose.
        resets: Epochs begun after the first.
        ate_m: ATE RMSE.
        global_m: Mean global error.
        rpe_1s_m: RPE over a second.
        max_error_m: Largest error after the best alignment.
        degraded: Frames in state `degraded`.
        lost: Frames in state `lost`.
        overconfident: See `TrackedSequence.count_overconfident`.
        cpu_ms: Mean processor time of a frame.
        median_ms: The median.
    """

    frames: int
    failed: int
    resets: int
    ate_m: float | None
    global_m: float | None
    rpe_1s_m: float | None
    max_error_m: float | None = None
    degraded: int = 0
    lost: int = 0
    overconfident: int = 0
    cpu_ms: float = 0.0
    median_ms: float = 0.0


def track_changed(
    method: str, folder: Path, change: FrameChange, first: int = 0
) -> tuple[TrackedSequence, Accuracy]:
    """Track the changed frames of a recording, from frame `first` on.

    Raises:
        InputError: The folder cannot be used, or has no ground truth.
    """
    with open_frames_with_truth(folder) as (all_frames, truth):
        frames = (frame for frame in all_frames if frame.seq >= first)
        tracked = track(method, map(change, frames))
    return tracked, evaluate_accuracy(tracked, truth)


def evaluate_accuracy(tracked: TrackedSequence, truth: Trajectory) -> Accuracy:
    """Compare tracked poses with the truth."""
    evaluation = evaluate_poses(tracked.trajectory, truth, tracked.stamps_s)
    cpu_ms = tracked.cpu_ms if len(tracked.cpu_ms) else np.zeros(1)
    return Accuracy(
        frames=len(tracked.estimates),
        failed=int(np.count_nonzero(~tracked.has_pose)),
        resets=tracked.resets,
        ate_m=None if evaluation is None else evaluation.ate_rmse_m,
        global_m=None if evaluation is None else evaluation.mean_global_error_m,
        rpe_1s_m=None if evaluation is None else evaluation.rpe_1s_m,
        max_error_m=None if evaluation is None else evaluation.ate_max_m,
        degraded=tracked.states.count(TrackingState.DEGRADED),
        lost=tracked.states.count(TrackingState.LOST),
        overconfident=tracked.count_overconfident(truth),
        cpu_ms=float(np.mean(cpu_ms)),
        median_ms=float(np.median(cpu_ms)),
    )


def evaluate_poses(
    trajectory: Trajectory, truth: Trajectory | None, frame_stamps_s: Array | None = None
) -> Evaluation | None:
    """As `evaluate`; None without ground truth or with too few poses."""
    if truth is None or not len(trajectory):
        return None
    try:
        return evaluate(trajectory, truth, frame_stamps_s)
    except InputError:
        return None


def pose_error(T_true: Array, T: Array) -> tuple[float, float]:
    """Error of a 4x4 pose, meters and degrees."""
    distance_m, angle_rad = pose_distance(T_true, T)
    return distance_m, math.degrees(angle_rad)


def is_gross(error_m: float, error_deg: float) -> bool:
    """Whether an error of a pose is above 5 cm or 3 degrees."""
    return error_m > GROSS_ERROR_M or error_deg > GROSS_ERROR_DEG


def match_steps(
    trajectory: Trajectory, truth: Trajectory, epochs: NDArray[np.int64]
) -> tuple[MatchedPoses, PosePairs] | None:
    """Match poses and their epochs (N,) with the truth; None with too few.

    Returns:
        The poses with their truth, and the steps between those of an epoch.
    """
    try:
        matched = associate(trajectory, truth)
    except InputError:
        return None
    return matched, tracked_steps(matched, trajectory.stamps_s, epochs)
