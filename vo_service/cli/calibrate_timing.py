"""``kinect-vo calibrate --timing``: measure a sensor's timing from fast motion, and save it."""

import json
from datetime import date
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.calibration import CAMERA_FILE_NAME, CameraCalibration, read_calibration
from drivers.camera import PlaybackMode, SensorConfig
from drivers.core import InputError
from drivers.playback.camera import RecordingCamera
from drivers.registry import ONI_SUFFIX, SENSORS, open_camera
from vo_service.cli.calibrate_request import CalibrationRequest
from vo_service.cli.kernels import run_warm_up
from vo_service.cli.recordings import open_requested
from vo_service.config import read_config
from vo_service.odometry.warm_up import warm_up
from vo_service.signals import StopSignal, stop_on_signals
from vo_service.terminal import Terminal
from vo_service.tools.calibration.saved_timing import SavedTiming
from vo_service.tools.calibration.timing import (
    USUAL_TIMING,
    improve_timing,
    read_camera,
    save_timing,
    told_timing,
)

if TYPE_CHECKING:  # its kernels are slow to load
    from vo_service.tools.calibration.timing_measurement import TimingMeasurement

# A live camera is observed no longer, s.
CAPTURE_DURATION_S = 60.0


def calibrate_timing(request: CalibrationRequest) -> int:
    """Measure the timing and save it.

    Raises:
        UserFacingError: If an option or the recording is not valid, if the result is less certain
            than what is known, or if the file cannot be written.
    """
    source = request.folder_or_camera(
        "name a FOLDER that was recorded, or a camera to shake: --camera"
    )
    config = read_config(request.config)
    output = request.file_to_change(config, "--timing")  # checked before the work
    if isinstance(source, Path):
        _check_recording(request, source, output)
    terminal = Terminal()
    with stop_on_signals() as stop:
        run_warm_up(partial(warm_up, "direct"), terminal, stop)
        if isinstance(source, Path):
            recorded = RecordingCamera(source, request.camera_file, topics=request.topics)
            measured = _measure_recording(recorded, terminal, stop)
        else:
            file = request.camera_file or config.camera.file or output
            measured = _measure_live(source, file, config.sensor, terminal, stop)
    terminal.clear()
    is_kinect = _is_kinect(request.camera, measured.calibration)
    told = told_timing(read_camera(output, measured.calibration), is_kinect)
    changes = improve_timing(told, measured.timing, is_kinect)
    heading = f"kinect-vo calibrate --timing, {date.today()}: {measured.frame_count} frames"
    backup = save_timing(output, measured.calibration, changes, heading)
    values = {"before": told, "measured": measured.timing, "now": told | changes}
    saved = SavedTiming({"frames": measured.frame_count}, values, output, backup)
    print(json.dumps(saved.as_json()) if request.json else saved.as_table())
    return 0


def _measure_recording(
    recorded: RecordingCamera, terminal: Terminal, stop: StopSignal
) -> "TimingMeasurement":
    from vo_service.tools.calibration.timing_measurement import TimingMeasurement

    with recorded:
        measured = TimingMeasurement(recorded.recording.calibration)
        for _ in measured.process_frames(recorded, stop.event):
            terminal.progress("frame", measured.frame_count, recorded.frame_count)
    stop.check()
    return measured


def _measure_live(
    source: str, camera_file: Path, sensor: SensorConfig, terminal: Terminal, stop: StopSignal
) -> "TimingMeasurement":
    """Observe a camera until its timing is certain, or until a stop or the longest time."""
    from vo_service.tools.calibration.timing_measurement import TimingMeasurement

    if source.partition(":")[0] == "synthetic":
        raise InputError("--camera synthetic: its timing is known; record it and name the folder")
    measured = TimingMeasurement(read_calibration(camera_file))
    mode = PlaybackMode.LOCKSTEP
    with open_camera(source, camera_file=camera_file, playback_mode=mode, sensor=sensor) as camera:
        for elapsed_s in measured.process_frames(camera, stop.event, CAPTURE_DURATION_S):
            timing = measured.timing
            terminal.show(
                f"shake the camera: {elapsed_s:.0f} of {CAPTURE_DURATION_S:.0f} s, "
                f"readout {timing['readout_s']}, depth offset {timing['depth_offset_s']} "
                "(Ctrl-C: enough)"
            )
            if measured.is_sufficient:
                break
    return measured


def _check_recording(request: CalibrationRequest, folder: Path, output: Path) -> None:
    """Raise InputError if the stamps may have the depth offset of the file to change already."""
    read = open_requested(folder, request.camera_file, request.topics).calibration
    is_read = output.resolve() == (request.camera_file or folder / CAMERA_FILE_NAME).resolve()
    offset_s = read_camera(output, read).depth_offset_s
    if offset_s != 0.0 and not is_read:
        raise InputError(
            f"{output}: depth_offset_s = {offset_s:g} may be in the stamps of {folder} already; "
            "measure with the camera, or set it to 0 and record again"
        )


def _is_kinect(source: str | None, camera: CameraCalibration) -> bool:
    """Whether the usual timing of a Kinect holds: for a sensor, and for a recording of one."""
    kind, _, argument = (source or "").partition(":")
    is_sensor = kind in SENSORS and not argument.lower().endswith(ONI_SUFFIX)
    return is_sensor or told_timing(camera) == USUAL_TIMING
