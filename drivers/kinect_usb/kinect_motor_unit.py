"""A Kinect's motor, LED and accelerometer, independent of the state of its camera."""

import logging
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import usb.core
import usb.util

from drivers.camera import MAX_ACCELEROMETER_READINGS, AccelerometerReading, Led, SensorConfig
from drivers.core import CameraError, UserFacingError
from drivers.core.geometry import Vector
from drivers.kinect_usb.audio_motor import AudioMotor
from drivers.kinect_usb.motor_unit import (
    TIMEOUT_MS,
    GravityFilter,
    MotorDevice,
    MotorUnit,
    MotorUnitReading,
    clamp_tilt_deg,
    gravity_from_counts,
)
from drivers.kinect_usb.usb_devices import find_kinect, translate_usb_errors
from drivers.kinect_usb.usb_ids import UsbRole

OUT, IN = 0x40, 0xC0  # vendor requests to and from the device
SET_LED, SET_TILT, GET_STATE = 0x06, 0x31, 0x32
LED_VALUES = {
    Led.OFF: 0,
    Led.GREEN: 1,
    Led.RED: 2,
    Led.YELLOW: 3,
    Led.BLINK_GREEN: 4,
    Led.BLINK_RED_YELLOW: 6,
}
# Two unused bytes, x y z in counts, twice the tilt in degrees, status of the motor.
STATE = struct.Struct(">2x3hbB")
TILT_UNKNOWN, STATUS_MOVING = -128, 4


class Kinect1414Motor:
    """The `MotorDevice` of a Kinect 1414."""

    def __init__(self, device: usb.core.Device, name: str) -> None:
        self.name = name
        self._device = device

    def set_led(self, led: Led) -> None:
        self._send(SET_LED, LED_VALUES[led])

    def set_tilt_deg(self, tilt_deg: float) -> None:
        self._send(SET_TILT, round(2 * clamp_tilt_deg(tilt_deg)) & 0xFFFF)

    def read(self) -> MotorUnitReading:
        with translate_usb_errors(self.name):
            data = bytes(self._device.ctrl_transfer(IN, GET_STATE, 0, 0, STATE.size, TIMEOUT_MS))
        if len(data) != STATE.size:
            raise CameraError(
                f"{self.name}: answers with {len(data)} bytes; unplug it and plug it in again"
            )
        x, y, z, half_degrees, status = STATE.unpack(data)
        return MotorUnitReading(
            gravity_m_s2=gravity_from_counts(x, y, z),
            tilt_deg=None if half_degrees == TILT_UNKNOWN else half_degrees / 2,
            is_moving=status == STATUS_MOVING,
        )

    def close(self) -> None:
        usb.util.dispose_resources(self._device)

    def _send(self, request: int, value: int) -> None:
        with translate_usb_errors(self.name):
            self._device.ctrl_transfer(OUT, request, value, 0, None, TIMEOUT_MS)


_log = logging.getLogger(__name__)

READ_PERIOD_S, RECONNECT_PERIOD_S = 0.1, 2.0
INITIAL_READINGS = 8
# The longest time that the head takes from end to end; readings of this time are not averaged.
MAX_TILT_DURATION_S = 4.0
JOIN_TIMEOUT_S = 3.0


def open_motor_device(serial: str) -> MotorDevice:
    """Open the motor device of the Kinect `serial`, "" for the first one.

    Raises:
        CameraError: It is not connected, or there is no permission or firmware.
        UserFacingError: libusb is not installed.
    """
    kinect = find_kinect(serial)
    if kinect.motor_device is None:
        raise CameraError(
            f"{kinect.name}: its motor and accelerometer are not on the USB; unplug it and plug it "
            "in again"
        )
    motor_class = Kinect1414Motor if kinect.motor_device.id.role is UsbRole.MOTOR else AudioMotor
    return motor_class(kinect.motor_device.handle, f"{kinect.model} {kinect.motor_device.id.role}")


