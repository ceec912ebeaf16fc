"""A process whose libfreenect hangs: opens a Kinect that stops answering, and says what it sees.

Arguments: "open" (it does not answer from the beginning) or "close" (from the first frame on).
"""

import os
import sys
import time

from drivers.camera import SensorConfig
from drivers.core import CameraError
from drivers.freenect import camera as camera_module
from drivers.freenect import session
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.sources import KinectSource
from drivers.kinect_usb.motor_unit import MotorUnit

session.START_TIMEOUT_S = camera_module.RELEASE_TIMEOUT_S = 0.5
session.STOP_TIMEOUT_S = 0.2

settings = SensorConfig()
camera = FreenectCamera(KinectSource("", settings), None, MotorUnit(), settings)
if sys.argv[1] == "close":
    camera.open()
    camera.read(5.0)
    print("streams", flush=True)
    sys.stdin.readline()
for _ in range(2):
    begin_s = time.monotonic()
    try:
        camera.open()
    except CameraError as error:
        print(f"{error}", flush=True)
    camera.close()
    assert time.monotonic() - begin_s < 30.0
# A thread is stuck in libfreenect: an orderly exit would tidy up under its feet, and may crash. The
# driver's process ends like this as well.
os._exit(0)
