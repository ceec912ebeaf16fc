"""Our depth-only ICP compared with OpenCV's and Open3D's: errors and cost.

    python -m benchmarks icp FOLDER... [--open3d SITE] [--frame-to-frame] [--json]

Each FOLDER is a TUM folder. Open3D is not a dependency: `pip install --target SITE open3d-cpu`
installs it into a separate folder, and without --open3d it is omitted. Times are CPU milliseconds
of the whole process on one thread, without decoding. Distances are in millimeters; `kinect-vo
evaluate` explains the figures. --frame-to-frame adds our ICP with the last frame as the reference.
"""

import argparse
import importlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import cv2
import numpy as np

from benchmarks.harness import add_json_option, format_table, make_printer, print_json
from benchmarks.tracking import evaluate_trajectory, read_all_frames
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core import InputError
from drivers.core.geometry import Array, Trajectory, inverse
from drivers.recording_camera import RecordingCamera
from vo_service.odometry.icp.alignment import FINE_ONLY, align
from vo_service.odometry.icp.depth_pyramid import build_depth_pyramid
from vo_service.odometry.icp.odometry import (
    IcpOdometry,
    IcpParameters,
    IcpTrack,
    rejection_reason,
    start_track,
)
from vo_service.tools.benchmark.baselines.frame_to_frame import (
    FrameToFrameOdometry,
    Open3dIcp,
    OpenCvOdometry,
)
from vo_service.tools.evaluation import Evaluation
from vo_service.types import Estimate, Odometry

OURS, OURS_FRAME_TO_FRAME = "ours", "ours, frame to frame"
OPENCV, OPEN3D = "cv2.Odometry DEPTH", "Open3D point-to-plane"
# The first frames compile and initialize; their times are not counted.
WARM_UP_FRAMES = 3


def load_open3d(folder: Path) -> ModuleType:
    """Import Open3D from a separate folder. Raises InputError if it is not there."""
    sys.path.append(str(folder))
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        raise InputError(
            f"{folder}: cannot import Open3D from there ({error}); install it by "
            f"`pip install --target {folder} open3d-cpu`, or omit --open3d"
        ) from error


class FrameToFrameIcp:
    """Our kernels with the last frame as the reference, without a keyframe."""

    def prepare(self, frame: RgbdFrame) -> IcpTrack:
        """Compute the frame's planes."""
        return start_track(build_depth_pyramid(frame), IcpParameters().max_planes)

    def align(self, earlier: IcpTrack, later: IcpTrack, T_earlier_later: Array) -> Array | None:
        """Align as `IcpOdometry`, without a retry."""
        alignment = align(
            earlier.planes, later.last_frame, [inverse(T_earlier_later), np.eye(4)], FINE_ONLY
        )
        return None if rejection_reason(alignment) else inverse(alignment.T_camera_reference)


def make_methods(
    open3d_folder: Path | None, frame_to_frame: bool
) -> dict[str, Callable[[], Odometry]]:
    """Factories of the methods by name."""
    made: dict[str, Callable[[], Odometry]] = {OURS: IcpOdometry}
    if frame_to_frame:
        made[OURS_FRAME_TO_FRAME] = lambda: FrameToFrameOdometry(FrameToFrameIcp())
    made[OPENCV] = lambda: FrameToFrameOdometry(OpenCvOdometry(cv2.OdometryType_DEPTH))
    if open3d_folder is not None:
        open3d = load_open3d(open3d_folder)
        made[OPEN3D] = lambda: FrameToFrameOdometry(Open3dIcp(open3d))
    return made


@dataclass(frozen=True)
class IcpResult:
    """Result of one method on one folder.

    Attributes:
        frames: Number of frames.
        failed: Frames without a pose.
        cpu_ms: Mean CPU time of a frame.
        cpu_p99_ms: Its 99th percentile.
        evaluation: None without ground truth.
    """

    frames: int
    failed: int
    cpu_ms: float
    cpu_p99_ms: float
    evaluation: Evaluation | None


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument(
        "--open3d", type=Path, metavar="SITE", help="folder where Open3D is installed"
    )
    parser.add_argument("--frame-to-frame", action="store_true", help="add our ICP, frame to frame")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    results: dict[str, dict[str, IcpResult]] = {}
    print_line = make_printer(args)
    compared = make_methods(args.open3d, args.frame_to_frame)
    for folder in args.folder:
        frames, truth = load_depth_frames(folder)
        results[str(folder)] = {
            name: _measure(make, frames, truth) for name, make in compared.items()
        }
        print_line(f"{folder}\n{format_results(results[str(folder)])}\n")
    print_json(args, results)


def load_depth_frames(folder: Path) -> tuple[list[RgbdFrame], Trajectory | None]:
    """Load all frames with depth and black color, and the ground truth."""
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        frames = [
            replace(f, color_bgr=np.broadcast_to(np.uint8(0), f.color_bgr.shape))
            for f in read_all_frames(camera)
        ]
        return frames, camera.ground_truth


def _measure(
    make: Callable[[], Odometry], frames: list[RgbdFrame], truth: Trajectory | None
) -> IcpResult:
    """Run a method on all frames."""
    odometry = make()
    estimates: list[Estimate] = []
    cpu_ms = []
    for frame in frames:
        fresh = replace(frame)  # without values that other methods cached in the frame
        begin_s = time.process_time()
        estimates.append(odometry.estimate(fresh))
        cpu_ms.append((time.process_time() - begin_s) * 1e3)
    counted = cpu_ms[WARM_UP_FRAMES:] or cpu_ms
    return IcpResult(
        frames=len(estimates),
        failed=sum(not e.ok for e in estimates),
        cpu_ms=float(np.mean(counted)),
        cpu_p99_ms=float(np.percentile(counted, 99)),
        evaluation=evaluate_trajectory(estimates, [f.stamp_s for f in frames], truth),
    )


def format_results(results: dict[str, IcpResult]) -> str:
    """Format the table, one line for each method."""
    heads = ["frames", "failed", "ATE", "global", "RPE/frame", "RPE/1s", "deg/1s"]
    heads += ["CPU ms", "CPU p99"]
    return format_table(heads, {name: table_cells(result) for name, result in results.items()})


def table_cells(result: IcpResult) -> list[str]:
    """The columns of one method."""
    e = result.evaluation
    errors = [e.ate_rmse_m, e.mean_global_error_m, e.rpe_frame_m, e.rpe_1s_m] if e else [None] * 4
    turn = e.rpe_1s_deg if e else None
    return [
        *(f"{count}" for count in (result.frames, result.failed)),
        *("-" if error is None else f"{1e3 * error:.1f}" for error in errors),
        "-" if turn is None else f"{turn:.2f}",
        *(f"{spent:.1f}" for spent in (result.cpu_ms, result.cpu_p99_ms)),
    ]
