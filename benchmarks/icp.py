"""Our depth-only ICP compared with OpenCV's and Open3D's: errors and cost.

    python -m benchmarks.icp FOLDER... [--open3d SITE] [--frame-to-frame] [--json]

Each FOLDER is a TUM folder. Open3D is not a dependency: `pip install --target SITE open3d-cpu`
installs it into a separate folder, and without --open3d it is omitted. Times are CPU milliseconds
of the whole process on one thread, without decoding. Distances are in millimeters; `kinect-vo
evaluate` explains the figures. --frame-to-frame adds our ICP with the last frame as the reference.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from benchmarks.camera_frames import read_all_frames
from benchmarks.icp_methods import make_methods
from benchmarks.odometry import evaluate_trajectory
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core.errors import UserFacingError
from drivers.core.trajectory import Trajectory
from drivers.tum.camera import TumCamera
from vo_service.tools.evaluation import Evaluation
from vo_service.types import Estimate, Odometry

# The first frames compile and initialize; their times are not counted.
WARM_UP_FRAMES = 3


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


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.icp",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument(
        "--open3d", type=Path, metavar="SITE", help="folder where Open3D is installed"
    )
    parser.add_argument("--frame-to-frame", action="store_true", help="add our ICP, frame to frame")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[str, dict[str, IcpResult]] = {}
    try:
        compared = make_methods(args.open3d, args.frame_to_frame)
        for folder in args.folder:
            frames, truth = load_depth_frames(folder)
            results[str(folder)] = {
                name: measure(make, frames, truth) for name, make in compared.items()
            }
            if not args.json:
                print(f"{folder}\n{format_table(results[str(folder)])}\n", flush=True)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if args.json:
        print(json.dumps({f: {n: asdict(r) for n, r in m.items()} for f, m in results.items()}))
    return 0


def load_depth_frames(folder: Path) -> tuple[list[RgbdFrame], Trajectory | None]:
    """Load all frames with depth and black color, and the ground truth."""
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        frames = [
            replace(f, color_bgr=np.broadcast_to(np.uint8(0), f.color_bgr.shape))
            for f in read_all_frames(camera)
        ]
        return frames, camera.ground_truth


def measure(
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


def format_table(results: dict[str, IcpResult]) -> str:
    """Format the table, one line for each method."""
    heads = ["frames", "failed", "ATE", "global", "RPE/frame", "RPE/1s", "deg/1s"]
    heads += ["CPU ms", "CPU p99"]
    lines = [f"{'':24}" + "".join(f"{head:>10}" for head in heads)]
    lines += [f"{n:24}" + "".join(f"{c:>10}" for c in table_cells(r)) for n, r in results.items()]
    return "\n".join(lines)


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


if __name__ == "__main__":
    sys.exit(main())
