"""Errors from a wrong calibration: the same recordings with one changed camera parameter.

    python -m benchmarks wrong_calibration FOLDER... [--method direct]

It prints ATE RMSE, mean global error and RPE over a second, in millimeters, and the frames without
a pose. The calibration of the recordings must be exact: use rendered ones.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from benchmarks.tracking import evaluate_trajectory, read_all_frames
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.recording_camera import RecordingCamera
from vo_service.odometry import DEFAULT_METHOD, METHODS, MethodConfig
from vo_service.types import NullStageTimer

CalibrationError = Callable[[RgbdFrame], RgbdFrame]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument("--method", choices=METHODS, default=DEFAULT_METHOD)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    for folder in args.folder:
        print(f"{folder}\n{'':28}{'ATE':>10}{'global':>10}{'RPE/1s':>10}{'failed':>10}")
        for name, change in make_calibration_errors().items():
            print(f"{name:28}" + _format_row(folder, args.method, change), flush=True)


def make_calibration_errors() -> Mapping[str, CalibrationError]:
    """Calibration errors by name."""
    return {
        "correct": lambda frame: frame,
        "focal length + 1 %": lambda frame: _focal(frame, 1.01),
        "focal length - 1 %": lambda frame: _focal(frame, 0.99),
        "focal length + 3 %": lambda frame: _focal(frame, 1.03),
        "focal length - 3 %": lambda frame: _focal(frame, 0.97),
        "center + 3 px": lambda frame: _center(frame, 3.0),
        "depth scale + 1 %": lambda frame: _scale(frame, 1.01),
        "depth scale - 1 %": lambda frame: _scale(frame, 0.99),
        "readout + 5 ms": lambda frame: replace(frame, readout_s=frame.readout_s + 0.005),
        "readout - 5 ms": lambda frame: replace(frame, readout_s=max(frame.readout_s - 0.005, 0.0)),
        "depth offset + 5 ms": lambda frame: replace(frame, skew_s=frame.skew_s + 0.005),
        "without timing": lambda frame: replace(frame, readout_s=0.0, skew_s=0.0),
    }


def _format_row(folder: Path, method: str, change: CalibrationError) -> str:
    """Run a method with a calibration error and format its figures."""
    odometry = METHODS[method](MethodConfig(), NullStageTimer())
    stamps_s, estimates = [], []
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        for frame in read_all_frames(camera):
            stamps_s.append(frame.stamp_s)
            estimates.append(odometry.estimate(change(frame)))
        evaluation = evaluate_trajectory(estimates, stamps_s, camera.ground_truth)
    if evaluation is None:
        return f"{'-':>10}" * 3
    errors = (evaluation.ate_rmse_m, evaluation.mean_global_error_m, evaluation.rpe_1s_m)
    cells = ("-" if error is None else f"{1e3 * error:.2f}" for error in errors)
    failed = sum(not estimate.ok for estimate in estimates)
    return "".join(f"{cell:>10}" for cell in (*cells, str(failed)))


def _focal(frame: RgbdFrame, factor: float) -> RgbdFrame:
    camera = frame.camera
    return replace(frame, camera=replace(camera, fx=factor * camera.fx, fy=factor * camera.fy))


def _center(frame: RgbdFrame, shift_px: float) -> RgbdFrame:
    return replace(frame, camera=replace(frame.camera, cx=frame.camera.cx + shift_px))


def _scale(frame: RgbdFrame, factor: float) -> RgbdFrame:
    return replace(frame, depth_factor=frame.depth_factor / factor)
