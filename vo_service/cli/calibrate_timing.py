"""``kinect-vo calibrate --timing``: measure readout and depth offset from fast motion."""

import argparse
from datetime import date
from functools import partial
from pathlib import Path

from drivers.calibration import (
    CAMERA_FILE_NAME,
    CameraCalibration,
    find_calibration,
)
from drivers.core.errors import InputError, UserFacingError
from drivers.registry import ONI_SUFFIX, SENSORS
from vo_service.cli.kernels import run_warm_up
from vo_service.cli.saved_timing import (
    SavedFile,
    check_no_board_options,
    choose_camera_file,
    print_saved_timing,
)
from vo_service.config import Config, read_config
from vo_service.odometry.registry import warm_up
from vo_service.signals import stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.calibration.output_files import check_writable
from vo_service.tools.calibration.timing import (
    NOTHING_SAVED_PREFIX,
    REMEDY,
    USUAL_TIMING,
    SensorTiming,
    combine,
    is_informative,
    read_camera,
    save_timing,
    select_changes,
    told_timing,
)
from vo_service.tools.calibration.timing_measurement import (
    MeasuredTiming,
    measure_folder,
    measure_live,
)


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


def _refusal(told: SensorTiming, measured: MeasuredTiming) -> str:
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
    check_writable(output)
    if args.folder is not None:
        _check_recording(args.folder, args.camera_file, output)


def _check_recording(folder: Path, file: Path | None, output: Path) -> None:
    read = find_calibration(folder, file)
    is_read = output.resolve() == (file or folder / CAMERA_FILE_NAME).resolve()
    offset_s = read_camera(output, read).depth_offset_s
    if offset_s != 0.0 and not is_read:
        raise InputError(
            f"{output}: depth_offset_s = {offset_s:g} may be in the stamps of {folder} already; "
            "measure with the camera, or set it to 0 and record again"
        )


def _measure(args: argparse.Namespace, config: Config, terminal: Terminal) -> MeasuredTiming:
    with stop_on_signals() as stop:
        run_warm_up(partial(warm_up, "direct"), terminal, stop)
        if args.folder is not None:
            measured = measure_folder(args.folder, args.camera_file, terminal, stop.event)
            stop.check()
        else:
            file = args.camera_file or config.camera.file or args.output
            measured = measure_live(args.camera, file, config.sensor, terminal, stop.event)
    terminal.clear()
    return measured
