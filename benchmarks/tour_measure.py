"""Measures a tour frame by frame: estimated poses, true poses and costs."""

import math
import os
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.runners import LoopClosureRecord, TrajectoryRunner
from benchmarks.tour_record import TourRecord
from drivers.camera import RgbdFrame
from drivers.core.errors import InputError
from drivers.core.geometry import Array, inverse, poses_close
from drivers.core.trajectory import Trajectory
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.association import associate
from vo_service.tools.evaluation.gross_errors import (
    GROSS_ERROR_DEG,
    GROSS_ERROR_M,
    count_gross_errors,
    tracked_steps,
)

MINUTE_S = 60.0
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")


@dataclass(frozen=True)
class TourResult:
    """The figures of one tour. None: could not be computed.

    Attributes:
        frames: Number of frames.
        coverage: Fraction of the frames with a pose.
        epochs: Epochs begun after the first.
        gross: Tracked steps with an error above 5 cm or 3 degrees.
        ate_m: ATE of the poses as they were estimated.
        ate_optimized_m: ATE of the optimized poses at the end.
        loop_closures: Number of loop closures.
        wrong_loop_closures: Those with an error above 5 cm or 3 degrees.
        cpu_ms: Mean time of a pose, in the first and in the last minute.
        loop_closure_ms: Mean time of the map's work per frame, likewise.
        memory_mb: Mean memory, likewise.
    """

    frames: int
    coverage: float
    epochs: int
    gross: int
    ate_m: float | None
    ate_optimized_m: float | None
    loop_closures: int
    wrong_loop_closures: int
    cpu_ms: tuple[float, float]
    loop_closure_ms: tuple[float, float]
    memory_mb: tuple[float, float]


def run_tour(
    runner: TrajectoryRunner,
    frames: Iterable[RgbdFrame],
    T_room_camera: Array,
    progress: Callable[[int, int], None],
) -> TourRecord:
    """Run all frames without storing them.

    Args:
        runner: The method.
        frames: The frames.
        T_room_camera: Their true poses (N, 4, 4).
        progress: Called after each frame.
    """
    stamps_s, poses, ok, is_reset = [], [], [], []
    cpu_ms, loop_closure_ms, memory_mb = [], [], []
    for frame in frames:
        begin_s = time.thread_time()
        estimate = runner.estimate_pose(frame)
        estimated_s = time.thread_time()
        runner.update_map()
        cpu_ms.append((estimated_s - begin_s) * 1e3)
        loop_closure_ms.append((time.thread_time() - estimated_s) * 1e3)
        stamps_s.append(frame.stamp_s)
        poses.append(estimate.T_world_camera)
        ok.append(estimate.ok)
        is_reset.append(estimate.is_reset)
        memory_mb.append(resident_mb())
        progress(len(stamps_s), len(T_room_camera))
    stamp_s, T_world_camera, is_ok = np.array(stamps_s), np.array(poses), np.array(ok, np.bool_)
    trajectory = Trajectory(stamp_s[is_ok], T_world_camera[is_ok])
    return TourRecord(
        stamp_s,
        T_room_camera[: len(stamps_s)],
        T_world_camera,
        is_ok,
        np.cumsum(is_reset),
        np.array(cpu_ms),
        np.array(loop_closure_ms),
        np.array(memory_mb),
        runner.optimized_trajectory(trajectory),
        tuple(runner.loop_closures()),
    )


def resident_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * PAGE_BYTES / 1e6


def summarize(record: TourRecord) -> TourResult:
    """Compute the figures of a tour."""
    wrong = [loop for loop in record.loop_closures if is_wrong_loop(loop, record)]
    return TourResult(
        frames=len(record.has_pose),
        coverage=float(record.has_pose.mean()),
        epochs=int(record.epoch[-1]),
        gross=_count_gross_errors(record),
        ate_m=_ate_m(record.trajectory, record.truth),
        ate_optimized_m=_ate_m(record.optimized, record.truth),
        loop_closures=len(record.loop_closures),
        wrong_loop_closures=len(wrong),
        cpu_ms=_first_and_last(record.cpu_ms, record.stamp_s),
        loop_closure_ms=_first_and_last(record.loop_closure_ms, record.stamp_s),
        memory_mb=_first_and_last(record.memory_mb, record.stamp_s),
    )


def is_wrong_loop(loop: LoopClosureRecord, record: TourRecord) -> bool:
    """Whether a loop closure has a gross error."""
    keyframe, camera = np.searchsorted(record.stamp_s, [loop.keyframe_stamp_s, loop.stamp_s])
    true = inverse(record.T_room_camera[keyframe]) @ record.T_room_camera[camera]
    return not poses_close(
        true, loop.T_keyframe_camera, GROSS_ERROR_M, math.radians(GROSS_ERROR_DEG)
    )


def _count_gross_errors(record: TourRecord) -> int:
    try:
        matched = associate(record.trajectory, record.truth)
    except InputError:
        return 0
    steps = tracked_steps(matched, record.trajectory.stamps_s, record.epoch[record.has_pose])
    return count_gross_errors(matched, steps)


def _ate_m(trajectory: Trajectory, truth: Trajectory) -> float | None:
    try:
        return evaluate(trajectory, truth).ate_rmse_m
    except InputError:
        return None


def _first_and_last(values: Array, stamps_s: Array) -> tuple[float, float]:
    """Mean values of the first and of the last minute."""
    first = values[stamps_s < stamps_s[0] + MINUTE_S]
    last = values[stamps_s > stamps_s[-1] - MINUTE_S]
    return float(first.mean()), float(last.mean())
