"""SURF compared with SIFT and ORB in the same odometry: errors and cost.

    python -m benchmarks odometry FOLDER... [--methods SURF SIFT ORB] [--json]

Each FOLDER is a TUM folder. Only the features differ: points, matching, RANSAC and SVD are those of
the service. Times are CPU milliseconds of one thread, the median over the frames, without decoding.
Distances are in millimeters; `kinect-vo evaluate` explains the figures.
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.harness import add_json_option, format_table, make_printer, print_json
from benchmarks.tracking import evaluate_trajectory, read_all_frames
from drivers.camera import PlaybackMode
from drivers.recording_camera import RecordingCamera
from vo_service.odometry import CpuStageTimer
from vo_service.odometry.features import SurfParameters
from vo_service.odometry.surf import SurfExtractor
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.tools.benchmark.baselines.frame_to_frame import (
    MATCH_RATIO,
    orb_odometry,
    sift_odometry,
)
from vo_service.tools.evaluation import Evaluation
from vo_service.types import Estimate, StageTimer

METHODS = ("SURF", "SIFT", "ORB")
COUNT = 1000
STAGES = ("surf", "points", "match", "ransac", "svd")


def make_odometry(method: str, stopwatch: StageTimer) -> SurfOdometry:
    """Make the service's odometry with the features of one of METHODS."""
    if method == "SIFT":
        return sift_odometry(COUNT, stopwatch)
    if method == "ORB":
        return orb_odometry(COUNT, stopwatch)
    parameters = SurfParameters(match_ratio=MATCH_RATIO)
    return SurfOdometry(SurfExtractor(COUNT), parameters, timer=stopwatch)


@dataclass(frozen=True)
class OdometryResult:
    """Result of one method on one folder.

    Attributes:
        frames: Number of frames.
        failed: Frames without a pose.
        inliers: Median over the frames with a pose.
        stage_ms: Median CPU time by stage.
        cpu_ms: Median CPU time of a frame.
        evaluation: None without ground truth.
    """

    frames: int
    failed: int
    inliers: float
    stage_ms: dict[str, float]
    cpu_ms: float
    evaluation: Evaluation | None


def format_results(results: dict[str, OdometryResult]) -> str:
    """Format one line for each method; then ratios to SIFT, if it is one of them."""
    heads = ["frames", "failed", "inliers", "ATE", "global", "RPE/frame", "RPE/1s", "cover %"]
    heads += [*STAGES, "CPU ms"]
    rows = {name: table_cells(result) for name, result in results.items()}
    if "SIFT" in results:
        for name in (name for name in results if name != "SIFT"):
            rows[f"{name}/SIFT"] = ratio_cells(results[name], results["SIFT"])
    return format_table(heads, rows)


def table_cells(result: OdometryResult) -> list[str]:
    """The columns of one method."""
    counts = [f"{result.frames}", f"{result.failed}", f"{result.inliers:.0f}"]
    errors = [f"{1e3 * e:.1f}" if e is not None else "-" for e in errors_m(result)]
    covered = result.evaluation.coverage if result.evaluation else None
    times_ms = [*(result.stage_ms[name] for name in STAGES), result.cpu_ms]
    share = "-" if covered is None else f"{100 * covered:.1f}"
    return [*counts, *errors, share, *(f"{spent:.2f}" for spent in times_ms)]


def ratio_cells(result: OdometryResult, other: OdometryResult) -> list[str]:
    """The same columns as ratios to those of another method."""
    errors = [
        f"{mine / theirs:.2f}" if mine is not None and theirs else "-"
        for mine, theirs in zip(errors_m(result), errors_m(other), strict=True)
    ]
    stages = [f"{result.stage_ms[s] / max(other.stage_ms[s], 1e-9):.2f}" for s in STAGES]
    inliers = f"{result.inliers / max(other.inliers, 1.0):.2f}"
    return ["", "", inliers, *errors, "", *stages, f"{result.cpu_ms / other.cpu_ms:.2f}"]


def errors_m(result: OdometryResult) -> list[float | None]:
    """ATE, mean global error, RPE per frame and per second, in meters."""
    e = result.evaluation
    if e is None:
        return [None] * 4
    return [e.ate_rmse_m, e.mean_global_error_m, e.rpe_frame_m, e.rpe_1s_m]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    results: dict[str, dict[str, OdometryResult]] = {}
    print_line = make_printer(args)
    for folder in args.folder:
        results[str(folder)] = {name: measure(name, folder) for name in args.methods}
        print_line(f"{folder}\n{format_results(results[str(folder)])}\n")
    print_json(args, results)


def measure(method: str, folder: Path) -> OdometryResult:
    """Run a method on all frames of a folder."""
    clock = CpuStageTimer()
    odometry = make_odometry(method, clock)
    estimates: list[Estimate] = []
    stamps_s, stages_ms, cpu_ms = [], [], []
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        for frame in read_all_frames(camera):
            begin_s = time.thread_time()
            estimates.append(odometry.estimate(frame))
            cpu_ms.append((time.thread_time() - begin_s) * 1e3)
            stages_ms.append(clock.take_stage_ms())
            stamps_s.append(frame.stamp_s)
        truth = camera.ground_truth
    return OdometryResult(
        frames=len(estimates),
        failed=sum(not e.ok for e in estimates),
        inliers=median([e.inliers for e in estimates if e.ok]),
        stage_ms={name: median([s[name] for s in stages_ms if name in s]) for name in STAGES},
        cpu_ms=median(cpu_ms),
        evaluation=evaluate_trajectory(estimates, stamps_s, truth),
    )


def median(values: list[float] | list[int]) -> float:
    """The median; 0 for no values."""
    return float(np.median(values)) if values else 0.0
