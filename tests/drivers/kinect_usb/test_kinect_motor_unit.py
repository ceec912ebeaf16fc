"""The motor unit: gravity, settings, and faults and reconnection of its device."""

import logging
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise

import pytest

from drivers.camera import MAX_ACCELEROMETER_READINGS, Led, SensorConfig
from drivers.core import CameraError, UserFacingError
from drivers.kinect_usb import kinect_motor_unit
from drivers.kinect_usb.kinect_motor_unit import Kinect1414Motor, KinectMotorUnit
from drivers.kinect_usb.motor_unit import MotorDevice, MotorUnit, MotorUnitReading
from tests.resource_leaks import resources_in_use
from tests.simulators.kinect_simulator import KinectLed as SimulatedLed
from tests.simulators.kinect_simulator import KinectModel, KinectSimulator
from tests.waiting import wait_until

PlugIn = Callable[..., KinectSimulator]
LEVEL = pytest.approx((0.0, 9.80665, 0.0))
SETTINGS = SensorConfig(led=Led.RED, tilt_deg=10.0)


def warnings(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [r.getMessage() for r in caplog.records if r.levelno >= logging.WARNING]


@pytest.fixture
def serials() -> list[str]:
    """The serial number of each attempt to open the device."""
    return []


@pytest.fixture
def motor_unit(monkeypatch: pytest.MonkeyPatch, serials: list[str]) -> Iterator[KinectMotorUnit]:
    """A motor unit that reconnects after a short delay."""
    monkeypatch.setattr(kinect_motor_unit, "RECONNECT_PERIOD_S", 0.05)
    monkeypatch.setattr(kinect_motor_unit, "READ_PERIOD_S", 0.02)

    def open_device(serial: str) -> MotorDevice:
        serials.append(serial)
        return kinect_motor_unit.open_motor_device(serial)

    motor_unit = KinectMotorUnit(open_device)
    yield motor_unit
    motor_unit.close()


@pytest.mark.parametrize("model", list(KinectModel))
def test_gravity_is_available_after_opening(
    plug_in: PlugIn, motor_unit: KinectMotorUnit, model: KinectModel
) -> None:
    plug_in(model=model)
    motor_unit.open("")
    assert motor_unit.gravity_m_s2 == LEVEL


def test_gravity_follows_the_tilt(plug_in: PlugIn, motor_unit: KinectMotorUnit) -> None:
    kinect = plug_in()
    motor_unit.open("")
    kinect.set_accelerometer(0, 700, -425)
    looking_down = pytest.approx((0.0, 8.38, 5.09), abs=0.01)
    wait_until(lambda: motor_unit.gravity_m_s2 == looking_down)


def test_gravity_is_mirrored_with_the_image(plug_in: PlugIn, motor_unit: KinectMotorUnit) -> None:
    plug_in().set_accelerometer(-200, 790, 0)
    motor_unit.open("")
    to_the_left = motor_unit.gravity_m_s2
    motor_unit.apply(SensorConfig(mirror=True))
    assert to_the_left == pytest.approx((-2.39, 9.46, 0.0), abs=0.01)
    assert motor_unit.gravity_m_s2 == pytest.approx((2.39, 9.46, 0.0), abs=0.01)


def test_each_reading_of_the_accelerometer_is_kept_with_its_stamp(
    plug_in: PlugIn, motor_unit: KinectMotorUnit
) -> None:
    kinect = plug_in()
    kinect.set_accelerometer(-200, 790, 0)
    motor_unit.open("")
    kinect.set_accelerometer(-1600, 790, 0)  # moved, so it is no gravity
    wait_until(lambda: motor_unit.accelerometer[-1].acceleration_m_s2[0] > 10.0)
    readings = motor_unit.accelerometer
    assert readings[0].acceleration_m_s2 == pytest.approx((2.39, -9.46, 0.0), abs=0.01)
    assert all(before.stamp_s < after.stamp_s for before, after in pairwise(readings))
    motor_unit.apply(SensorConfig(mirror=True))
    assert motor_unit.accelerometer[0].acceleration_m_s2[0] == pytest.approx(-2.39, abs=0.01)
    wait_until(lambda: motor_unit.accelerometer[0].stamp_s > readings[0].stamp_s)
    assert len(motor_unit.accelerometer) == MAX_ACCELEROMETER_READINGS


def test_settings_are_applied_to_led_and_tilt_if_they_are_set(
    plug_in: PlugIn, motor_unit: KinectMotorUnit
) -> None:
    kinect = plug_in()
    motor_unit.open("")
    motor_unit.close()
    assert kinect.led == SimulatedLed.BLINK_GREEN  # it only measured
    motor_unit.open("")
    motor_unit.apply(SETTINGS)
    assert (kinect.led, kinect.tilt_deg) == (SimulatedLed.RED, 10)
    motor_unit.set_tilt_deg(-8.0)
    motor_unit.apply(SensorConfig())
    assert (kinect.led, kinect.tilt_deg) == (SimulatedLed.GREEN, -8)


def test_closing_switches_the_led_off_and_leaks_nothing(
    plug_in: PlugIn, motor_unit: KinectMotorUnit
) -> None:
    kinect = plug_in()
    threads = threading.active_count()
    motor_unit.open("")
    motor_unit.apply(SETTINGS)
    motor_unit.close()
    motor_unit.close()
    assert (kinect.led, kinect.open_handles) == (SimulatedLed.OFF, 0)
    assert threading.active_count() == threads
    assert motor_unit.gravity_m_s2 is None


def test_many_openings_leak_nothing(plug_in: PlugIn, motor_unit: KinectMotorUnit) -> None:
    kinect = plug_in()
    motor_unit.open("")
    motor_unit.close()
    before = resources_in_use()
    for _ in range(40):
        motor_unit.open("")
        kinect.unplug()
        motor_unit.close()
        kinect.plug()
    assert resources_in_use() <= before
    assert kinect.open_handles == 0


@pytest.mark.parametrize("model", list(KinectModel))
def test_after_replugging_the_motor_unit_is_configured_again(
    plug_in: PlugIn,
    motor_unit: KinectMotorUnit,
    model: KinectModel,
    caplog: pytest.LogCaptureFixture,
) -> None:
    kinect = plug_in(model=model)
    motor_unit.open("")
    motor_unit.apply(SETTINGS)
    kinect.unplug()
    wait_until(lambda: motor_unit.gravity_m_s2 is None)
    wait_until(lambda: len(warnings(caplog)) > 0)
    kinect.plug()
    wait_until(lambda: motor_unit.gravity_m_s2 == LEVEL)
    assert kinect.led == SimulatedLed.RED
    (warning,) = warnings(caplog)
    assert warning.endswith("unplugged; plug it in again")


def test_a_motor_unit_plugged_in_later_is_used(
    plug_in: PlugIn, motor_unit: KinectMotorUnit
) -> None:
    kinect = plug_in()
    kinect.unplug()
    motor_unit.open("")
    motor_unit.apply(SETTINGS)
    assert motor_unit.gravity_m_s2 is None
    kinect.plug()
    wait_until(lambda: motor_unit.gravity_m_s2 == LEVEL)
    assert kinect.led == SimulatedLed.RED


def test_a_missing_permission_is_logged_once(
    plug_in: PlugIn,
    motor_unit: KinectMotorUnit,
    caplog: pytest.LogCaptureFixture,
    serials: list[str],
) -> None:
    plug_in().deny_access()
    motor_unit.open("")
    motor_unit.apply(SETTINGS)
    wait_until(lambda: len(serials) > 5)
    assert motor_unit.gravity_m_s2 is None
    assert [text.partition(";")[0] for text in warnings(caplog)] == [
        "Kinect 1414 motor: no permission"
    ]


def test_firmware_loaded_later_enables_gravity(
    plug_in: PlugIn, motor_unit: KinectMotorUnit, caplog: pytest.LogCaptureFixture
) -> None:
    kinect = plug_in(model=KinectModel.K1473)
    kinect.set_firmware_loaded(False)
    motor_unit.open("")
    assert motor_unit.gravity_m_s2 is None
    kinect.set_firmware_loaded(True)
    wait_until(lambda: motor_unit.gravity_m_s2 == LEVEL)
    assert len(warnings(caplog)) == 1


@pytest.mark.parametrize("counts", [(0, 0, 0), (0, 400, 0)])
def test_invalid_gravity_readings_are_ignored_and_logged_once(
    plug_in: PlugIn,
    motor_unit: KinectMotorUnit,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    counts: tuple[int, int, int],
) -> None:
    readings: list[MotorUnitReading] = []
    read = Kinect1414Motor.read

    def recording_read(motor: Kinect1414Motor) -> MotorUnitReading:
        readings.append(read(motor))
        return readings[-1]

    monkeypatch.setattr(Kinect1414Motor, "read", recording_read)
    plug_in().set_accelerometer(*counts)
    motor_unit.open("")
    wait_until(lambda: len(readings) > 2 * kinect_motor_unit.INITIAL_READINGS)
    assert motor_unit.gravity_m_s2 is None
    assert warnings(caplog) == [
        "Kinect 1414 motor: measures no gravity; the first camera pose counts as level"
    ]


def test_commands_fail_without_a_device(plug_in: PlugIn, motor_unit: KinectMotorUnit) -> None:
    plug_in().unplug()
    motor_unit.open("")
    for command in (
        lambda: motor_unit.set_led(Led.RED),
        lambda: motor_unit.set_tilt_deg(3.0),
        motor_unit.read,
    ):
        with pytest.raises(CameraError, match="not connected now"):
            command()


def test_without_libusb_there_is_no_motor_unit(caplog: pytest.LogCaptureFixture) -> None:
    def no_libusb(serial: str) -> None:
        raise UserFacingError("libusb-1.0.so.0 is not installed")

    motor_unit = KinectMotorUnit(no_libusb)  # type: ignore[arg-type]
    motor_unit.open("")
    motor_unit.close()
    assert warnings(caplog) == ["libusb-1.0.so.0 is not installed"]


def test_a_camera_without_a_motor_unit_has_no_gravity() -> None:
    motor_unit = MotorUnit()
    motor_unit.open("A1")
    motor_unit.apply(SensorConfig())
    motor_unit.close()
    assert motor_unit.gravity_m_s2 is None
