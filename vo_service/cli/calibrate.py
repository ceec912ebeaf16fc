"""``kinect-vo calibrate``: make a camera file from views of a board, or measure the timing."""

import argparse
import json
import logging
from datetime import date
from pathlib import Path

from drivers.core import InputError
from drivers.core.files import check_suffix
from drivers.core.write_errors import check_output_file
from drivers.registry import CAMERA_USAGES
from vo_service.cli.calibrate_timing import calibrate_timing, save_learned
from vo_service.cli.options import add_topics_option
from vo_service.config import Config, read_config
from vo_service.outputs.rerun.preview import PreviewScene, open_previews
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.board_printing import print_board
from vo_service.tools.calibration.calibration_result import CalibrationResult
from vo_service.tools.calibration.chessboards import USAGE, BoardOptions, make_board
from vo_service.tools.calibration.collect_folder import CollectedViews, collect_from_folder
from vo_service.tools.calibration.collect_live import (
    BoardPreviewFrame,
    LiveCollectionRequest,
    collect_live,
)
from vo_service.tools.calibration.output_files import check_camera_output, save_camera_file
from vo_service.tools.calibration.plot import FORMATS, write_plot
from vo_service.tools.calibration.solver import solve_calibration

EPILOG = """\
examples:
  kinect-vo calibrate --board chessboard:9x6 --square 0.025 --print-board board.pdf
  kinect-vo calibrate --board chessboard:9x6 --square 0.025 --camera freenect
  kinect-vo calibrate --board chessboard:9x6 --square 0.035 --camera openni2 --depth --keep views
  kinect-vo calibrate --board chessboard:9x6 --square 0.035 views --depth --picture coverage.png
  kinect-vo calibrate --timing --camera freenect --camera-file camera.toml
  kinect-vo calibrate --timing recordings/shaken
  kinect-vo calibrate --save-learned --camera-file camera.toml

Print the board, glue it to a flat plate and measure a square. Show the board to the camera: near
and far, in every corner of the image, tilted each way. Hold it still for a moment each time. With a
camera the command ends once it has enough views; Ctrl-C uses the views so far.

--timing needs no board: shake the camera quickly for 15 s, close to textured objects. It writes
readout_s and depth_offset_s with their standard deviations into the camera file, and changes
nothing else. --save-learned writes the same values as a live service has learned them, and
multiplies fx and fy by the factor that it has learned; no camera is needed.

The camera file is written to --output, else to camera.file of the configuration, else to
./camera.toml. An existing file is kept as camera.toml.bak.
"""
DEFAULT_OUTPUT = Path("camera.toml")
_log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument(
        "folder", metavar="FOLDER", type=Path, nargs="?",
        help="a recording, or a folder of images, instead of a camera",
    )  # fmt: skip
    add_topics_option(parser)
    parser.add_argument("--config", metavar="FILE", type=Path, help="configuration file (TOML)")
    parser.add_argument(
        "--camera",
        metavar="SOURCE",
        help=f"see the board live: {', '.join(CAMERA_USAGES.values())}",
    )
    parser.add_argument(
        "--depth", action="store_true",
        help="calibrate the depth camera too: its lens, its pose relative to the color camera, and "
        "its scale; depth must not be registered to color",
    )  # fmt: skip
    parser.add_argument(
        "--timing", action="store_true",
        help="measure readout_s (rolling shutter) and depth_offset_s (delay of depth after its "
        "stamps) from 15 s of fast motion, without a board",
    )  # fmt: skip
    parser.add_argument(
        "--save-learned", action="store_true",
        help="write the timing and the focal length that kinect-vo run has learned of a sensor "
        "into the camera file",
    )  # fmt: skip
    parser.add_argument(
        "--serial", metavar="SERIAL",
        help="with --save-learned: serial number of the sensor (default: the only one)",
    )  # fmt: skip
    parser.add_argument(
        "--camera-file", metavar="FILE", type=Path,
        help="camera file of a recording, for its depth factor (default: FOLDER/camera.toml, else "
        "millimeters); with --timing of a camera too",
    )  # fmt: skip
    _add_board_arguments(parser)
    parser.add_argument(
        "--views", metavar="N", type=int, default=25,
        help="views to take from a camera (default: 25)",
    )  # fmt: skip
    parser.add_argument(
        "--keep", metavar="FOLDER", type=Path,
        help="keep the views taken from a camera, to calibrate again from them",
    )  # fmt: skip
    parser.add_argument(
        "--rerun", metavar="TARGET",
        help="show the camera's image in Rerun: serve (a page on this computer), connect or "
        "connect:HOST:PORT (an open viewer), or FILE.rrd (a recording)",
    )  # fmt: skip
    parser.add_argument(
        "--output", metavar="FILE", type=Path, help="camera file to write (default: see below)"
    )
    parser.add_argument(
        "--picture", metavar="FILE", type=Path,
        help="plot the corners and their residuals (.png or .svg)",
    )  # fmt: skip
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")


