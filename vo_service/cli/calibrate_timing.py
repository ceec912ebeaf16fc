"""``kinect-vo calibrate --timing``: measure readout and depth offset from fast motion."""

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict
from datetime import date
from functools import partial
from pathlib import Path
from typing import Any

from drivers.calibration import (
    CAMERA_FILE_NAME,
    CameraCalibration,
    find_calibration,
)
from drivers.core.errors import InputError, UserFacingError
from drivers.registry import ONI_SUFFIX, SENSORS
from vo_service.cli.kernels import run_warm_up
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
    select_changes,
    told_timing,
)
from vo_service.tools.calibration.timing_file import read_camera, save_timing
from vo_service.tools.calibration.timing_measurement import (
    MeasuredTiming,
    measure_folder,
    measure_live,
)

# Options that are valid only with a board.
BOARD_ONLY_OPTIONS = ("square", "marker", "depth", "keep", "rerun", "picture", "print_board")


def calibrate_timing(args: argparse.Namespace) -> int:
    """Measure the timing and save it.

    Raises:
        UserFacingError: If an option or the recording is not valid, if the result is less certain
            than what is known, or if the file cannot be written.
    """
    if (args.folder is None) == (args.camera is None):
        raise InputError("name a FOLDER that was recorded, or a camera to shake: --camera")
    config = read_config(args.config)
    output = _choose_output(args, config)
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
    if args.json:
        files = {"camera_file": str(output), "kept": None if kept is None else str(kept)}
        print(json.dumps(files | {"frames": measured.frame_count} | _as_json(values)))
        return 0
    print(f"{measured.frame_count} frames\n")
    print_saved_timing(values, output, kept)
    return 0


def print_saved_timing(values: Mapping[str, SensorTiming], output: Path, kept: Path | None) -> None:
    """Print a table of timings, and where the last one is saved.

    Args:
        values: By heading: a timing. The first one is that of before.
        output: The camera file.
        kept: Its backup, if there is one.
    """
    print(f"{'':<16}" + "".join(f"{heading:>18}" for heading in values))
    for key in next(iter(values.values())):
        print(f"{key:<16}" + "".join(f"{timing[key]!s:>18}" for timing in values.values()))
    backup = f"; the one before is {kept.name}" if kept else ""
    print(f"\nsaved in {output}{backup}")


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


def _choose_output(args: argparse.Namespace, config: Config) -> Path:
    """Choose the camera file to change."""
    named: Path | None = args.output or args.camera_file or config.camera.file
    if named is not None:
        return named
    if args.folder is not None:
        return Path(args.folder / CAMERA_FILE_NAME)
    raise InputError(
        "--timing puts its result into a camera file: name it with --camera-file, or make one "
        "first, from views of a board"
    )


def _check_arguments(args: argparse.Namespace, output: Path) -> None:
    """Check before the work, not after it."""
    given = [name for name in BOARD_ONLY_OPTIONS if getattr(args, name)]
    if given:
        option = f"--{given[0].replace('_', '-')}"
        raise InputError(f"{option} is about a board, which --timing does without; leave one out")
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


def _as_json(values: Mapping[str, SensorTiming]) -> dict[str, Any]:
    """Return for each key what was told, measured and saved, with standard deviations."""
    return {
        key: {heading: asdict(timing[key]) for heading, timing in values.items()}
        for key in USUAL_TIMING
    }
