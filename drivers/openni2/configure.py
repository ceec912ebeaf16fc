"""Configuration of a sensor's streams for registered frames."""

import logging
from collections.abc import Sequence

from drivers.calibration import CameraCalibration
from drivers.camera import SensorConfig
from drivers.core import InputError
from drivers.openni2.bindings import (
    OpenNI2Error,
    PixelFormat,
    SensorType,
    StreamProperty,
    VideoMode,
)
from drivers.openni2.device import OpenNI2Device
from drivers.openni2.source_properties import read_source_properties
from drivers.openni2.stream import DEPTH_FACTORS, TO_BGR, OpenNI2Stream
from drivers.rectify import CalibrationFile, DepthRegistration, Size, SourceProperties

PREFERRED_SIZE, PREFERRED_FPS = (640, 480), 30


def choose_video_mode(
    sensor: SensorType, modes: Sequence[VideoMode], calibration: CameraCalibration | None
) -> VideoMode:
    """Choose the mode with the camera file's size, else 640x480, and nearest to 30 images/s.

    Raises:
        InputError: No mode is usable.
    """
    formats = list(TO_BGR) if sensor is SensorType.COLOR else list(DEPTH_FACTORS)
    usable = [mode for mode in modes if mode.format in formats]
    if not usable:
        raise InputError(
            f"the sensor's {sensor.name.lower()} has no supported format; use another sensor"
        )
    size = _wanted_size(sensor, calibration)
    fitting = [mode for mode in usable if (mode.width, mode.height) == size]
    if not fitting and calibration is not None:
        sizes = ", ".join(sorted({f"{mode.width}x{mode.height}" for mode in usable}))
        raise InputError(
            f"the sensor has no {sensor.name.lower()} of {size[0]}x{size[1]}, the size in the "
            f"camera file; it has {sizes}"
        )

    def preference(mode: VideoMode) -> tuple[int, int]:
        return abs(mode.fps - PREFERRED_FPS), _format_rank(mode, formats, calibration)

    return min(fitting or usable, key=preference)


def _wanted_size(sensor: SensorType, calibration: CameraCalibration | None) -> Size:
    if calibration is None:
        return PREFERRED_SIZE
    if sensor is SensorType.DEPTH and calibration.depth is not None:
        return calibration.depth.width, calibration.depth.height
    return calibration.width, calibration.height


def _format_rank(
    mode: VideoMode, formats: Sequence[int], calibration: CameraCalibration | None
) -> int:
    """Rank a mode's format, 0 is best: the camera file's unit first, then in listed order."""
    factor = DEPTH_FACTORS.get(PixelFormat(mode.format))
    if calibration is not None and factor == calibration.depth_factor:
        return 0
    return 1 + formats.index(mode.format)


_log = logging.getLogger(__name__)


def configure_device(
    name: str, device: OpenNI2Device, calibration_file: CalibrationFile, settings: SensorConfig
) -> SourceProperties:
    """Create and configure the streams of a device.

    Returns:
        The properties of the images that the streams will deliver.

    Raises:
        InputError: The device lacks a sensor or a video mode.
        OpenNI2Error: A call fails.
    """
    color, depth = (_create_stream(name, device, sensor, calibration_file) for sensor in SensorType)
    is_registered = device.enable_depth_registration(not calibration_file.has_depth_camera)
    if not device.enable_depth_color_sync():
        _log.info("%s: cannot capture depth and color in sync; they are paired by stamp", name)
    for stream in (color, depth):
        _try_set_flag(stream, StreamProperty.MIRRORING, settings.mirror)
        stream.mirror(settings.mirror)
    registration = DepthRegistration.YES if is_registered else DepthRegistration.NO
    return read_source_properties(name, color, depth, registration)


def start_streams(device: OpenNI2Device, settings: SensorConfig) -> None:
    """Start the streams, then set exposure and white balance, which the start may reset.

    Raises:
        OpenNI2Error: A stream does not start.
    """
    for stream in device.streams:
        stream.start()
    for stream in device.streams:
        if stream.sensor is SensorType.COLOR:
            _try_set_flag(stream, StreamProperty.AUTO_EXPOSURE, settings.auto_exposure)
            _try_set_flag(stream, StreamProperty.AUTO_WHITE_BALANCE, settings.auto_white_balance)


def _create_stream(
    name: str, device: OpenNI2Device, sensor: SensorType, calibration_file: CalibrationFile
) -> OpenNI2Stream:
    if not device.has_sensor(sensor):
        raise InputError(
            f"{name}: has no {sensor.name.lower()} sensor; color and depth are both needed"
        )
    stream = device.create_stream(sensor)
    stream.set_video_mode(
        choose_video_mode(sensor, device.video_modes(sensor), calibration_file.calibration)
    )
    return stream


def _try_set_flag(stream: OpenNI2Stream, prop: StreamProperty, is_on: bool) -> None:
    """Set a flag if the sensor has it; a failure is only logged."""
    if not stream.has_property(prop):
        return
    try:
        stream.set_flag(prop, is_on)
    except OpenNI2Error as error:
        _log.warning("%s", error)
