"""Configuration of a sensor's streams for registered frames."""

import logging

from drivers.camera import SensorConfig
from drivers.core.errors import InputError
from drivers.openni2.decode import DEPTH_FACTORS
from drivers.openni2.device import OpenNI2Device
from drivers.openni2.library import OpenNI2Error, PixelFormat, SensorType, StreamProperty
from drivers.openni2.rectify import CalibrationFile, DepthRegistration, SourceProperties
from drivers.openni2.stream import OpenNI2Stream
from drivers.openni2.video_modes import choose_video_mode

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
    return SourceProperties(
        name=name,
        color_size=(color.video_mode.width, color.video_mode.height),
        depth_size=(depth.video_mode.width, depth.video_mode.height),
        color_fov_rad=color.fov_rad,
        depth_factor=DEPTH_FACTORS[PixelFormat(depth.video_mode.format)],
        registration=DepthRegistration.YES if is_registered else DepthRegistration.NO,
        flip_color=color.is_mirrored != settings.mirror,
        flip_depth=depth.is_mirrored != settings.mirror,
    )


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
