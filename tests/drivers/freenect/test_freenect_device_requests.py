"""Tilt and light, from a command to the wire and through everything that may come between."""

import os
import signal
from collections.abc import Iterator

import pytest

from drivers.camera import CameraState
from drivers.core.errors import CameraError
from drivers.freenect.camera import FreenectCamera
from drivers.kinect_usb import kinect_motor_unit
from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit
from drivers.sensor_config import Led, SensorConfig
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.drivers.freenect.conftest import MakeCamera
from tests.drivers.freenect.replugging import kinect_in_subprocess
from tests.resource_leaks import child_pids
from tests.simulators.kinect_simulator import KinectLed as PlayedLed
from tests.simulators.kinect_simulator import KinectSimulator
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until

pytestmark = pytest.mark.subprocess


@pytest.fixture
def isolated(kinect: KinectSimulator) -> Iterator[SubprocessCamera]:
    """Streaming, from a head that moves at once."""
    kinect.tilt_deg_per_s = 1000
    with kinect_in_subprocess() as camera:
        camera.read(DEFAULT_TIMEOUT_S)
        wait_until(lambda: camera.status.state is CameraState.STREAMING)
        yield camera


def wait_for_base(kinect: KinectSimulator, tilt_deg: int, led: PlayedLed) -> None:
    wait_until(
        lambda: (kinect.tilt_deg, kinect.led) == (tilt_deg, led),
        f"for {tilt_deg} degrees and {led}: {kinect.tilt_deg}, {kinect.led}",
    )


def test_head_and_light_follow(isolated: SubprocessCamera, kinect: KinectSimulator) -> None:
    isolated.set_tilt_deg(14.0)
    isolated.set_led(Led.BLINK_RED_YELLOW)
    wait_for_base(kinect, 14, PlayedLed.BLINK_RED_YELLOW)
    isolated.set_tilt_deg(-31.0)
    wait_for_base(kinect, -31, PlayedLed.BLINK_RED_YELLOW)
    isolated.read(DEFAULT_TIMEOUT_S)


def test_a_kinect_that_was_unplugged_does_it_again(
    isolated: SubprocessCamera, kinect: KinectSimulator
) -> None:
    isolated.set_led(Led.YELLOW)
    isolated.set_tilt_deg(9.0)
    wait_for_base(kinect, 9, PlayedLed.YELLOW)
    kinect.unplug()
    wait_until(lambda: isolated.status.state is CameraState.ABSENT)
    with pytest.raises(CameraError, match="freenect: not open now"):
        isolated.set_led(Led.RED)
    kinect.plug()
    wait_for_base(kinect, 9, PlayedLed.RED)


def test_a_driver_that_was_killed_does_it_again(
    isolated: SubprocessCamera, kinect: KinectSimulator
) -> None:
    isolated.set_led(Led.RED)
    wait_for_base(kinect, 0, PlayedLed.RED)
    (driver,) = child_pids()
    os.kill(driver, signal.SIGKILL)
    wait_until(lambda: isolated.status.state is not CameraState.STREAMING)
    wait_until(lambda: isolated.status.state is CameraState.STREAMING)
    # The next driver opened the base, and would have made the light green as its settings say.
    wait_for_base(kinect, 0, PlayedLed.RED)


def away(camera: FreenectCamera, tilt_deg: float) -> bool:
    """Ask, and tell whether nobody was there to do it."""
    try:
        camera.set_tilt_deg(tilt_deg)
    except CameraError as error:
        return "motor is not connected now" in str(error)
    return False


def test_what_was_asked_for_outlives_the_settings_and_a_base_that_was_away(
    kinect: KinectSimulator, make_camera: MakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kinect_motor_unit, "RECONNECT_PERIOD_S", 0.05)
    kinect.tilt_deg_per_s = 1000
    settings = SensorConfig(led=Led.YELLOW, tilt_deg=4.0)
    with make_camera(settings=settings, base=KinectMotorUnit()) as camera:
        wait_for_base(kinect, 4, PlayedLed.YELLOW)
        camera.set_led(Led.GREEN)
        kinect.unplug()
        wait_until(lambda: away(camera, 7.0))
        kinect.plug()
        wait_for_base(kinect, 7, PlayedLed.GREEN)
        camera.open()
        wait_for_base(kinect, 7, PlayedLed.GREEN)


def test_a_camera_without_a_base_has_neither(bare_camera: FreenectCamera) -> None:
    with pytest.raises(CameraError, match="freenect: it has no motor"):
        bare_camera.set_tilt_deg(1.0)
    with pytest.raises(CameraError, match="freenect: it has no LED"):
        bare_camera.set_led(Led.RED)


@pytest.fixture
def bare_camera(make_camera: MakeCamera) -> FreenectCamera:
    """A camera without a base; it need not be open."""
    return make_camera()
