"""One row of `benchmarks.keyframe_sweep`: a process of its own, for its kernels are its own."""

import benchmarks.one_thread  # noqa: F401

# isort: split

import importlib
import json
import sys
from pathlib import Path

import cv2

from benchmarks.keyframe_sweep import AS_IT_IS, MODULE, changed
from benchmarks.odometry import all_frames, compare
from drivers.camera import Pace
from drivers.tum.camera import TumCamera


def main(settings: str) -> int:
    """Change the constant before anything is compiled with it, then follow every recording."""
    cv2.setNumThreads(1)
    change, folders, every = json.loads(settings)
    if change != AS_IT_IS:
        parameters = importlib.import_module(MODULE)
        name, value = changed(change)
        if not hasattr(parameters, name):
            sys.exit(f"{MODULE} has no {name}")
        setattr(parameters, name, value)
    print("".join(cell(Path(folder), step) for folder in folders for step in every))
    return 0


def cell(folder: Path, every: int) -> str:
    """The figures of one recording."""
    from vo_service.odometry.keyframe_odometry import KeyframeOdometry

    with TumCamera(folder, None, Pace.LOCKSTEP) as camera:
        odometry = KeyframeOdometry()
        stamps_s, estimates = [], []
        for number, frame in enumerate(all_frames(camera)):
            if number % every == 0:
                stamps_s.append(frame.stamp_s)
                estimates.append(odometry.estimate(frame))
        found = compare(estimates, stamps_s, camera.ground_truth)
    failed = sum(not estimate.ok for estimate in estimates)
    if found is None:
        return f"{'-':>30}"
    errors = (found.ate_rmse_m, found.mean_global_error_m, found.rpe_1s_m or float("nan"))
    text = " ".join(f"{1e3 * error:.2f}" for error in errors) + f" {failed}"
    return f"{text:>30}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
