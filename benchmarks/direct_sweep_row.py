"""One row of `benchmarks.direct_sweep`, in a separate process with its own kernels."""

import json
import sys
from collections.abc import Sequence
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from benchmarks.direct_sweep import BASELINE, parse_change
from benchmarks.harness import Json
from benchmarks.tracking import read_all_frames
from drivers.camera import PlaybackMode
from drivers.core.errors import InputError
from drivers.core.geometry import Trajectory
from drivers.recording_camera import RecordingCamera
from vo_service.odometry.direct import parameters
from vo_service.tools.evaluation import evaluate
from vo_service.tools.evaluation.metrics import associate, count_gross_errors, tracked_steps


def main(change: str, recordings: Sequence[str]) -> int:
    """Change the constant before any kernel is compiled, then run every recording."""
    cv2.setNumThreads(1)
    if change != BASELINE:
        name, value = parse_change(change)
        if not hasattr(parameters, name):
            sys.exit(f"{parameters.__name__} has no {name}")
        setattr(parameters, name, value)
    print(json.dumps({each: evaluate_recording(each) for each in recordings}))
    return 0


def evaluate_recording(recording: str) -> Json | None:
    """Evaluate FOLDER or FOLDER@EVERY; None if there are too few poses."""
    from vo_service.odometry.direct.odometry import DirectOdometry

    folder, _, every = recording.partition("@")
    stamps_s, poses, epochs, failed = [], [], [], 0
    with RecordingCamera(Path(folder), None, PlaybackMode.LOCKSTEP) as camera:
        odometry, epoch, truth = DirectOdometry(), 0, camera.ground_truth
        for frame in islice(read_all_frames(camera), 0, None, int(every or 1)):
            estimate = odometry.estimate(frame)
            epoch += estimate.is_reset
            failed += not estimate.ok
            if estimate.ok:
                stamps_s.append(frame.stamp_s)
                poses.append(estimate.T_world_camera)
                epochs.append(epoch)
    assert truth is not None, f"{folder} has no ground truth"
    try:
        trajectory = Trajectory(np.array(stamps_s), np.array(poses))
        matched, evaluation = associate(trajectory, truth), evaluate(trajectory, truth)
    except InputError:
        return None
    steps = tracked_steps(matched, trajectory.stamps_s, np.array(epochs))
    return {
        "ate_m": evaluation.ate_rmse_m,
        "global_m": evaluation.mean_global_error_m,
        "lost": failed,
        "gross": count_gross_errors(matched, steps),
    }


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2:]))
