"""Tilt, light and accelerometer of all models, as packets on the wire of a played Kinect."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager

import pytest
from usb.core import find

from drivers.camera import Led
from drivers.core import CameraError
from drivers.kinect_usb.audio_motor import AudioMotor
from drivers.kinect_usb.kinect_motor_unit import Kinect1414Motor, open_motor_device
from drivers.kinect_usb.motor_unit import MotorDevice
from tests.simulators.kinect_simulator import COUNTS_PER_G, KinectModel, KinectSimulator
from tests.simulators.kinect_simulator import KinectLed as PlayedLed
from tests.waiting import wait_until

PlugIn = Callable[..., KinectSimulator]
G = 9.80665


@contextmanager
def opened() -> Iterator[MotorDevice]:
    with closing(open_motor_device("")) as device:
        yield device


@pytest.fixture(params=list(KinectModel))
def kinect(request: pytest.FixtureRequest, plug_in: PlugIn) -> KinectSimulator:
    """One of each model."""
    return plug_in(model=request.param)


@pytest.mark.parametrize(
    ("asked_deg", "sent_deg"), [(0.0, 0), (12.0, 12), (-7.0, -7), (45.0, 31), (-90.0, -31)]
)
def test_the_tilt_is_clipped_to_its_range(
    kinect: KinectSimulator, asked_deg: float, sent_deg: int
) -> None:
    with opened() as device:
        device.set_tilt_deg(asked_deg)
    assert kinect.tilt_deg == sent_deg


def test_a_tilt_that_is_not_a_number_is_not_sent_to_the_motor(kinect: KinectSimulator) -> None:
    with opened() as device, pytest.raises(ValueError, match="not a number"):
        device.set_tilt_deg(float("nan"))


@pytest.mark.parametrize("led", list(Led))
def test_the_led_has_the_requested_or_the_nearest_mode(kinect: KinectSimulator, led: Led) -> None:
    with opened() as device:
        device.set_led(led)
    shown = {
        Led.OFF: PlayedLed.OFF,
        Led.GREEN: PlayedLed.GREEN,
        Led.RED: PlayedLed.RED,
        Led.YELLOW: PlayedLed.YELLOW,
        Led.BLINK_GREEN: PlayedLed.BLINK_GREEN,
        Led.BLINK_RED_YELLOW: PlayedLed.BLINK_RED_YELLOW,
    }
    later_models = {Led.YELLOW: PlayedLed.GREEN, Led.BLINK_RED_YELLOW: PlayedLed.RED}
    known = shown if kinect.model == KinectModel.K1414 else shown | later_models
    assert kinect.led == known[led]


def test_gravity_is_read_in_camera_axes(kinect: KinectSimulator) -> None:
    kinect.set_accelerometer(-100, 700, -400)
    with opened() as device:
        gravity = device.read().gravity_m_s2
    per_count = G / COUNTS_PER_G
    assert gravity == pytest.approx((-100 * per_count, 700 * per_count, 400 * per_count))


def test_the_tilt_is_reported_when_the_head_is_at_rest(kinect: KinectSimulator) -> None:
    kinect.tilt_deg_per_s = 1000
    with opened() as device:
        device.set_tilt_deg(-20.0)
        wait_until(lambda: not kinect.tilt_moving)
        reading = device.read()
    assert (reading.tilt_deg, reading.is_moving) == (-20.0, False)


def test_the_1414_reports_that_its_head_moves(plug_in: PlugIn) -> None:
    kinect = plug_in()
    kinect.tilt_deg_per_s = 1
    with opened() as device:
        device.set_tilt_deg(30.0)
        reading = device.read()
    assert reading.is_moving


@pytest.mark.parametrize("model", [KinectModel.K1473, KinectModel.K4W])
def test_without_firmware_there_is_no_motor(plug_in: PlugIn, model: KinectModel) -> None:
    plug_in(model=model).set_firmware_loaded(False)
    with pytest.raises(CameraError, match=r"without its firmware \(audios\.bin\)"):
        open_motor_device("")


def test_a_silent_device_times_out(plug_in: PlugIn) -> None:
    kinect = plug_in(model=KinectModel.K1473)
    with opened() as device:
        kinect.set_firmware_loaded(False)  # as after its power has failed
        with pytest.raises(CameraError, match="does not answer"):
            device.read()


class CutShort:
    """A device whose answers miss their ends."""

    def ctrl_transfer(self, *_: object) -> bytes:
        return bytes(4)


def test_an_incomplete_reply_is_an_error() -> None:
    with pytest.raises(CameraError, match="answers with 4 bytes"):
        Kinect1414Motor(CutShort(), "motor").read()


def test_a_stale_reply_is_skipped(plug_in: PlugIn) -> None:
    kinect = plug_in(model=KinectModel.K1473)
    kinect.set_accelerometer(0, 819, 0)
    handle = find(idProduct=0x02AD)
    with closing(AudioMotor(handle, "audio")) as device:
        handle.write(0x01, bytes.fromhex("09200206 2a000000 68000000 32800000"), 500)
        device.set_led(Led.RED)
        assert device.read().gravity_m_s2 == pytest.approx((0.0, G, 0.0))
    assert kinect.led == PlayedLed.RED


def test_closing_releases_the_device(kinect: KinectSimulator) -> None:
    with opened() as device:
        device.read()
        assert kinect.open_handles == 1
    assert kinect.open_handles == 0
