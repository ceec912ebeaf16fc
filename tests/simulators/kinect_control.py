"""The control file of a simulated Kinect, with the fields of ``libusb/control.h``."""

import ctypes
import mmap
from ctypes import c_char, c_float, c_int32, c_int64, c_uint16, c_uint32, c_uint64
from pathlib import Path
from typing import Any

MAGIC = 0x4B494E31
SERIAL_BYTES = 32
PATH_BYTES = 1024
LOCKS_OPEN_HANDLES = 1 << 20
OPEN_HANDLE_SLOTS = 64
REGISTER_VIDEO = 0x05
REGISTER_DEPTH = 0x06


class StreamControl(ctypes.Structure):
    """Settings and state of one stream."""

    _fields_ = (
        ("stalled", c_uint32),
        ("lose_every", c_uint32),
        ("lose_next", c_uint32),
        ("offset_ns", c_int32),
        ("frames_sent", c_uint64),
        ("packets_lost", c_uint64),
        ("sends_from_ns", c_uint64),
        ("submitted_transfers", c_uint32),
        ("unused", c_uint32),
    )


class KinectControl(ctypes.Structure):
    """Settings and state of a Kinect."""

    _fields_ = (
        ("magic", c_uint32),
        ("size", c_uint32),
        ("model", c_uint32),
        ("camera_serial", c_char * SERIAL_BYTES),
        ("audio_serial", c_char * SERIAL_BYTES),
        ("recording", c_char * PATH_BYTES),
        ("registration", c_int32 * 29),
        ("padding", c_uint16 * 3),
        ("const_shift", c_uint16),
        ("zero_plane", c_float * 4),
        ("plugged", c_uint32),
        ("generation", c_uint32),
        ("frozen", c_uint32),
        ("busy", c_uint32),
        ("forbidden", c_uint32),
        ("starved", c_uint32),
        ("slow_bus", c_uint32),
        ("firmware", c_uint32),
        ("kernel_driver", c_uint32),
        ("rate", c_uint32),
        ("loop", c_uint32),
        ("start_ticks", c_uint32),
        ("tilt_deg_per_s", c_uint32),
        ("acceleration", c_int32 * 3),
        ("tilt_from_deg", c_int32),
        ("tilt_to_deg", c_int32),
        ("led", c_uint32),
        ("tilt_start_ns", c_uint64),
        ("playback_start_ns", c_uint64),
        ("clock_start_frame", c_int64),
        ("abandoned_transfers", c_uint32),
        ("waits_for_reader", c_uint32),
        ("streams", StreamControl * 2),
        ("registers", c_uint16 * 0x400),
        ("cmos", c_uint16 * 0x400),
    )


def create_control(file: Path) -> KinectControl:
    """Create a control file and map it; the simulated libusb sees every write at once."""
    with file.open("w+b") as stream:
        stream.truncate(ctypes.sizeof(KinectControl))
        mapping = mmap.mmap(stream.fileno(), ctypes.sizeof(KinectControl))
    control = KinectControl.from_buffer(mapping)
    control.magic = MAGIC
    control.size = ctypes.sizeof(KinectControl)
    return control


class ControlField:
    """An attribute that is a field of `self._control`."""

    def __init__(self, field: str) -> None:
        self._field = field

    def __get__(self, owner: Any, owner_type: type | None = None) -> int:
        return int(getattr(owner._control, self._field))

    def __set__(self, owner: Any, value: int) -> None:
        setattr(owner._control, self._field, value)
