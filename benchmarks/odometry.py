"""SURF compared with SIFT and ORB in the same odometry: errors and cost.

    python -m benchmarks.odometry FOLDER... [--methods SURF SIFT ORB] [--json]

Each FOLDER is a TUM folder. Only the features differ: points, matching, RANSAC and SVD are those of
the service. Times are CPU milliseconds of one thread, the median over the frames, without decoding.
Distances are in millimeters; `kinect-vo evaluate` explains the figures.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import sys
import time
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from benchmarks.camera_frames import read_all_frames
from benchmarks.odometry_methods import METHODS, make_odometry
from benchmarks.odometry_table import STAGES, OdometryResult, format_table
from drivers.camera import PlaybackMode
from drivers.core.errors import InputError, UserFacingError
from drivers.core.trajectory import Trajectory
from drivers.tum.camera import TumCamera
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.tools.evaluation import Evaluation, evaluate
from vo_service.types import Estimate


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.odometry",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[str, dict[str, OdometryResult]] = {}
    try:
        for folder in args.folder:
            results[str(folder)] = {name: measure(name, folder) for name in args.methods}
            if not args.json:
                print(f"{folder}\n{format_table(results[str(folder)])}\n", flush=True)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if args.json:
        print(json.dumps(to_json(results)))
    return 0


def measure(method: str, folder: Path) -> OdometryResult:
    """Run a method on all frames of a folder."""
    clock = CpuStageTimer()
    odometry = make_odometry(method, clock)
    estimates: list[Estimate] = []
    stamps_s, stages_ms, cpu_ms = [], [], []
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
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


def evaluate_trajectory(
    estimates: list[Estimate], stamps_s: list[float], truth: Trajectory | None
) -> Evaluation | None:
    """Evaluate the trajectory; None without ground truth or with too few poses."""
    good = [n for n, estimate in enumerate(estimates) if estimate.ok]
    if truth is None or not good:
        return None
    poses = np.array([estimates[n].T_world_camera for n in good])
    try:
        return evaluate(Trajectory(np.array(stamps_s)[good], poses), truth, np.array(stamps_s))
    except InputError:
        return None


def median(values: list[float] | list[int]) -> float:
    """The median; 0 for no values."""
    return float(np.median(values)) if values else 0.0


def to_json(results: dict[str, dict[str, OdometryResult]]) -> dict[str, dict[str, object]]:
    """Results by folder, then by method."""
    return {
        folder: {name: asdict(result) for name, result in methods.items()}
        for folder, methods in results.items()
    }


if __name__ == "__main__":
    sys.exit(main())
