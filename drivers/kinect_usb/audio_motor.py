"""The motor behind the audio device of the Kinect 1473 and the Kinect for Windows.

It is there once the audio firmware is loaded. Commands and answers are little-endian words on two
bulk endpoints (as in libfreenect's src/tilt.c); the accelerometer is taken to count as the 1414's
does, which `is_gravity` would notice if it were wrong.
"""

import struct
from itertools import count

import usb.core
import usb.util

from drivers.errors import CameraError
from drivers.kinect_usb.base_device import TIMEOUT_MS, BaseReading, clamped_deg
from drivers.kinect_usb.errors import usb_errors_of
from drivers.kinect_usb.gravity import gravity_from_counts
from drivers.sensor_settings import Led

OUT, IN = 0x01, 0x81
SET_LED, SET_TILT, GET_STATE = 0x10, 0x803B, 0x8032
# This light is off, green, blinking green or red: the nearest in meaning stands for the others.
LED_VALUES = {
    Led.OFF: 1,
    Led.BLINK_GREEN: 2,
    Led.GREEN: 3,
    Led.YELLOW: 3,
    Led.RED: 4,
    Led.BLINK_RED_YELLOW: 4,
}
COMMAND_MAGIC, ANSWER_MAGIC = 0x06022009, 0x0A6FE000
HEAD = struct.Struct("<4I")  # magic, tag, length of the data asked for, command
ARGUMENT = struct.Struct("<i")
ANSWER = struct.Struct("<3I")  # magic, tag, status
STATE = struct.Struct("<16x4i")  # a head, then x y z in counts and the tilt in degrees
STATE_LENGTH = 104
LONGEST_PACKET = 512
# Answers that an earlier program did not wait for come first.
MOST_PACKETS = 6
# Without firmware the device has one interface; with it, this many at least.
INTERFACES_WITH_FIRMWARE = 2


class AudioMotor:
    """See `BaseDevice`."""

    def __init__(self, device: usb.core.Device, name: str) -> None:
        """Raises CameraError if the firmware is missing."""
        self.name = name
        self._device = device
        self._tags = count(1)
        with usb_errors_of(name):
            interfaces = device[0].bNumInterfaces
        if interfaces < INTERFACES_WITH_FIRMWARE:
            raise CameraError(
                f"{name}: no tilt, light and gravity without its firmware (audios.bin); "
                "kinect-vo doctor says where it belongs"
            )

    def set_led(self, led: Led) -> None:
        """See `BaseDevice`."""
        self._ask(SET_LED, ARGUMENT.pack(LED_VALUES[led]))

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """See `BaseDevice`."""
        self._ask(SET_TILT, ARGUMENT.pack(round(clamped_deg(tilt_deg))))

    def read(self) -> BaseReading:
        """See `BaseDevice`. This device does not tell whether its motor runs."""
        data = self._ask(GET_STATE, b"", STATE_LENGTH)
        if len(data) < STATE.size:
            raise CameraError(f"{self.name}: answers with {len(data)} bytes; plug it in again")
        x, y, z, tilt_deg = STATE.unpack_from(data)
        return BaseReading(gravity_from_counts(x, y, z), float(tilt_deg), is_moving=False)

    def close(self) -> None:
        """See `BaseDevice`."""
        usb.util.dispose_resources(self._device)

    def _ask(self, command: int, argument: bytes, length: int = 0) -> bytes:
        """Send a command and wait for the end of its answer; returns the data before that."""
        tag = next(self._tags)
        data = b""
        with usb_errors_of(self.name):
            head = HEAD.pack(COMMAND_MAGIC, tag, length, command)
            self._device.write(OUT, head + argument, TIMEOUT_MS)
            for _ in range(MOST_PACKETS):
                packet = bytes(self._device.read(IN, LONGEST_PACKET, TIMEOUT_MS))
                if len(packet) != ANSWER.size:
                    data = packet
                elif self._ends(packet, tag):
                    return data
        raise CameraError(f"{self.name}: answers something else; plug it in again")

    def _ends(self, packet: bytes, tag: int) -> bool:
        """True for the end of the answer to `tag`. Raises CameraError if it says no."""
        magic, answered, status = ANSWER.unpack(packet)
        if magic != ANSWER_MAGIC or status != 0:
            raise CameraError(f"{self.name}: refuses a command (status {status})")
        return bool(answered == tag)
