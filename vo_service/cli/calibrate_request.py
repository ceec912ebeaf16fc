"""The request of ``kinect-vo calibrate``: by a board, by motion, or by what was learned."""

from dataclasses import dataclass
from pathlib import Path

from drivers.calibration import CAMERA_FILE_NAME
from drivers.core import InputError
from drivers.playback.recording_formats import RecordingFormat, recording_format
from drivers.registry import CAMERA_USAGES
from vo_service.cli.options import RERUN_TARGETS, ConfigFile, Json, Topics, parse_length_m
from vo_service.cli.request import CommandRequest, argument, flag, option
from vo_service.config import Config
from vo_service.tools.calibration.chessboards import USAGE
from vo_service.tools.calibration.output_files import check_camera_output

# Options that are valid only with a board.
BOARD_ONLY_OPTIONS = ("square", "marker", "depth", "keep", "rerun", "picture", "print_board")


@dataclass(frozen=True, kw_only=True)
class CalibrationRequest(CommandRequest):
    """What is measured, and where the camera file is."""

    folder: Path | None = argument(
        "a recording, or a folder of images, instead of a camera", "FOLDER", default=None
    )
    topics: Topics = None
    config: ConfigFile = None
    camera: str | None = option(
        f"see the board live: {', '.join(CAMERA_USAGES.values())}", metavar="SOURCE"
    )
    depth: bool = flag(
        "calibrate the depth camera too: its lens, its pose relative to the color camera, and "
        "its scale; depth must not be registered to color"
    )
    timing: bool = flag(
        "measure readout_s (rolling shutter) and depth_offset_s (delay of depth after its "
        "stamps) from 15 s of fast motion, without a board"
    )
    save_learned: bool = flag(
        "write the timing and the focal length that kinect-vo run has learned of a sensor "
        "into the camera file"
    )
    serial: str | None = option(
        "with --save-learned: serial number of the sensor (default: the only one)", metavar="SERIAL"
    )
    camera_file: Path | None = option(
        "camera file of a recording, for its depth factor (default: FOLDER/camera.toml, else "
        "millimeters); with --timing of a camera too",
        metavar="FILE",
    )
    board: str = option(f"{USAGE}; default: chessboard:9x6", "chessboard:9x6", "BOARD")
    square: float | None = option(
        "side of a printed square, in meters, measured", None, "M", parse_length_m
    )
    marker: float | None = option(
        "ChArUco: side of a marker, in meters (default: 0.7 of a square)", None, "M", parse_length_m
    )
    dictionary: str = option(
        "ChArUco: OpenCV's name of the markers (default: 4X4_100)", "4X4_100", "NAME"
    )
    print_board: Path | None = option(
        "write the board, to print at 100 %% (.pdf, .svg or .png), and exit", metavar="FILE"
    )
    views: int = option("views to take from a camera (default: 25)", 25, "N", int)
    keep: Path | None = option(
        "keep the views taken from a camera, to calibrate again from them", metavar="FOLDER"
    )
    rerun: str | None = option(
        f"show the camera's image in Rerun: {RERUN_TARGETS}", metavar="TARGET"
    )
    output: Path | None = option("camera file to write (default: see below)", metavar="FILE")
    picture: Path | None = option(
        "plot the corners and their residuals (.png or .svg)", metavar="FILE"
    )
    json: Json = False

    def folder_or_camera(self, advice: str) -> Path | str:
        """Return the one that is given; raise InputError with `advice` for none or both."""
        if self.folder is not None and self.camera is None:
            return self.folder
        if self.camera is not None and self.folder is None:
            return self.camera
        raise InputError(advice)

    def file_to_change(self, config: Config, mode: str) -> Path:
        """Choose the camera file that the option `mode`, which needs no board, changes.

        Raises:
            UserFacingError: An option is given that only a board has, or there is no such file, or
                it cannot be written.
        """
        file = self.output or self.camera_file or config.camera.file
        if file is None and self.folder and recording_format(self.folder) is RecordingFormat.TUM:
            file = self.folder / CAMERA_FILE_NAME
        if file is None:
            raise InputError(
                f"{mode} puts its result into a camera file: name it with --camera-file, or make "
                "one first, from views of a board"
            )
        given = [name for name in BOARD_ONLY_OPTIONS if getattr(self, name)]
        if given:
            option = f"--{given[0].replace('_', '-')}"
            raise InputError(f"{option} is about a board, which {mode} does without; leave one out")
        check_camera_output(file)
        return file
