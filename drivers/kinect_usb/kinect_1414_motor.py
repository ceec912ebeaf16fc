"""The motor device of the Kinect 1414 (045e:02b0): control transfers only, nothing to claim."""

import struct

import usb.core
import usb.util

from drivers.camera import Led
from drivers.core.errors import CameraError
from drivers.kinect_usb.accelerometer import gravity_from_counts
from drivers.kinect_usb.motor_unit import TIMEOUT_MS, MotorUnitReading, clamp_tilt_deg
from drivers.kinect_usb.usb_devices import translate_usb_errors

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
