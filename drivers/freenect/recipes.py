"""Cameras through libfreenect put together: functions that another process can be told to call."""

from pathlib import Path

from drivers.camera import Pace, RgbdCamera
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.dump import Dump
from drivers.freenect.images import Images
from drivers.freenect.kinect import Kinect
from drivers.kinect_usb.base import NoBase
from drivers.sensor_settings import SensorSettings


def kinect_camera(serial: str, settings: SensorSettings, camera_file: Path | None) -> RgbdCamera:
    """The Kinect with this serial number, "" for the first one found, and its base.

    Raises InputError for a camera file that does not fit.
    """
    from drivers.kinect_usb.hot_plug import wait_for_device
    from drivers.kinect_usb.kinect_base import KinectBase

    kinect, images = Kinect(serial, settings), Images(camera_file, settings.mirror)
    return FreenectCamera(kinect, images, KinectBase(), settings, wait_for_device)


def fakenect_camera(
    folder: Path, camera_file: Path | None, pace: Pace = Pace.REALTIME
) -> RgbdCamera:
    """A dump in libfreenect's own format, with depth in millimetres; one a process.

    Raises InputError for a camera file that does not fit.
    """
    images = Images(camera_file, is_mirrored=False)
    return FreenectCamera(Dump(folder, pace), images, NoBase(), SensorSettings())
