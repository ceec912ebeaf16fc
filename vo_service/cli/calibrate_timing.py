"""``kinect-vo calibrate --timing`` and ``--save-learned``: a sensor's timing in its camera file."""

import argparse
import json
import logging
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.calibration import (
    CAMERA_FILE_NAME,
    CameraCalibration,
    read_calibration,
)
from drivers.core import InputError, UserFacingError
from drivers.playback.recording_formats import RecordingFormat, recording_format
from drivers.registry import ONI_SUFFIX, SENSORS
from vo_service.cli.options import requested_topics, run_warm_up
from vo_service.cli.recordings import open_requested
from vo_service.config import Config, read_config
from vo_service.odometry.warm_up import warm_up
from vo_service.sensor_memory import (
    SAME_FOCAL_PX,
    RememberedSensor,
    find_remembered_sensors,
    memory_folders,
)
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.calibration.output_files import check_camera_output
from vo_service.tools.calibration.timing import (
    NOTHING_SAVED_PREFIX,
    REMEDY,
    USUAL_TIMING,
    SensorTiming,
    combine,
    is_informative,
    read_camera,
    remembered_as_timing,
    save_timing,
    select_changes,
    told_timing,
)

if TYPE_CHECKING:  # loads the kernels of an odometry, which a learned timing does not need
    from vo_service.tools.calibration.timing_measurement import MeasuredTiming

# Options that are valid only with a board.
BOARD_ONLY_OPTIONS = ("square", "marker", "depth", "keep", "rerun", "picture", "print_board")
logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SavedFile:
    """A camera file that was written, and the backup of the one before; None without one."""

    path: Path
    backup: Path | None


def check_no_board_options(args: argparse.Namespace, mode: str) -> None:
    """Raise InputError if an option is given that only a board has."""
    given = [name for name in BOARD_ONLY_OPTIONS if getattr(args, name)]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is about a board, which {mode} does without; leave one out")


def choose_camera_file(args: argparse.Namespace, config: Config, mode: str) -> Path:
    """Choose the camera file to change.

    Args:
        config: The configuration.
        mode: The option that changes the file, for the error message.

    Raises:
        InputError: None is named.
    """
    named: Path | None = args.output or args.camera_file or config.camera.file
    if named is not None:
        return named
    if args.folder is not None and recording_format(args.folder) is RecordingFormat.TUM:
        return Path(args.folder / CAMERA_FILE_NAME)
    raise InputError(
        f"{mode} puts its result into a camera file: name it with --camera-file, or make one "
        "first, from views of a board"
    )


def print_saved_timing(
    args: argparse.Namespace,
    source: Mapping[str, object],
    values: Mapping[str, SensorTiming],
    saved: SavedFile,
) -> None:
    """Print a table of timings and where the last one is saved, or one JSON object with --json.

    Args:
        source: By name: where the values come from.
        values: By heading: a timing. The last one is that in the file.
    """
    backup = saved.backup
    keys = tuple(next(iter(values.values())))
    if args.json:
        files = {"camera_file": str(saved.path), "kept": None if backup is None else str(backup)}
        numbers = {
            key: {heading: asdict(timing[key]) for heading, timing in values.items()}
            for key in keys
        }
        print(json.dumps(files | dict(source) | numbers))
        return
    print(", ".join(f"{name}: {value}" for name, value in source.items()), end="\n\n")
    print(f"{'':<16}" + "".join(f"{heading:>18}" for heading in values))
    for key in keys:
        print(f"{key:<16}" + "".join(f"{timing[key]!s:>18}" for timing in values.values()))
    before = f"; the one before is {backup.name}" if backup else ""
    print(f"\nsaved in {saved.path}{before}")


def calibrate_timing(args: argparse.Namespace) -> int:
    """Measure the timing and save it.

    Raises:
        UserFacingError: If an option or the recording is not valid, if the result is less certain
            than what is known, or if the file cannot be written.
    """
    if (args.folder is None) == (args.camera is None):
        raise InputError("name a FOLDER that was recorded, or a camera to shake: --camera")
    config = read_config(args.config)
    output = choose_camera_file(args, config, "--timing")
    _check_arguments(args, output)
    terminal = Terminal()
    measured = _measure(args, config, terminal)
    camera = read_camera(output, measured.camera)
    is_kinect = _is_kinect(args.camera, measured.camera)
    told = told_timing(camera, is_kinect)
    now = combine(measured.timing, USUAL_TIMING) if is_kinect else measured.timing
    changes = select_changes(told, now)
    if not (is_informative(measured.timing) and changes):
        raise UserFacingError(_refusal(told, measured))
    heading = f"kinect-vo calibrate --timing, {date.today()}: {measured.frame_count} frames"
    kept = save_timing(output, measured.camera, changes, heading)
    values = {"before": told, "measured": measured.timing, "now": told | changes}
    source = {"frames": measured.frame_count}
    print_saved_timing(args, source, values, SavedFile(output, kept))
    return 0