class KinectMotorUnit(MotorUnit):
    """The motor unit of a Kinect; a thread reads it, and opens it again after it was unplugged."""

    is_present = True

    def __init__(self, open_device: Callable[[str], MotorDevice] = open_motor_device) -> None:
        self._open_device = open_device
        self._serial = ""
        self._settings: SensorConfig | None = None
        self._device: MotorDevice | None = None
        self._lock = threading.Lock()  # one exchange with the device at a time
        self._gravity_filter = GravityFilter()
        self._accelerometer: tuple[AccelerometerReading, ...] = ()  # replaced as a whole
        self._fault_log = _FaultLog()
        self._stop = threading.Event()
        self._thread = threading.Thread()

    @property
    def gravity_m_s2(self) -> Vector | None:
        """Gravity over the last second; never waits. With mirrored images it is mirrored too."""
        gravity = self._gravity_filter.mean_at(time.monotonic())
        return _mirror(gravity) if gravity is not None and self._is_mirrored else gravity

    @property
    def accelerometer(self) -> tuple[AccelerometerReading, ...]:
        """See `MotorUnit`; never waits. With mirrored images it is mirrored too."""
        readings = self._accelerometer
        if not self._is_mirrored:
            return readings
        return tuple(
            replace(each, acceleration_m_s2=_mirror(each.acceleration_m_s2)) for each in readings
        )

    def open(self, serial: str) -> None:
        self.close()
        self._serial, self._settings, self._fault_log = serial, None, _FaultLog()
        self._stop = threading.Event()
        self._read_device(INITIAL_READINGS)
        self._thread = threading.Thread(
            target=self._run, args=(self._stop,), name="kinect-motor-unit", daemon=True
        )
        self._thread.start()

    def apply(self, settings: SensorConfig) -> None:
        self._settings = settings
        with self._lock:
            if self._device is not None:
                self._try_action(self._device, lambda device: self._configure(device, settings))

    def set_led(self, led: Led) -> None:
        with self._lock:
            self._store_settings(led=led)
            self._require_device().set_led(led)

    def set_tilt_deg(self, tilt_deg: float) -> None:
        with self._lock:
            self._store_settings(tilt_deg=tilt_deg)
            self._tilt(self._require_device(), tilt_deg)

    def read(self) -> MotorUnitReading:
        """Read tilt and accelerometer now. Raises CameraError as `set_led` does."""
        with self._lock:
            return self._require_device().read()

    def close(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(JOIN_TIMEOUT_S)
        self._reset_readings()

    def _run(self, stop: threading.Event) -> None:
        """Body of the thread; it also closes the device, so that `close` does not wait for it."""
        while not stop.wait(RECONNECT_PERIOD_S if self._device is None else READ_PERIOD_S):
            self._read_device(1)
        with self._lock:
            if self._device is not None and self._settings is not None:
                self._try_action(self._device, lambda device: device.set_led(Led.OFF))
            self._disconnect()

    def _read_device(self, readings: int) -> None:
        """Read the device, after connecting to it if needed."""
        with self._lock:
            try:
                device = self._device or self._connect()
            except UserFacingError as error:
                self._fault_log.report(str(error))
            else:
                self._try_action(device, lambda device: self._read_gravity(device, readings))

    def _connect(self) -> MotorDevice:
        self._device = self._open_device(self._serial)
        if self._settings is not None:
            self._configure(self._device, self._settings)
        return self._device

    def _try_action(self, device: MotorDevice, action: Callable[[MotorDevice], None]) -> None:
        try:
            action(device)
        except UserFacingError as error:
            self._fault_log.report(str(error))
            self._disconnect()

    def _disconnect(self) -> None:
        self._reset_readings()
        if self._device is not None:
            self._device.close()
            self._device = None

    def _reset_readings(self) -> None:
        self._gravity_filter.reset()
        self._accelerometer = ()

    @property
    def _is_mirrored(self) -> bool:
        settings = self._settings
        return settings is not None and settings.mirror

    def _require_device(self) -> MotorDevice:
        if self._device is None:
            raise CameraError("the Kinect's motor is not connected now; the driver searches for it")
        return self._device

    def _store_settings(self, **changed: Any) -> None:
        """Store settings for the next connection; before `apply` nothing is stored."""
        if self._settings is not None:
            self._settings = replace(self._settings, **changed)

    def _configure(self, device: MotorDevice, settings: SensorConfig) -> None:
        device.set_led(settings.led)
        if settings.tilt_deg is not None:
            self._tilt(device, settings.tilt_deg)

    def _tilt(self, device: MotorDevice, tilt_deg: float) -> None:
        device.set_tilt_deg(tilt_deg)
        self._gravity_filter.ignore_until(until_s=time.monotonic() + MAX_TILT_DURATION_S)

    def _read_gravity(self, device: MotorDevice, readings: int) -> None:
        is_gravity = [self._add_reading(device.read()) for _ in range(readings)]
        if any(is_gravity):
            self._fault_log.clear(f"{device.name}: measures gravity again")
        elif readings == INITIAL_READINGS:
            self._fault_log.report(
                f"{device.name}: measures no gravity; the first camera pose counts as level"
            )

    def _add_reading(self, reading: MotorUnitReading) -> bool:
        now_s, gravity = time.monotonic(), reading.gravity_m_s2
        if gravity is not None:
            x, y, z = gravity
            newest = AccelerometerReading(now_s, (-x, -y, -z))
            self._accelerometer = (*self._accelerometer, newest)[-MAX_ACCELEROMETER_READINGS:]
        return self._gravity_filter.add(gravity, now_s, reading.is_moving)


def _mirror(vector: Vector) -> Vector:
    x, y, z = vector
    return (-x, y, z)


class _FaultLog:
    """Logs the first of consecutive faults as a warning, and their end."""

    def __init__(self) -> None:
        self._is_reported = False

    def report(self, text: str) -> None:
        _log.log(logging.DEBUG if self._is_reported else logging.WARNING, "%s", text)
        self._is_reported = True

    def clear(self, text: str) -> None:
        if self._is_reported:
            _log.info("%s", text)
        self._is_reported = False
