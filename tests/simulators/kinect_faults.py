"""Faults and readings of a running simulated Kinect."""

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
    """Streams of the camera."""

    DEPTH = 0
    COLOR = 1


class KinectLed(IntEnum):
    """States of the LED, in the numbers of the 1414 for every model."""

    OFF = 0
    GREEN = 1
    RED = 2
    YELLOW = 3
    BLINK_GREEN = 4
    BLINK_RED_YELLOW = 6


class KinectFaultControls:
    """Fault commands; they take effect at once, in every process that uses the Kinect."""

    _control: KinectControl

    def unplug(self) -> None:
        """Pull the cable: all open handles are dead from now on."""
        self._control.plugged = 0

    def plug(self) -> None:
        """Plug the cable in: the Kinect starts as after power on, at another address."""
        control = self._control
        for number in range(len(control.registers)):
            control.registers[number] = 0
            control.cmos[number] = 0
        control.led = KinectLed.BLINK_GREEN
        control.clock_start_frame = -1
        control.generation += 1
        control.plugged = 1

    def lose_packets(self, stream: KinectStream, every: int) -> None:
        """Lose every n-th packet of a stream; 0 = none."""
        self._control.streams[stream].lose_every = every

    def lose_burst(self, stream: KinectStream, packets: int) -> None:
        """Lose the next `packets` packets of a stream."""
        self._control.streams[stream].lose_next = packets

    def stall(self, on: bool = True, *streams: KinectStream) -> None:
        """Stop sending on the given streams, or on both if none is given."""
        for stream in streams or tuple(KinectStream):
            self._control.streams[stream].stalled = on

    def freeze_control(self, on: bool = True) -> None:
        """Answer commands with no bytes: libfreenect repeats them forever."""
        self._control.frozen = on

    def set_busy(self, on: bool = True) -> None:
        """Let another program hold the camera: it opens, but cannot be claimed."""
        self._control.busy = on

    def deny_access(self, on: bool = True) -> None:
        """Deny permission to open its devices."""
        self._control.forbidden = on

    def remove_bandwidth(self, on: bool = True) -> None:
        """Remove the bus bandwidth: streams cannot start, and running ones end."""
        self._control.starved = on

    def set_full_speed_bus(self, on: bool = True) -> None:
        """Put it on a full-speed port (12 Mbit/s), where no stream fits."""
        self._control.slow_bus = on

    def attach_kernel_driver(self, on: bool = True) -> None:
        """Let the kernel's gspca_kinect hold the camera."""
        self._control.kernel_driver = on

    def set_firmware_loaded(self, on: bool = True) -> None:
        """Load the firmware of the audio device of a 1473 or K4W, which moves the motor."""
        self._control.firmware = on


class KinectReadings:
    """State of the Kinect, on its side of the cable."""

    _control: KinectControl
    control_file: Path

    @property
    def tilt_deg(self) -> int:
        """Target angle of the motor."""
        return int(self._control.tilt_to_deg)

    @property
    def tilt_moving(self) -> bool:
        """Whether the motor is still moving to its target angle."""
        control = self._control
        duration_s = abs(control.tilt_to_deg - control.tilt_from_deg) / control.tilt_deg_per_s
        return bool(time.monotonic() < control.tilt_start_ns / 1e9 + duration_s)

    @property
    def led(self) -> KinectLed:
        """State of the LED."""
        return KinectLed(self._control.led)

    @property
    def frames_sent(self) -> tuple[int, int]:
        """Frames of depth and of color sent, including those with lost packets."""
        depth, color = self._control.streams
        return depth.frames_sent, color.frames_sent

    @property
    def packets_lost(self) -> tuple[int, int]:
        """Packets of depth and of color lost by a fault."""
        depth, color = self._control.streams
        return depth.packets_lost, color.packets_lost

    @property
    def streaming(self) -> tuple[bool, bool]:
        """Whether depth and color are switched on."""
        registers = self._control.registers
        return bool(registers[REGISTER_DEPTH]), bool(registers[REGISTER_VIDEO])

    @property
    def submitted_transfers(self) -> tuple[int, int]:
        """Transfers submitted for depth and for color, including those of killed processes."""
        depth, color = self._control.streams
        return depth.submitted_transfers, color.submitted_transfers

    @property
    def abandoned_transfers(self) -> int:
        """Transfers still submitted when their device was closed without stopping the streams."""
        return int(self._control.abandoned_transfers)

    @property
    def open_handles(self) -> int:
        """Number of open handles of its devices, in living processes."""
        with self.control_file.open("r+b") as file:
            return sum(
                _is_locked(file.fileno(), LOCKS_OPEN_HANDLES + slot)
                for slot in range(OPEN_HANDLE_SLOTS)
            )


def _is_locked(file: int, byte: int) -> bool:
    request = struct.pack(_FLOCK, fcntl.F_WRLCK, 0, byte, 1, 0)
    answer = fcntl.fcntl(file, fcntl.F_OFD_GETLK, request)
    kind: int = struct.unpack(_FLOCK, answer)[0]
    return kind != fcntl.F_UNLCK
