"""A loop over the frames of a Kinect, by the public interface."""

import time

from drivers.camera import CameraState
from drivers.registry import open_camera
from tests.simulators.kinect_simulator import KinectSimulator
from tests.waiting import wait_until


def test_iteration_continues_after_replugging(kinect: KinectSimulator) -> None:
    with open_camera("freenect") as camera:
        frames = iter(camera)
        next(frames)
        kinect.unplug()
        wait_until(lambda: camera.status.state is not CameraState.STREAMING)
        plugged_s = time.monotonic()
        kinect.plug()
        assert next(frame for frame in frames if frame.stamp_s > plugged_s).depth_m.any()