def _is_kinect(source: str | None, camera: CameraCalibration) -> bool:
    """Whether the usual timing of a Kinect holds: for a sensor, and for a recording of one."""
    kind, _, argument = (source or "").partition(":")
    is_sensor = kind in SENSORS and not argument.lower().endswith(ONI_SUFFIX)
    return is_sensor or told_timing(camera) == USUAL_TIMING


def _refusal(told: SensorTiming, measured: "MeasuredTiming") -> str:
    values = (
        f"{name} {measured.timing[key]} (known: {told[key]})"
        for name, key in (("readout", "readout_s"), ("depth offset", "depth_offset_s"))
    )
    return (
        f"{NOTHING_SAVED_PREFIX}the camera moved too slowly or too little to determine its timing "
        f"better than it is known: {', '.join(values)}; {REMEDY}"
    )


def _check_arguments(args: argparse.Namespace, output: Path) -> None:
    """Check before the work, not after it."""
    check_no_board_options(args, "--timing")
    check_camera_output(output)
    if args.folder is not None:
        _check_recording(args, output)


def _check_recording(args: argparse.Namespace, output: Path) -> None:
    folder, file = args.folder, args.camera_file
    read = open_requested(args, file).calibration
    is_read = output.resolve() == (file or folder / CAMERA_FILE_NAME).resolve()
    offset_s = read_camera(output, read).depth_offset_s
    if offset_s != 0.0 and not is_read:
        raise InputError(
            f"{output}: depth_offset_s = {offset_s:g} may be in the stamps of {folder} already; "
            "measure with the camera, or set it to 0 and record again"
        )


def _measure(args: argparse.Namespace, config: Config, terminal: Terminal) -> "MeasuredTiming":
    from vo_service.tools.calibration.timing_measurement import measure_folder, measure_live

    with stop_on_signals() as stop:
        run_warm_up(partial(warm_up, "direct"), terminal, stop)
        if args.folder is not None:
            measured = measure_folder(
                args.folder, args.camera_file, requested_topics(args), terminal, stop.event
            )
            stop.check()
        else:
            file = args.camera_file or config.camera.file or args.output
            measured = measure_live(args.camera, file, config.sensor, terminal, stop.event)
    terminal.clear()
    return measured


def save_learned(args: argparse.Namespace) -> int:
    """Write the learned timing and focal length of a sensor into a camera file.

    Raises:
        InputError: If nothing has been learned, if it is unclear of which sensor, or if an option
            or the camera file is not valid.
        UserFacingError: If the file cannot be written.
    """
    if args.timing or args.folder is not None or args.camera is not None:
        raise InputError(
            "--save-learned takes what a service has learned, without a camera; leave out FOLDER, "
            "--camera and --timing"
        )
    check_no_board_options(args, "--save-learned")
    config = read_config(args.config)
    output = choose_camera_file(args, config, "--save-learned")
    check_camera_output(output)
    file: Path = args.camera_file or config.camera.file or output
    fallback = read_calibration(file)
    learned = _choose_sensor(args.serial)
    camera = read_camera(output, fallback)
    told, now = told_timing(camera), remembered_as_timing(learned)
    heading = f"kinect-vo calibrate --save-learned, {date.today()}: sensor {learned.serial}"
    focal = learned.focal_length
    prior = None if focal is None else focal.prior_for(camera.fx)
    scale = 1.0 if prior is None else prior.scale
    kept = save_timing(output, fallback, now, heading, scale)
    values = {"before": told, "now": now}
    source: dict[str, object] = {"serial": learned.serial}
    if scale != 1.0:
        source["factor on fx and fy"] = round(scale, 5)
    print_saved_timing(args, source, values, SavedFile(output, kept))
    if focal is not None and abs(focal.fx - camera.fx) > SAME_FOCAL_PX:
        logger.warning(
            "fx and fy are unchanged: the focal length was learned with fx = %.2f, but %s has %.2f",
            focal.fx,
            output,
            camera.fx,
        )
    return 0


def _choose_sensor(serial: str | None) -> RememberedSensor:
    """Return what was learned of a sensor, or of the only one.

    Raises:
        InputError: There is none, or there are several.
    """
    folders = memory_folders()
    remembered = find_remembered_sensors(folders)
    known = ", ".join(sorted(remembered))
    if not remembered:
        searched = ", ".join(map(str, folders)) or "no folder"
        raise InputError(
            f"no service has learned a timing yet (searched: {searched}); let kinect-vo run until "
            "camera.sensor_timing_source in its status is learned, and use sudo for a service of "
            "systemd"
        )
    if serial is not None and serial not in remembered:
        raise InputError(f"--serial {serial}: nothing is learned of it; known: {known}")
    if serial is None and len(remembered) > 1:
        raise InputError(f"several sensors are known; choose one with --serial: {known}")
    return remembered[serial if serial is not None else known]
