"""Tilt and LED requests, from a command to the simulated Kinect, through all faults."""

from collections.abc import Iterator

import pytest

from drivers.camera import CameraState, Led, SensorConfig
from drivers.core import CameraError
from drivers.freenect.camera import FreenectCamera
from drivers.kinect_usb import kinect_motor_unit
from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.drivers.freenect.conftest import MakeCamera
from tests.drivers.freenect.replugging import kinect_in_subprocess
from tests.simulators.kinect_simulator import KinectLed as SimulatedLed
from tests.simulators.kinect_simulator import KinectSimulator
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until

pytestmark = pytest.mark.subprocess


@pytest.fixture
def camera(kinect: KinectSimulator) -> Iterator[SubprocessCamera]:
    """A streaming camera with a fast motor."""
    kinect.tilt_deg_per_s = 1000
    with kinect_in_subprocess() as camera:
        camera.read(DEFAULT_TIMEOUT_S)
        wait_until(lambda: camera.status.state is CameraState.STREAMING)
        yield camera


def wait_for_motor_unit(kinect: KinectSimulator, tilt_deg: int, led: SimulatedLed) -> None:
    wait_until(
        lambda: (kinect.tilt_deg, kinect.led) == (tilt_deg, led),
        f"for {tilt_deg} degrees and {led}: {kinect.tilt_deg}, {kinect.led}",
    )


def test_tilt_and_led_requests_are_applied(
    camera: SubprocessCamera, kinect: KinectSimulator
) -> None:
    camera.set_tilt_deg(14.0)
    camera.set_led(Led.BLINK_RED_YELLOW)
    wait_for_motor_unit(kinect, 14, SimulatedLed.BLINK_RED_YELLOW)
    camera.set_tilt_deg(-31.0)
    wait_for_motor_unit(kinect, -31, SimulatedLed.BLINK_RED_YELLOW)
    camera.read(DEFAULT_TIMEOUT_S)


def away(camera: FreenectCamera, tilt_deg: float) -> bool:
    """Request a tilt; return whether the motor was not connected."""
    try:
        camera.set_tilt_deg(tilt_deg)
    except CameraError as error:
        return "motor is not connected now" in str(error)
    return False


def test_requests_override_settings_and_survive_a_missing_motor_unit(
    kinect: KinectSimulator, make_camera: MakeCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kinect_motor_unit, "RECONNECT_PERIOD_S", 0.05)
    kinect.tilt_deg_per_s = 1000
    settings = SensorConfig(led=Led.YELLOW, tilt_deg=4.0)
    with make_camera(settings=settings, motor_unit=KinectMotorUnit()) as camera:
        wait_for_motor_unit(kinect, 4, SimulatedLed.YELLOW)
        camera.set_led(Led.GREEN)
        kinect.unplug()
        wait_until(lambda: away(camera, 7.0))
        kinect.plug()
        wait_for_motor_unit(kinect, 7, SimulatedLed.GREEN)
        camera.open()
        wait_for_motor_unit(kinect, 7, SimulatedLed.GREEN)


def test_a_camera_without_a_motor_unit_refuses_tilt_and_led(bare_camera: FreenectCamera) -> None:
    with pytest.raises(CameraError, match="freenect: it has no motor"):
        bare_camera.set_tilt_deg(1.0)
    with pytest.raises(CameraError, match="freenect: it has no LED"):
        bare_camera.set_led(Led.RED)


@pytest.fixture
def bare_camera(make_camera: MakeCamera) -> FreenectCamera:
    """A camera without a motor unit; it need not be open."""
    return make_camera()
