"""What can go wrong with a played Kinect, and what it tells of itself, while it runs."""

import fcntl
import struct
import time
from enum import IntEnum
from pathlib import Path

from tests.simulators.kinect_control import (
    LOCKS_OPEN_HANDLES,
    OPEN_HANDLE_SLOTS,
    REGISTER_DEPTH,
    REGISTER_VIDEO,
    KinectControl,
)

# struct flock: type, whence, start, length, process; with the C compiler's gaps.
_FLOCK = "hhqqi4x"


class KinectStream(IntEnum):
    """What the camera sends."""

    DEPTH = 0
    COLOR = 1


class KinectLed(IntEnum):
    """The light, in the numbers of the 1414 whatever the model."""

    OFF = 0
    GREEN = 1
    RED = 2
    YELLOW = 3
    BLINK_GREEN = 4
    BLINK_RED_YELLOW = 6


class KinectFaultControls:
    """Commands that take effect at once, in whatever process the Kinect is used."""

    _control: KinectControl

    def unplug(self) -> None:
        """Pull the cable: whatever is open is dead from now on."""
        self._control.plugged = 0

    def plug(self) -> None:
        """Put the cable (back) in: the Kinect starts as after power on, at another address."""
        control = self._control
        for number in range(len(control.registers)):
            control.registers[number] = 0
            control.cmos[number] = 0
        control.led = KinectLed.BLINK_GREEN
        control.clock_began_frame = -1
        control.generation += 1
        control.plugged = 1

    def lose_packets(self, stream: KinectStream, every: int) -> None:
        """Lose every n-th packet of a stream; 0 = none."""
        self._control.streams[stream].lose_every = every

    def lose_burst(self, stream: KinectStream, packets: int) -> None:
        """Lose the next so many packets of a stream."""
        self._control.streams[stream].lose_next = packets

    def stall(self, on: bool = True, *streams: KinectStream) -> None:
        """Send nothing any more, on one stream or on both (none named)."""
        for stream in streams or tuple(KinectStream):
            self._control.streams[stream].stalled = on

    def freeze_control(self, on: bool = True) -> None:
        """Answer commands with no bytes: libfreenect asks again for ever."""
        self._control.frozen = on

    def set_busy(self, on: bool = True) -> None:
        """Another program holds the camera: it opens, but cannot be claimed."""
        self._control.busy = on

    def deny_access(self, on: bool = True) -> None:
        """No permission to open any of its devices."""
        self._control.forbidden = on

    def remove_bandwidth(self, on: bool = True) -> None:
        """No bandwidth on the bus: streams cannot be started, and running ones die."""
        self._control.starved = on

    def set_full_speed_bus(self, on: bool = True) -> None:
        """On a full-speed port (12 Mbit/s), where no stream fits."""
        self._control.slow_bus = on

    def attach_kernel_driver(self, on: bool = True) -> None:
        """The kernel's gspca_kinect has taken the camera."""
        self._control.kernel_driver = on

    def set_firmware_loaded(self, on: bool = True) -> None:
        """Whether the audio device of a 1473 or K4W has its firmware, and so moves the motor."""
        self._control.firmware = on


class KinectReadings:
    """What the Kinect tells, as seen on its side of the cable."""

    _control: KinectControl
    control_file: Path

    @property
    def tilt_deg(self) -> int:
        """The angle that the motor was last sent to."""
        return int(self._control.tilt_to_deg)

    @property
    def tilt_moving(self) -> bool:
        """Whether the motor is still on its way there."""
        control = self._control
        needed_s = abs(control.tilt_to_deg - control.tilt_from_deg) / control.tilt_deg_per_s
        return bool(time.monotonic() < control.tilt_began_ns / 1e9 + needed_s)

    @property
    def led(self) -> KinectLed:
        """The light."""
        return KinectLed(self._control.led)

    @property
    def frames_sent(self) -> tuple[int, int]:
        """Whole frames of depth and of color sent, lost packets included."""
        depth, color = self._control.streams
        return depth.frames_sent, color.frames_sent

    @property
    def packets_lost(self) -> tuple[int, int]:
        """Packets of depth and of color lost on purpose."""
        depth, color = self._control.streams
        return depth.packets_lost, color.packets_lost

    @property
    def streaming(self) -> tuple[bool, bool]:
        """Whether depth and color are switched on."""
        registers = self._control.registers
        return bool(registers[REGISTER_DEPTH]), bool(registers[REGISTER_VIDEO])

    @property
    def submitted_transfers(self) -> tuple[int, int]:
        """Transfers that wait for depth and for color; those of a killed process count on."""
        depth, color = self._control.streams
        return depth.submitted_transfers, color.submitted_transfers

    @property
    def abandoned_transfers(self) -> int:
        """Transfers still waiting when their device was closed: streams that nobody stopped."""
        return int(self._control.abandoned_transfers)

    @property
    def open_handles(self) -> int:
        """How often its devices are open now, in living processes."""
        with self.control_file.open("r+b") as opened:
            return sum(
                _is_locked(opened.fileno(), LOCKS_OPEN_HANDLES + slot)
                for slot in range(OPEN_HANDLE_SLOTS)
            )


def _is_locked(file: int, byte: int) -> bool:
    asked = struct.pack(_FLOCK, fcntl.F_WRLCK, 0, byte, 1, 0)
    answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, asked)
    kind: int = struct.unpack(_FLOCK, answer)[0]
    return kind != fcntl.F_UNLCK
