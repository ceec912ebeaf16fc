"""Options --loop-closure and --optimized-trajectory: loop closure over a recording."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core.files import atomic_write
from drivers.core.geometry import Array, Trajectory, format_pose_line
from drivers.core.write_errors import check_output_file
from vo_service.cli.options import prepare_loop_closure
from vo_service.config import Config
from vo_service.signals import StopSignal
from vo_service.terminal import Terminal
from vo_service.tools.evaluation.run_summary import LoopClosureSummary, evaluate_if_possible

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.synchronous_loop_closure import SynchronousLoopClosure


def add_loop_closure_options(parser: argparse.ArgumentParser) -> None:
    """Add --loop-closure and --optimized-trajectory."""
    parser.add_argument(
        "--loop-closure",
        action="store_true",
        help="enable loop closure and optimize the trajectory",
    )
    parser.add_argument(
        "--optimized-trajectory", metavar="FILE", type=Path,
        help="write the trajectory as optimized by loop closure; implies --loop-closure",
    )  # fmt: skip


def make_requested_loop_closure(
    args: argparse.Namespace, config: Config, terminal: Terminal, stop: StopSignal
) -> "SynchronousLoopClosure | None":
    """Make loop closure if an option requests it, else return None.

    Args:
        config: Gives the table `[map]`.

    Raises:
        KeyboardInterrupt: If a stop is requested.
        UserFacingError: If the compiled kernels cannot be written.
    """
    if args.optimized_trajectory is None and not args.loop_closure:
        return None
    return make_loop_closure(config, terminal, stop)


def make_loop_closure(
    config: Config, terminal: Terminal, stop: StopSignal
) -> "SynchronousLoopClosure":
    """Make loop closure with an empty map.

    Args:
        config: Gives the table `[map]`.

    Raises:
        KeyboardInterrupt: If a stop is requested.
        UserFacingError: If the compiled kernels cannot be written.
    """
    prepare_loop_closure(terminal, stop)
    from vo_service.slam.synchronous_loop_closure import create_synchronous_loop_closure

    return create_synchronous_loop_closure(config.map)


def write_optimized_trajectory(
    path: Path, trajectory: Trajectory, published_after_s: float
) -> None:
    """Write a trajectory file atomically.

    Args:
        trajectory: The trajectory, with stamps on the camera's clock.
        published_after_s: Offset from the camera's clock to the published clock, s.

    Raises:
        WriteError: If the file cannot be written.
    """
    lines = map(
        format_pose_line, trajectory.stamps_s + published_after_s, trajectory.T_world_camera
    )
    atomic_write(path, "".join(lines).encode())


def summarize_loop_closure(
    loop_closure: "SynchronousLoopClosure", truth: Trajectory | None, frames_s: Array
) -> LoopClosureSummary:
    """Summarize loop closure.

    Args:
        loop_closure: Loop closure after the run.
        truth: The ground truth; None: unknown.
        frames_s: (N,) stamps of the recording's frames, s.
    """
    closer = loop_closure.loop_closer
    return LoopClosureSummary(
        len(closer.database),
        closer.loop_count,
        evaluate_if_possible(loop_closure.trajectory, truth, frames_s),
    )


def check_optimized_trajectory_path(args: argparse.Namespace) -> None:
    """Check before the run that the optimized trajectory can be written.

    Raises:
        UserFacingError: If it cannot.
    """
    if args.optimized_trajectory is not None:
        check_output_file(args.optimized_trajectory)
