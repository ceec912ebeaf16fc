"""Recordings without images and runs that nobody made, whose figures are known."""

from decimal import Decimal
from pathlib import Path

import numpy as np

from drivers.calibration import TUM_CALIBRATIONS
from drivers.core.geometry import Array, rigid_transform
from drivers.core.trajectory import Trajectory
from drivers.tum.accelerometer import read_gravity
from drivers.tum.folder import FolderFrames, TumFolder
from drivers.tum.index_files import FramePair, ListedImage
from vo_service.tools.benchmark.batch import BatchResult
from vo_service.tools.benchmark.evaluate_run import evaluate_run
from vo_service.tools.benchmark.recordings import BenchmarkRecording
from vo_service.tools.benchmark.results import SequenceResults
from vo_service.tools.benchmark.run import (
    CompletedRun,
    FrameLog,
    LoopClosureRun,
    RunOutcome,
    RunState,
)

FRAMES = 40
STEP_M = 0.01


def make_recording(
    name: str = "walk", gap_s: float = 0.0, has_truth: bool = True
) -> BenchmarkRecording:
    """40 frames at 30 Hz, 1 cm to the right each; a pause before the 21st."""
    stamps_s = np.arange(FRAMES) / 30 + np.where(np.arange(FRAMES) >= 20, gap_s, 0.0)
    images = [ListedImage(Decimal(f"{s:.6f}"), Path(f"{s:.6f}.png"), "rgb.txt") for s in stamps_s]
    frames = FolderFrames([FramePair(image, image) for image in images])
    truth = Trajectory(np.array([image.stamp_s for image in images]), poses_along_x(FRAMES))
    opened = TumFolder(
        frames, TUM_CALIBRATIONS["1"], truth if has_truth else None, read_gravity(Path("nowhere"))
    )
    return BenchmarkRecording(name, Path(name), None, opened)


def poses_along_x(count: int, step_m: float = STEP_M) -> Array:
    """(count, 4, 4) poses, one step to the right after another."""
    return np.array([rigid_transform(np.eye(3), [step_m * k, 0, 0]) for k in range(count)])


def make_run(
    of: BenchmarkRecording,
    step_m: float = STEP_M,
    lost: range = range(0),
    epoch_from: int = FRAMES,
    with_loops: LoopClosureRun | None = None,
) -> CompletedRun:
    """Along x with steps of so much, 8 ms of CPU and 10 ms of time a frame."""
    stamps_s = of.frame_stamps_s
    good = np.array([k not in lost for k in range(FRAMES)])
    rows = [
        (stamps_s[k], bool(good[k]), int(k >= epoch_from), 100, 8.0, 10.0, "")
        if good[k]
        else (stamps_s[k], False, int(k >= epoch_from), 4, 8.0, 10.0, f"{k} of 60 matches agree")
        for k in range(FRAMES)
    ]
    poses = Trajectory(stamps_s[good], poses_along_x(FRAMES, step_m)[good])
    return CompletedRun(FrameLog.from_rows(rows), poses, 0, {"surf": 5.0}, 100.0, with_loops)


def make_loop_closure_run(of: BenchmarkRecording, step_m: float = STEP_M) -> LoopClosureRun:
    """The same way, corrected: 3 places, one of which was seen twice again."""
    return LoopClosureRun(Trajectory(of.frame_stamps_s, poses_along_x(FRAMES, step_m)), 3, 2, 1.5)


def make_outcome(of: BenchmarkRecording, **how: object) -> RunOutcome:
    """A run that came to its end."""
    return RunOutcome(RunState.DONE, make_run(of, **how))  # type: ignore[arg-type]


def make_results(
    of: BenchmarkRecording, has_loops: bool = False, **outcomes: RunOutcome
) -> SequenceResults:
    """The results of one recording, by method."""
    entries = {
        method: BatchResult(of, method, outcome, has_loops) for method, outcome in outcomes.items()
    }
    return SequenceResults(of, {method: evaluate_run(entry) for method, entry in entries.items()})


CRASH = RunOutcome(RunState.CRASHED, error="crashed (signal 11, Segmentation fault)")
