"""Tracking of recordings with corrupted pieces, with and without recovery.

    python -m benchmarks.recovery FOLDER... [--json]

Each FOLDER is a TUM folder of some hundred frames, which are all held in memory. A frame is lost if
it has no pose; after 30 in a row tracking restarts in a new epoch. The ATE is that of all published
poses, across epochs, in millimeters. CPU milliseconds are the largest of any frame, without
decoding. "without" compares each frame with the last good one only.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2

from benchmarks.camera_frames import read_all_frames
from benchmarks.frame_corruption import CORRUPTIONS, Frames
from benchmarks.odometry import evaluate_trajectory
from drivers.camera import PlaybackMode
from drivers.core.errors import UserFacingError
from drivers.core.trajectory import Trajectory
from drivers.tum.camera import TumCamera
from vo_service.odometry.features import FeatureView, SurfParameters
from vo_service.odometry.registry import warm_up
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.odometry.surf.recovery import RecoveredPose, SurfRecovery


class NullRecovery(SurfRecovery):
    """Never recovers."""

    def recover(self, view: FeatureView, last: FeatureView, turn: int) -> RecoveredPose | None:
        """See `SurfRecovery`."""
        return None


RECOVERIES = {"without": NullRecovery, "with": SurfRecovery}


@dataclass(frozen=True)
class RecoveryOutcome:
    """Result of one pass: frames, frames without a pose, new epochs, and the error."""

    frames: int
    lost: int
    epochs: int
    ate_m: float | None
    cpu_ms: float


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.recovery",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    output = discard_line if args.json else print_line
    try:
        results = {str(folder): measure(folder, output) for folder in args.folder}
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if args.json:
        print(json.dumps(results, default=asdict))
    return 0


def print_line(line: str) -> None:
    """Print a line of the table at once."""
    print(line, flush=True)


def discard_line(line: str) -> None:
    """Print nothing."""


def measure(
    folder: Path, print_line: Callable[[str], None]
) -> dict[str, dict[str, RecoveryOutcome]]:
    """Measure all corruptions; results by corruption, then by recovery."""
    frames, truth = load_frames(folder)
    warm_up("surf", discard_line)
    print_line(f"{folder}\n{format_header()}")
    results: dict[str, dict[str, RecoveryOutcome]] = {}
    for name, corruption in CORRUPTIONS.items():
        corrupted = corruption.apply(frames)
        results[name] = {recovery: track(corrupted, truth, recovery) for recovery in RECOVERIES}
        print_line(format_row(name, results[name]))
    return results


def load_frames(folder: Path) -> tuple[Frames, Trajectory | None]:
    """Load all frames of a folder, and the ground truth."""
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        return list(read_all_frames(camera)), camera.ground_truth


def track(frames: Frames, truth: Trajectory | None, recovery: str) -> RecoveryOutcome:
    """Track all frames once."""
    parameters = SurfParameters()
    odometry = SurfOdometry(parameters=parameters, recovery=RECOVERIES[recovery](parameters))
    estimates, cpu_ms = [], 0.0
    for frame in frames:
        begin_s = time.thread_time()
        estimates.append(odometry.estimate(frame))
        cpu_ms = max(cpu_ms, (time.thread_time() - begin_s) * 1e3)
    evaluation = evaluate_trajectory(estimates, [frame.stamp_s for frame in frames], truth)
    return RecoveryOutcome(
        frames=len(frames),
        lost=sum(not e.ok for e in estimates),
        epochs=sum(e.is_reset for e in estimates),
        ate_m=evaluation.ate_rmse_m if evaluation else None,
        cpu_ms=cpu_ms,
    )


def format_header() -> str:
    """Format the column heads."""
    names = ("frames", "lost", "", "epochs", "", "ATE", "", "CPU ms", "")
    recoveries = ("", *("without", "with") * 4)
    return (
        f"{'':16}"
        + "".join(f"{n:>9}" for n in names)
        + f"\n{'':16}"
        + "".join(f"{recovery:>9}" for recovery in recoveries)
    )


def format_row(name: str, outcomes: Mapping[str, RecoveryOutcome]) -> str:
    """Format one corruption: each figure without recovery, then with it."""
    both = [outcomes[recovery] for recovery in RECOVERIES]
    cells = [f"{both[0].frames}"]
    cells += [f"{o.lost}" for o in both] + [f"{o.epochs}" for o in both]
    cells += ["-" if o.ate_m is None else f"{1e3 * o.ate_m:.1f}" for o in both]
    cells += [f"{o.cpu_ms:.1f}" for o in both]
    return f"{name:16}" + "".join(f"{cell:>9}" for cell in cells)


if __name__ == "__main__":
    sys.exit(main())
