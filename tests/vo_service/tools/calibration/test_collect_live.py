"""Raw images of a live camera."""

import threading

import numpy as np
import pytest

from drivers.calibration import read_calibration
from drivers.camera import CameraState, CameraStatus, FrameTimeout
from drivers.core import CameraError
from drivers.rectify import SoftwareRegistration, Undistorter
from tests.vo_service.fakes import Delay, FakeClock, ScriptedCamera
from vo_service.tools.calibration import collect_live
from vo_service.tools.calibration.collect_live import read_frames, write_raw_camera_file


def test_with_the_raw_camera_file_depth_does_not_change() -> None:
    with write_raw_camera_file(with_depth=True) as path:
        camera = read_calibration(path)
    assert not path.exists()
    assert camera.depth is not None
    depth = np.random.default_rng(0).integers(0, 10000, (480, 640), dtype=np.uint16)
    registration = SoftwareRegistration(camera.pinhole, camera.depth, camera.depth_factor)
    np.testing.assert_array_equal(registration.register(depth), depth)
    assert registration.depth_factor == 1000.0


def test_with_the_raw_camera_file_color_is_not_undistorted() -> None:
    with write_raw_camera_file(with_depth=False) as path:
        camera = read_calibration(path)
    image = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    assert Undistorter(camera.pinhole, camera.distortion).undistort_color(image) is image
    assert camera.depth is None


def test_a_silent_camera_fails_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock()
    monkeypatch.setattr(collect_live, "time", clock)
    silent = CameraStatus(CameraState.ABSENT, "no Kinect is plugged in")
    camera = ScriptedCamera([silent, Delay(15.1, FrameTimeout())], clock=clock)
    with camera, pytest.raises(CameraError, match="scripted: no Kinect is plugged in"):
        list(read_frames(camera, threading.Event()))


def test_a_stop_ends_the_frames() -> None:
    stop = threading.Event()
    stop.set()
    with ScriptedCamera([FrameTimeout()]) as camera:
        assert list(read_frames(camera, stop)) == []
