"""Recordings without images and simulated runs with known metrics."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from drivers.calibration import TUM_CALIBRATIONS
from drivers.core.geometry import Array, Trajectory, rigid_transform
from drivers.recording.recorded_frames import FramePair, RecordedFrames
from drivers.recording.recording import Recording
from drivers.tum.accelerometer import read_accelerometer
from drivers.tum.index_files import ListedImage
from vo_service.tools.compare.recordings import BenchmarkRecording
from vo_service.tools.compare.results import SequenceResults, evaluate_runs
from vo_service.tools.compare.run_outcome import (
    FRAME_COLUMNS,
    CompletedRun,
    LoopClosureRun,
    RunOutcome,
    RunState,
)

FRAMES = 40
STEP_M = 0.01


def make_recording(
    name: str = "walk", gap_s: float = 0.0, has_truth: bool = True
) -> BenchmarkRecording:
    """Make 40 frames at 30 Hz with steps of 1 cm to the right, and a gap before the 21st."""
    stamps_s = np.arange(FRAMES) / 30 + np.where(np.arange(FRAMES) >= 20, gap_s, 0.0)
    images = [ListedImage(Decimal(f"{s:.6f}"), Path(f"{s:.6f}.png"), "rgb.txt") for s in stamps_s]
    frames = RecordedFrames([FramePair(image, image) for image in images])
    truth = Trajectory(np.array([image.stamp_s for image in images]), poses_along_x(FRAMES))
    contents = Recording(
        Path(name),
        frames,
        TUM_CALIBRATIONS["1"],
        truth if has_truth else None,
        read_accelerometer(Path("nowhere")),
    )
    return BenchmarkRecording(name, Path(name), None, contents)


def poses_along_x(count: int, step_m: float = STEP_M) -> Array:
    """Return (count, 4, 4) poses with equal steps to the right."""
    return np.array([rigid_transform(np.eye(3), [step_m * k, 0, 0]) for k in range(count)])


def make_run(
    recording: BenchmarkRecording,
    step_m: float = STEP_M,
    lost: range = range(0),
    epoch_from: int = FRAMES,
    loop_closure: LoopClosureRun | None = None,
) -> CompletedRun:
    """Make a run along x, with 8 ms of processor time and 10 ms of elapsed time per frame."""
    stamps_s = recording.frame_stamps_s
    has_pose = np.array([k not in lost for k in range(FRAMES)])
    frames = np.array(
        [
            (stamps_s[k], True, k >= epoch_from, 100, 8.0, 10.0, "")
            if has_pose[k]
            else (stamps_s[k], False, k >= epoch_from, 4, 8.0, 10.0, f"{k} of 60 matches agree")
            for k in range(FRAMES)
        ],
        FRAME_COLUMNS,
    )
    poses = Trajectory(stamps_s[has_pose], poses_along_x(FRAMES, step_m)[has_pose])
    return CompletedRun(frames, poses, 0, {"surf": 5.0}, 100.0, loop_closure)


def make_loop_closure_run(recording: BenchmarkRecording, step_m: float = STEP_M) -> LoopClosureRun:
    """Make an optimized trajectory with 3 map keyframes and 2 loop closures."""
    return LoopClosureRun(
        Trajectory(recording.frame_stamps_s, poses_along_x(FRAMES, step_m)), 3, 2, 1.5
    )


def make_outcome(recording: BenchmarkRecording, **options: object) -> RunOutcome:
    """Make the outcome of a complete run."""
    return RunOutcome(RunState.DONE, make_run(recording, **options))  # type: ignore[arg-type]


def make_results(
    recording: BenchmarkRecording, has_loop_closure: bool = False, **outcomes: RunOutcome
) -> SequenceResults:
    """Make the results of one recording, by method."""
    return evaluate_runs(recording, outcomes, has_loop_closure=has_loop_closure)


CRASH = RunOutcome(RunState.CRASHED, error="crashed (signal 11, Segmentation fault)")
