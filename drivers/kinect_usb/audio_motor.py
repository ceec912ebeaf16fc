"""The motor behind the audio device of the Kinect 1473 and the Kinect for Windows.

It exists once the audio firmware is loaded. Commands and answers are little-endian words on two
bulk endpoints (as in libfreenect's src/tilt.c). The accelerometer is assumed to have the scale of
the 1414's; `is_gravity` rejects its readings if that is wrong.
"""

import struct
from itertools import count

import usb.core
import usb.util

from drivers.camera import Led
from drivers.core import CameraError
from drivers.kinect_usb.motor_unit import (
    TIMEOUT_MS,
    MotorUnitReading,
    clamp_tilt_deg,
    gravity_from_counts,
)
from drivers.kinect_usb.usb_devices import translate_usb_errors

OUT, IN = 0x01, 0x81
SET_LED, SET_TILT, GET_STATE = 0x10, 0x803B, 0x8032
# This LED is off, green, blinking green or red; other states are mapped to the nearest meaning.
LED_VALUES = {
    Led.OFF: 1,
    Led.BLINK_GREEN: 2,
    Led.GREEN: 3,
    Led.YELLOW: 3,
    Led.RED: 4,
    Led.BLINK_RED_YELLOW: 4,
}
COMMAND_MAGIC, ANSWER_MAGIC = 0x06022009, 0x0A6FE000
HEADER = struct.Struct("<4I")  # magic, tag, length of the requested data, command
ARGUMENT = struct.Struct("<i")
ANSWER = struct.Struct("<3I")  # magic, tag, status
STATE = struct.Struct("<16x4i")  # a head, then x y z in counts and the tilt in degrees
STATE_BYTES = 104
MAX_PACKET_BYTES = 512
# Unread answers to an earlier program arrive first.
MAX_PACKETS = 6
# Without firmware the device has one interface; with it, at least this many.
MIN_INTERFACES_WITH_FIRMWARE = 2


class AudioMotor:
    """A `MotorDevice` on the audio device.

    Raises:
        CameraError: If the firmware is missing.
    """

    def __init__(self, device: usb.core.Device, name: str) -> None:
        self.name = name
        self._device = device
        self._tags = count(1)
        with translate_usb_errors(name):
            interfaces = device[0].bNumInterfaces
        if interfaces < MIN_INTERFACES_WITH_FIRMWARE:
            raise CameraError(
                f"{name}: no tilt, LED and gravity without its firmware (audios.bin); "
                "kinect-vo doctor says where to put it"
            )

    def set_led(self, led: Led) -> None:
        self._query(SET_LED, ARGUMENT.pack(LED_VALUES[led]))

    def set_tilt_deg(self, tilt_deg: float) -> None:
        self._query(SET_TILT, ARGUMENT.pack(round(clamp_tilt_deg(tilt_deg))))

    def read(self) -> MotorUnitReading:
        """Read accelerometer and tilt. This device does not report whether its motor runs."""
        data = self._query(GET_STATE, b"", STATE_BYTES)
        if len(data) < STATE.size:
            raise CameraError(
                f"{self.name}: answers with {len(data)} bytes; unplug it and plug it in again"
            )
        x, y, z, tilt_deg = STATE.unpack_from(data)
        return MotorUnitReading(gravity_from_counts(x, y, z), float(tilt_deg), is_moving=False)

    def close(self) -> None:
        usb.util.dispose_resources(self._device)

    def _query(self, command: int, argument: bytes, length: int = 0) -> bytes:
        """Send a command, wait for the end of its answer, and return the data before the end."""
        tag = next(self._tags)
        data = b""
        with translate_usb_errors(self.name):
            head = HEADER.pack(COMMAND_MAGIC, tag, length, command)
            self._device.write(OUT, head + argument, TIMEOUT_MS)
            for _ in range(MAX_PACKETS):
                packet = bytes(self._device.read(IN, MAX_PACKET_BYTES, TIMEOUT_MS))
                if len(packet) != ANSWER.size:
                    data = packet
                elif self._is_end_of_answer(packet, tag):
                    return data
        raise CameraError(
            f"{self.name}: does not answer the command; unplug it and plug it in again"
        )

    def _is_end_of_answer(self, packet: bytes, tag: int) -> bool:
        """Whether this ends the answer to `tag`. Raises CameraError for an error status."""
        magic, answered_tag, status = ANSWER.unpack(packet)
        if magic != ANSWER_MAGIC or status != 0:
            raise CameraError(f"{self.name}: refuses a command (status {status})")
        return bool(answered_tag == tag)
