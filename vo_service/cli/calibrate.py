"""``kinect-vo calibrate``: make a camera file from views of a board, or measure the timing."""

import json
import logging
from datetime import date
from pathlib import Path

from drivers.core import InputError
from drivers.core.files import check_suffix
from drivers.core.write_errors import check_output_file
from vo_service.cli.calibrate_learned import save_learned
from vo_service.cli.calibrate_request import CalibrationRequest
from vo_service.cli.calibrate_timing import calibrate_timing
from vo_service.config import Config, read_config
from vo_service.outputs.rerun.preview import PreviewScene, open_previews
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.calibration.board import Board
from vo_service.tools.calibration.board_printing import print_board
from vo_service.tools.calibration.calibration_result import CalibrationResult
from vo_service.tools.calibration.chessboards import make_board
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
./camera.toml. --timing and --save-learned change the file of --output, else of --camera-file, else
of the configuration, else that of the recording. An existing file is kept as camera.toml.bak, or as
camera.toml.bak2 and so on beside earlier ones.
"""
DEFAULT_OUTPUT = Path("camera.toml")
_log = logging.getLogger(__name__)


def run(request: CalibrationRequest) -> int:
    """Calibrate and save."""
    if request.save_learned:
        return save_learned(request)
    if request.serial is not None:
        raise InputError("--serial chooses what --save-learned writes; add --save-learned")
    if request.timing:
        return calibrate_timing(request)
    board = make_board(request.board, request.square, request.marker, request.dictionary)
    if request.print_board is not None:
        paper = print_board(board, request.print_board)
        print(f"{request.print_board}: {board.name}, to print on {paper} at 100 %")
        return 0
    config = read_config(request.config)
    output = request.output or config.camera.file or DEFAULT_OUTPUT
    source = request.folder_or_camera(
        "name a FOLDER of images, or a camera to see the board live: --camera"
    )
    _check_request(request, output)
    terminal = Terminal()
    taken = _collect_views(source, request, config, board, terminal)
    calibration = solve_calibration(board, taken, request.depth, terminal)
    terminal.clear()
    _save_and_print(request, calibration, output)
    return 0


def _check_request(request: CalibrationRequest, output: Path) -> None:
    """Check before the work, not after it."""
    if request.keep is not None and request.camera is None:
        raise InputError("--keep keeps what a camera shows: it goes with --camera")
    if request.rerun is not None and request.camera is None:
        raise InputError("--rerun shows what a camera sees: it goes with --camera")
    if request.topics is not None and request.folder is None:
        raise InputError("--topics names the images in a bag: it goes with a FOLDER")
    if request.views < 1:
        raise InputError(f"--views {request.views}: give 1 or more; 25 are good")
    check_camera_output(output)
    if request.picture is not None:
        check_suffix(request.picture, FORMATS)
        check_output_file(request.picture)


def _collect_views(
    source: Path | str,
    request: CalibrationRequest,
    config: Config,
    board: Board,
    terminal: Terminal,
) -> CollectedViews:
    if isinstance(source, Path):
        return collect_from_folder(board, source, request.camera_file, request.depth, terminal)
    collection = LiveCollectionRequest(
        source, config.sensor, request.depth, request.views, request.keep
    )
    targets = () if request.rerun is None else (request.rerun,)
    with (
        stop_on_signals() as stop,
        open_previews(
            targets, "kinect-vo-calibrate", _load_scene_class, terminal.write_line
        ) as previews,
    ):
        return collect_live(board, collection, previews, terminal, stop.event)


def _load_scene_class() -> type[PreviewScene[BoardPreviewFrame]]:
    from vo_service.tools.calibration.rerun_board import BoardScene  # imports rerun

    return BoardScene


def _save_and_print(
    request: CalibrationRequest, calibration: CalibrationResult, output: Path
) -> None:
    for warning in calibration.warnings:
        _log.warning("%s", warning)
    camera = calibration.camera_calibration
    heading = (
        f"kinect-vo calibrate, {date.today()}: {len(calibration.color.views)} views of a "
        f"{calibration.board.name}, corners {calibration.color.rms_px:.3f} px off (rms)"
    )
    kept = save_camera_file(output, camera, heading)
    if request.picture is not None:
        write_plot(request.picture, calibration)
    if request.json:
        files = {"camera_file": str(output), "kept": None if kept is None else str(kept)}
        print(json.dumps(files | calibration.as_json()))
        return
    print(calibration.as_table())
    before = f"; the one before is {kept.name}" if kept else ""
    print(f"\nsaved as {output}{before}: use it with --camera-file {output}, or as camera.file")
