"""``kinect-vo reconstruct``: make a colored mesh from a recording."""

import argparse
from collections.abc import Callable
from pathlib import Path

from vo_service.cli.options import add_camera_file_option, add_config_options, add_topics_option
from vo_service.cli.recordings import RECORDING_HELP
from vo_service.reconstruction.voxel_block_grid import TsdfConfig

EPILOG = """\
examples:
  kinect-vo reconstruct recordings/desk
  kinect-vo reconstruct recordings/desk recordings/desk/groundtruth.txt --voxel-m 0.005
  kinect-vo reconstruct recordings/desk desk.txt --rerun serve --output maps/desk
  kinect-vo reconstruct recordings/tour --loop-closure

Without TRAJECTORY the odometry runs first, and frames that it does not track well are left out.
--loop-closure optimizes its poses, so that surfaces seen twice coincide, and the odometry
relocalizes after a loss.
OUTPUT receives map.ply (a mesh with colors and normals, in the trajectory's world), top.png,
perspective.png, view.png, reconstruction.json, and trajectory.txt if the odometry ran.
Ctrl-C ends the fusion and writes the surface so far; a second Ctrl-C writes nothing more.
"""
MIN_VOXEL_M, MAX_VOXEL_M = 0.002, 0.5
MIN_MEMORY_MB = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    defaults = TsdfConfig()
    parser.add_argument("folder", metavar="RECORDING", type=Path, help=RECORDING_HELP)
    add_topics_option(parser)
    parser.add_argument(
        "trajectory", metavar="TRAJECTORY", type=Path, nargs="?",
        help="poses of the optical camera, as in groundtruth.txt (default: the odometry's)",
    )  # fmt: skip
    add_config_options(parser)
    parser.add_argument(
        "--loop-closure", action="store_true",
        help="enable loop closure and optimize the odometry's poses before the fusion",
    )  # fmt: skip
    add_camera_file_option(parser)
    parser.add_argument(
        "--output", metavar="FOLDER", type=Path, default=Path("output/reconstruct"),
        help="folder for the results (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--voxel-m", metavar="M", default=defaults.voxel_m,
        type=_length_parser(MIN_VOXEL_M, MAX_VOXEL_M),
        help="voxel size, in meters (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--memory-mb", metavar="MB", type=_megabytes_parser(MIN_MEMORY_MB),
        default=defaults.memory_mb,
        help="memory limit of the map; later surfaces are left out (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--max-depth-m", metavar="M", type=_length_parser(0.1, 20.0), default=defaults.max_depth_m,
        help="surfaces farther from the camera are left out (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--rerun", metavar="TARGET", action="append",
        help="show the progress in Rerun: serve (a page on this computer), connect or "
        "connect:HOST:PORT (an open viewer), or FILE.rrd; may be given several times",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")


def _length_parser(min_m: float, max_m: float) -> Callable[[str], float]:
    """Make a parser of lengths in meters."""

    def meters(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not min_m <= value <= max_m:
            raise argparse.ArgumentTypeError(f"{text} is not a length: give {min_m:g} to {max_m:g}")
        return value

    return meters


def _megabytes_parser(min_mb: int) -> Callable[[str], int]:
    """Make a parser of whole numbers."""

    def megabytes(text: str) -> int:
        if not (text.isascii() and text.isdigit() and len(text) < 8 and int(text) >= min_mb):
            raise argparse.ArgumentTypeError(
                f"{text} is not a size: give {min_mb} or more, a whole number"
            )
        return int(text)

    return megabytes


def run(args: argparse.Namespace) -> int:
    """Estimate or read the poses, fuse the frames, and write the results.

    Raises:
        UserFacingError: If an input is not valid, or if a result cannot be written.
    """
    from vo_service.cli.reconstruct_pipeline import run_reconstruction

    return run_reconstruction(args)