def _add_board_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--board", metavar="BOARD", default="chessboard:9x6",
        help=f"{USAGE}; default: chessboard:9x6",
    )  # fmt: skip
    parser.add_argument(
        "--square",
        metavar="M",
        type=parse_length_m,
        help="side of a printed square, in meters, measured",
    )
    parser.add_argument(
        "--marker", metavar="M", type=parse_length_m,
        help="ChArUco: side of a marker, in meters (default: 0.7 of a square)",
    )  # fmt: skip
    parser.add_argument(
        "--dictionary", metavar="NAME", default="4X4_100",
        help="ChArUco: OpenCV's name of the markers (default: 4X4_100)",
    )  # fmt: skip
    parser.add_argument(
        "--print-board", metavar="FILE", type=Path,
        help="write the board, to print at 100 %% (.pdf, .svg or .png), and exit",
    )  # fmt: skip


def parse_length_m(text: str) -> float:
    """Parse the side of a square, in meters.

    Raises:
        ArgumentTypeError: If it is not a length from 1 mm to 1 m.
    """
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.001 <= value <= 1.0:
        raise argparse.ArgumentTypeError(
            f"{text} is out of range: give meters, such as 0.025 for 25 mm"
        )
    return value


def run(args: argparse.Namespace) -> int:
    """Calibrate and save.

    Raises:
        UserFacingError: If an option or a view is not valid, or if a file cannot be written.
    """
    if args.save_learned:
        return save_learned(args)
    if args.serial is not None:
        raise InputError("--serial chooses what --save-learned writes; add --save-learned")
    if args.timing:
        return calibrate_timing(args)
    board = make_board(BoardOptions(args.board, args.square, args.marker, args.dictionary))
    if args.print_board is not None:
        paper = print_board(board, args.print_board)
        print(f"{args.print_board}: {board.name}, to print on {paper} at 100 %")
        return 0
    config = read_config(args.config)
    output: Path = args.output or config.camera.file or DEFAULT_OUTPUT
    _check_arguments(args, output)
    terminal = Terminal()
    taken = _collect_views(args, config, board, terminal)
    calibration = solve_calibration(board, taken, args.depth, terminal)
    terminal.clear()
    _save_and_print(args, calibration, output)
    return 0


def _check_arguments(args: argparse.Namespace, output: Path) -> None:
    """Check before the work, not after it."""
    if (args.folder is None) == (args.camera is None):
        raise InputError("name a FOLDER of images, or a camera to see the board live: --camera")
    if args.keep is not None and args.camera is None:
        raise InputError("--keep keeps what a camera shows: it goes with --camera")
    if args.rerun is not None and args.camera is None:
        raise InputError("--rerun shows what a camera sees: it goes with --camera")
    if args.topics is not None and args.folder is None:
        raise InputError("--topics names the images in a bag: it goes with a FOLDER")
    if args.views < 1:
        raise InputError(f"--views {args.views}: give 1 or more; 25 are good")
    check_camera_output(output)
    if args.picture is not None:
        check_suffix(args.picture, FORMATS)
        check_output_file(args.picture)


def _collect_views(
    args: argparse.Namespace, config: Config, board: Board, terminal: Terminal
) -> CollectedViews:
    if args.folder is not None:
        return collect_from_folder(board, args.folder, args.camera_file, args.depth, terminal)
    request = LiveCollectionRequest(args.camera, config.sensor, args.depth, args.views, args.keep)
    targets = () if args.rerun is None else (args.rerun,)
    with (
        stop_on_signals() as stop,
        open_previews(
            targets, "kinect-vo-calibrate", _load_scene_class, terminal.write_line
        ) as previews,
    ):
        return collect_live(board, request, previews, terminal, stop.event)


def _load_scene_class() -> type[PreviewScene[BoardPreviewFrame]]:
    from vo_service.tools.calibration.rerun_board import BoardScene  # imports rerun

    return BoardScene


def _save_and_print(args: argparse.Namespace, calibration: CalibrationResult, output: Path) -> None:
    for warning in calibration.warnings:
        _log.warning("%s", warning)
    camera = calibration.camera_calibration
    heading = (
        f"kinect-vo calibrate, {date.today()}: {len(calibration.color.views)} views of a "
        f"{calibration.board.name}, corners {calibration.color.rms_px:.3f} px off (rms)"
    )
    kept = save_camera_file(output, camera, heading)
    if args.picture is not None:
        write_plot(args.picture, calibration)
    if args.json:
        files = {"camera_file": str(output), "kept": None if kept is None else str(kept)}
        print(json.dumps(files | calibration.as_json()))
        return
    print(calibration.as_table())
    before = f"; the one before is {kept.name}" if kept else ""
    print(f"\nsaved as {output}{before}: use it with --camera-file {output}, or as camera.file")
