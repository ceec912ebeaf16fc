"""How a sensor is set up for registered frames, and what came of it."""

import logging

from drivers.errors import InputError
from drivers.openni2.device import Device
from drivers.openni2.images import DEPTH_FACTORS
from drivers.openni2.library import Format, OpenNI2Error, Sensor, StreamProperty
from drivers.openni2.modes import choose_mode
from drivers.openni2.optics import CameraChoice, Registered, Source
from drivers.openni2.stream import Stream
from drivers.sensor_settings import SensorSettings

_log = logging.getLogger(__name__)


def set_up(name: str, device: Device, choice: CameraChoice, settings: SensorSettings) -> Source:
    """Create the streams of a device and choose how they deliver; what they will deliver.

    Raises InputError if the device lacks what is needed, OpenNI2Error if a call fails.
    """
    colour, depth = (_stream(name, device, sensor, choice) for sensor in Sensor)
    is_registered = device.register_depth(not choice.has_depth_camera)
    if not device.synchronise():
        _log.info("%s: does not take depth and colour together; they are paired by stamp", name)
    for stream in (colour, depth):
        _try_switch(stream, StreamProperty.MIRRORING, settings.mirror)
    return Source(
        name=name,
        colour_size=(colour.mode.width, colour.mode.height),
        depth_size=(depth.mode.width, depth.mode.height),
        colour_fov_rad=colour.fov_rad,
        depth_factor=DEPTH_FACTORS[Format(depth.mode.format)],
        registered=Registered.YES if is_registered else Registered.NO,
        flip_colour=colour.is_mirrored != settings.mirror,
        flip_depth=depth.is_mirrored != settings.mirror,
    )


def start(device: Device, settings: SensorSettings) -> None:
    """Start the streams, then set exposure and white balance: starting them may reset these.

    Raises OpenNI2Error.
    """
    for stream in device.streams:
        stream.start()
    for stream in device.streams:
        if stream.sensor is Sensor.COLOUR:
            _try_switch(stream, StreamProperty.AUTO_EXPOSURE, settings.auto_exposure)
            _try_switch(stream, StreamProperty.AUTO_WHITE_BALANCE, settings.auto_white_balance)


def _stream(name: str, device: Device, sensor: Sensor, choice: CameraChoice) -> Stream:
    if not device.has(sensor):
        raise InputError(
            f"{name}: has no {sensor.name.lower()} sensor; colour and depth are both needed"
        )
    stream = device.stream(sensor)
    stream.set_mode(choose_mode(sensor, device.modes(sensor), choice.file))
    return stream


def _try_switch(stream: Stream, prop: StreamProperty, on: bool) -> None:
    """Set what this sensor has; one that refuses still delivers."""
    if not stream.has(prop):
        return
    try:
        stream.switch(prop, on)
    except OpenNI2Error as error:
        _log.warning("%s", error)
