"""Factory of the Kinect's camera without its motor, importable by name in other processes."""

from drivers.camera import SensorConfig
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.device_source import KinectSource
from drivers.freenect.rectify import KinectRectifier
from drivers.kinect_usb.motor_unit import NullMotorUnit


def make_kinect_without_motor() -> FreenectCamera:
    """Make the camera of the first Kinect, without motor and accelerometer."""
    settings = SensorConfig()
    images = KinectRectifier(None, is_mirrored=False)
    return FreenectCamera(KinectSource("", settings), images, NullMotorUnit(), settings)
