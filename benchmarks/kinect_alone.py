"""The Kinect's camera by itself, for processes that are told by name what to make."""

from drivers.freenect.camera import FreenectCamera
from drivers.freenect.images import Images
from drivers.freenect.kinect import Kinect
from drivers.kinect_usb.base import NoBase
from drivers.sensor_settings import SensorSettings


def kinect_alone() -> FreenectCamera:
    """The first one found, without its motor and accelerometer."""
    settings = SensorSettings()
    images = Images(None, is_mirrored=False)
    return FreenectCamera(Kinect("", settings), images, NoBase(), settings)
