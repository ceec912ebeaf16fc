"""The least that sees what the real libfreenect makes of a Kinect; for tests of the stand-ins.

In this process: ``with FreenectProbe() as probe: probe.start(); frames = probe.frames(...)``. In
one of its own, where libfreenect may hang: ``python -m tests.simulators.freenect_probe SECONDS``
prints how many frames came of each stream.
"""

import ctypes
import sys
import time
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_int, c_int8, c_int16, c_int32, c_long, c_uint32, c_void_p
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tests.simulators.kinect_simulator import KinectSimulator

SONAME = "libfreenect.so.0.5"
CAMERA, MOTOR_AND_CAMERA = 2, 3
DEPTH_RAW, DEPTH_REGISTERED, DEPTH_MM = 0, 4, 5
VIDEO_RGB, VIDEO_INFRARED_8 = 0, 2
_LOG_INFO = 4


class _Mode(ctypes.Structure):
    _fields_ = (
        ("reserved", c_uint32),
        ("resolution", c_int32),
        ("format", c_int32),
        ("bytes", c_int32),
        ("width", c_int16),
        ("height", c_int16),
        ("rest", c_int8 * 4),
    )


class _Attributes(ctypes.Structure):
    _fields_ = (("next", c_void_p), ("serial", c_char_p))


class _Time(ctypes.Structure):
    _fields_ = (("seconds", c_long), ("microseconds", c_long))


class TiltState(ctypes.Structure):
    """What the motor tells: counts, twice the angle, and whether it moves (4)."""

    _fields_ = (
        ("x", c_int16),
        ("y", c_int16),
        ("z", c_int16),
        ("half_degrees", c_int8),
        ("status", c_int32),
    )


_FRAME = ctypes.CFUNCTYPE(None, c_void_p, c_void_p, c_uint32)
_LOG = ctypes.CFUNCTYPE(None, c_void_p, c_int, c_char_p)


@dataclass
class StreamCapture:
    """What came of one stream."""

    stamps: list[int] = field(default_factory=list)
    images: list[NDArray[Any]] = field(default_factory=list)


class FreenectProbe:
    """One context and one device. `opened` is what opening returned: negative is a failure."""

    def __init__(
        self, serial: str | None = None, subdevices: int = CAMERA, library: str = SONAME
    ) -> None:
        self.lib = ctypes.CDLL(library)
        self.lib.freenect_find_depth_mode.restype = _Mode
        self.lib.freenect_find_video_mode.restype = _Mode
        self.lib.freenect_set_depth_mode.argtypes = [c_void_p, _Mode]
        self.lib.freenect_set_video_mode.argtypes = [c_void_p, _Mode]
        self.lib.freenect_set_tilt_degs.argtypes = [c_void_p, ctypes.c_double]
        self.lib.freenect_get_tilt_state.restype = POINTER(TiltState)
        self.log: list[str] = []
        self.depth, self.video = StreamCapture(), StreamCapture()
        self.on_depth: Callable[[], object] = bool  # called within libfreenect's callback
        self._context, self.device = c_void_p(), c_void_p()
        self._keep: list[Any] = []  # what C calls must not be collected
        self._open(serial, subdevices)

    def _open(self, serial: str | None, subdevices: int) -> None:
        lib, context = self.lib, self._context
        log = _LOG(lambda _, level, text: self.log.append(text.decode().strip()))
        self._keep.append(log)
        lib.freenect_init(ctypes.byref(context), None)
        lib.freenect_set_log_callback(context, log)
        lib.freenect_set_log_level(context, _LOG_INFO)
        lib.freenect_select_subdevices(context, subdevices)
        self.device_count: int = lib.freenect_num_devices(context)
        device = ctypes.byref(self.device)
        if serial is None:
            self.opened: int = lib.freenect_open_device(context, device, 0)
        else:
            by_serial = lib.freenect_open_device_by_camera_serial
            self.opened = by_serial(context, device, serial.encode())

    def serials(self) -> list[str]:
        """Of all Kinects that may be opened."""
        first = c_void_p()
        self.lib.freenect_list_device_attributes(self._context, ctypes.byref(first))
        found, at = [], first.value
        while at:
            attributes = _Attributes.from_address(at)
            found.append(attributes.serial.decode())
            at = attributes.next
        self.lib.freenect_free_device_attributes(first)
        return found

    def start(self, depth: int = DEPTH_RAW, video: int = VIDEO_RGB) -> tuple[int, int]:
        """Choose the formats and start both streams; what the two starts returned."""
        lib, device = self.lib, self.device
        depth_mode = lib.freenect_find_depth_mode(1, depth)
        video_mode = lib.freenect_find_video_mode(1, video)
        lib.freenect_set_depth_mode(device, depth_mode)
        lib.freenect_set_video_mode(device, video_mode)
        lib.freenect_set_depth_callback(
            device, self._make_callback(self.depth, depth_mode, np.uint16)
        )
        lib.freenect_set_video_callback(
            device, self._make_callback(self.video, video_mode, np.uint8)
        )
        return lib.freenect_start_depth(device), lib.freenect_start_video(device)

    def _make_callback(self, seen: StreamCapture, mode: _Mode, kind: type[np.generic]) -> Any:
        shape = (mode.height, mode.width, -1)

        def take(_: int, data: int, stamp: int) -> None:
            seen.stamps.append(stamp)
            seen.images.append(np.frombuffer(ctypes.string_at(data, mode.bytes), kind))
            seen.images[-1] = seen.images[-1].reshape(shape).squeeze()
            if seen is self.depth:
                self.on_depth()

        callback = _FRAME(take)
        self._keep.append(callback)
        return callback

    def process(self, timeout_s: float = 0.01) -> int:
        """Let libfreenect work once; what that returned."""
        wait = _Time(0, int(timeout_s * 1e6))
        result: int = self.lib.freenect_process_events_timeout(self._context, ctypes.byref(wait))
        return result

    def capture(self, frames: int, limit_s: float = 5.0) -> int:
        """Until so many frames of both streams have come, something fails, or time is up."""
        deadline_s = time.monotonic() + limit_s
        result = 0
        while result >= 0 and time.monotonic() < deadline_s:
            if min(len(self.depth.stamps), len(self.video.stamps)) >= frames:
                break
            result = self.process()
        return result

    def stop(self) -> None:
        """Both streams; a stream that does not run is left."""
        self.lib.freenect_stop_depth(self.device)
        self.lib.freenect_stop_video(self.device)

    def close(self) -> None:
        """Stop, close, shut down. Safe to call twice."""
        if self.opened == 0 and self.device:
            self.stop()
            self.lib.freenect_close_device(self.device)
        if self._context:
            self.lib.freenect_shutdown(self._context)
        self.device, self._context = c_void_p(), c_void_p()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def capture_kinect(kinect: KinectSimulator, frames: int, depth: int = DEPTH_RAW) -> FreenectProbe:
    """Look at it in this process until so many frames have come; closed, but all is remembered."""
    kinect.activate()
    with FreenectProbe() as probe:
        assert probe.opened == 0, probe.log
        assert probe.start(depth) == (0, 0)
        probe.capture(frames)
    assert min(len(probe.depth.stamps), len(probe.video.stamps)) >= frames, probe.log
    return probe


def main() -> None:
    """For a process of its own."""
    with FreenectProbe() as probe:
        print("opened", probe.opened, flush=True)
        if probe.opened == 0:
            probe.start()
            probe.capture(sys.maxsize, float(sys.argv[1]))
        print("frames", len(probe.depth.stamps), len(probe.video.stamps), flush=True)


if __name__ == "__main__":
    main()
