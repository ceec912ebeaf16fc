"""Factories of cameras that use libfreenect, to be called in a worker process."""

from pathlib import Path

from drivers.camera import PlaybackMode, RgbdCamera, SensorConfig
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.fakenect import FakenectSource
from drivers.freenect.kinect_source import KinectSource
from drivers.freenect.rectify import KinectRectifier
from drivers.kinect_usb.motor_unit import NullMotorUnit


def make_kinect_camera(serial: str, settings: SensorConfig, camera_file: Path | None) -> RgbdCamera:
    """Make the Kinect with this serial number ("" for the first one found), with its motor unit.

    Raises:
        InputError: The camera file does not fit the Kinect.
    """
    from drivers.kinect_usb.hotplug import wait_for_device
    from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit

    source = KinectSource(serial, settings)
    rectifier = KinectRectifier(camera_file, settings.mirror)
    return FreenectCamera(source, rectifier, KinectMotorUnit(), settings, wait_for_device)


def make_fakenect_camera(
    folder: Path, camera_file: Path | None, playback_mode: PlaybackMode = PlaybackMode.REALTIME
) -> RgbdCamera:
    """Make the camera of a dump in libfreenect's format with depth in millimeters.

    Only one can exist in a process.

    Raises:
        InputError: The camera file does not fit the Kinect.
    """
    rectifier = KinectRectifier(camera_file, is_mirrored=False)
    return FreenectCamera(
        FakenectSource(folder, playback_mode), rectifier, NullMotorUnit(), SensorConfig()
    )
