"""--loops and --trajectory-corrected: places that are known again in a recording."""

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError, UserFacingError
from drivers.geometry import Array
from drivers.trajectory import StampedPoses, pose_line
from drivers.tum.whole_files import write_whole
from vo_service.commands.kernels import prepare_loops
from vo_service.config import Config
from vo_service.interrupts import Stop
from vo_service.summary import WithLoops, evaluated
from vo_service.terminal import Terminal

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.mapping.loops.inline import InlineLoops


def add_loops_options(parser: argparse.ArgumentParser) -> None:
    """Declare both."""
    parser.add_argument(
        "--loops", action="store_true", help="know places again, and correct the way by them"
    )
    parser.add_argument(
        "--trajectory-corrected", metavar="FILE", type=Path,
        help="write the poses as the loops have corrected them in the end; means --loops",
    )  # fmt: skip


def loops_of(
    args: argparse.Namespace, config: Config, terminal: Terminal, stop: Stop
) -> "InlineLoops | None":
    """Loops, if they are asked for, and all that they need. Raises as `prepare_loops`."""
    if args.trajectory_corrected is None and not args.loops:
        return None
    return prepared_loops(config, terminal, stop)


def prepared_loops(config: Config, terminal: Terminal, stop: Stop) -> "InlineLoops":
    """Loops that know no place yet. Raises as `prepare_loops`."""
    prepare_loops(terminal, stop)
    from vo_service.mapping.loops.opening import open_inline_loops

    return open_inline_loops(config.map)


def write_corrected(path: Path, trajectory: StampedPoses, published_after_s: float) -> None:
    """Write a trajectory whole, under published stamps. Raises UserFacingError."""
    lines = map(pose_line, trajectory.stamps_s + published_after_s, trajectory.T_world_camera)
    try:
        write_whole(path, "".join(lines).encode())
    except OSError as error:
        raise UserFacingError(f"{path}: the trajectory is not written: {error.strerror}") from error


def gained(loops: "InlineLoops", truth: StampedPoses | None, frames_s: Array) -> WithLoops:
    """For the summary: what the loops have changed."""
    closer = loops.closer
    return WithLoops(len(closer.places), closer.loops, evaluated(loops.trajectory, truth, frames_s))


def check_corrected(args: argparse.Namespace) -> None:
    """Raise InputError for what would only be found out in the end: it could not be written."""
    path: Path | None = args.trajectory_corrected
    if path is None:
        return
    is_file_or_new = path.is_file() or not path.exists()
    folder = path.parent  # a file is written whole beside the old one, and takes its place
    if not (is_file_or_new and folder.is_dir() and os.access(folder, os.W_OK)):
        raise InputError(
            f"{path}: cannot write the trajectory; name a file in a folder that you may write to"
        )
