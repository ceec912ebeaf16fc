"""Cameras through libfreenect put together: functions that another process can be told to call."""

from pathlib import Path

from drivers.camera import PlaybackMode, RgbdCamera
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.fakenect import FakenectSource
from drivers.freenect.kinect_source import KinectSource
from drivers.freenect.rectify import KinectRectifier
from drivers.kinect_usb.motor_unit import NullMotorUnit
from drivers.sensor_config import SensorConfig


def make_kinect_camera(serial: str, settings: SensorConfig, camera_file: Path | None) -> RgbdCamera:
    """The Kinect with this serial number, "" for the first one found, and its base.

    Raises InputError for a camera file that does not fit.
    """
    from drivers.kinect_usb.hotplug import wait_for_device
    from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit

    kinect, images = KinectSource(serial, settings), KinectRectifier(camera_file, settings.mirror)
    return FreenectCamera(kinect, images, KinectMotorUnit(), settings, wait_for_device)


def make_fakenect_camera(
    folder: Path, camera_file: Path | None, playback_mode: PlaybackMode = PlaybackMode.REALTIME
) -> RgbdCamera:
    """A dump in libfreenect's own format, with depth in millimetres; one a process.

    Raises InputError for a camera file that does not fit.
    """
    images = KinectRectifier(camera_file, is_mirrored=False)
    return FreenectCamera(
        FakenectSource(folder, playback_mode), images, NullMotorUnit(), SensorConfig()
    )
