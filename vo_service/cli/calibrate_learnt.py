"""``kinect-vo calibrate --save-learnt``: write what a service has learned into a camera file."""

import argparse
from datetime import date
from pathlib import Path

from drivers.calibration import read_calibration
from drivers.core.errors import InputError
from vo_service.cli.saved_timing import (
    SavedFile,
    check_no_board_options,
    choose_camera_file,
    print_saved_timing,
)
from vo_service.config import read_config
from vo_service.remembered_timing import RememberedTiming, find_remembered_timings, memory_folders
from vo_service.tools.calibration.output_files import check_writable
from vo_service.tools.calibration.timing import (
    read_camera,
    remembered_as_timing,
    save_timing,
    told_timing,
)


def save_learnt(args: argparse.Namespace) -> int:
    """Write the learned timing of a sensor into a camera file.

    Raises:
        InputError: If nothing has been learned, if it is unclear of which sensor, or if an option
            or the camera file is not valid.
        UserFacingError: If the file cannot be written.
    """
    if args.timing or args.folder is not None or args.camera is not None:
        raise InputError(
            "--save-learnt takes what a service has learned, without a camera; leave out FOLDER, "
            "--camera and --timing"
        )
    check_no_board_options(args, "--save-learnt")
    config = read_config(args.config)
    output = choose_camera_file(args, config, "--save-learnt")
    check_writable(output)
    file: Path = args.camera_file or config.camera.file or output
    fallback = read_calibration(file)
    learned = _choose_sensor(args.serial)
    told, now = told_timing(read_camera(output, fallback)), remembered_as_timing(learned)
    heading = f"kinect-vo calibrate --save-learnt, {date.today()}: sensor {learned.serial}"
    kept = save_timing(output, fallback, now, heading)
    values = {"before": told, "now": now}
    print_saved_timing(args, {"serial": learned.serial}, values, SavedFile(output, kept))
    return 0


def _choose_sensor(serial: str | None) -> RememberedTiming:
    """Return the timing of a sensor, or of the only one.

    Raises:
        InputError: There is none, or there are several.
    """
    folders = memory_folders()
    remembered = find_remembered_timings(folders)
    known = ", ".join(sorted(remembered))
    if not remembered:
        searched = ", ".join(map(str, folders)) or "no folder"
        raise InputError(
            f"no service has learned a timing yet (searched: {searched}); let kinect-vo run until "
            "camera.timing in its status is learned, and use sudo for a service of systemd"
        )
    if serial is not None and serial not in remembered:
        raise InputError(f"--serial {serial}: nothing is learned of it; known: {known}")
    if serial is None and len(remembered) > 1:
        raise InputError(f"several sensors are known; choose one with --serial: {known}")
    return remembered[serial if serial is not None else known]
