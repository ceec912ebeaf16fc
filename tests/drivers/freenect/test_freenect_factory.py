import pickle
from functools import partial
from pathlib import Path

import pytest

from drivers.camera import Clock, Led, PlaybackMode, SensorConfig
from drivers.core import InputError
from drivers.freenect.camera import make_fakenect_camera, make_kinect_camera
from tests.simulators import kinect_faults
from tests.simulators.kinect_simulator import KinectSimulator


def test_a_kinect_comes_with_its_motor_unit(kinect: KinectSimulator) -> None:
    kinect.set_accelerometer(0, 819, 0)
    settings = SensorConfig(led=Led.RED, tilt_deg=10.0)
    recipe = pickle.loads(pickle.dumps(partial(make_kinect_camera, kinect.serial, settings, None)))
    with recipe() as camera:
        frame = camera.read(3.0)
        assert (kinect.led, kinect.tilt_deg) == (kinect_faults.KinectLed.RED, 10)
    assert camera.name == f"freenect:{kinect.serial}"
    assert frame.gravity_m_s2 == pytest.approx((0.0, 9.81, 0.0), abs=0.01)
    assert (kinect.led, kinect.open_handles) == (kinect_faults.KinectLed.OFF, 0)


def test_a_dump_has_its_own_clock_and_is_checked_when_opened(tmp_path: Path) -> None:
    recipe = partial(make_fakenect_camera, tmp_path, None, PlaybackMode.LOCKSTEP)
    camera = pickle.loads(pickle.dumps(recipe))()
    assert (camera.name, camera.clock) == (f"fakenect:{tmp_path}", Clock.RECORDED)
    with pytest.raises(InputError, match=r"INDEX\.txt: cannot be read"):
        camera.open()
    camera.close()


def test_an_unusable_camera_file_is_rejected_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"camera\.toml"):
        make_kinect_camera("", SensorConfig(), tmp_path / "camera.toml")


@pytest.mark.subprocess
def test_waiting_for_the_next_retry_ends() -> None:
    make_kinect_camera("", SensorConfig(), None).wait_for_reconnect(0.05)
