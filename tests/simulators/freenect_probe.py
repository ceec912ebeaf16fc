"""A minimal program on the real libfreenect, for tests of the simulators.

In this process: ``with FreenectProbe() as probe: probe.start(); probe.capture(...)``. In a separate
process, where libfreenect may hang: ``python -m tests.simulators.freenect_probe SECONDS`` prints
the number of frames of each stream.
"""

import ctypes
import sys
import time
from collections.abc import Callable
from ctypes import POINTER, c_char_p, c_int, c_int8, c_int16, c_int32, c_long, c_uint32, c_void_p
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from tests.simulators.kinect_simulator import KinectSimulator

SONAME = "libfreenect.so.0.5"
CAMERA, MOTOR_AND_CAMERA = 2, 3
DEPTH_RAW, DEPTH_REGISTERED, DEPTH_MM = 0, 4, 5
VIDEO_RGB = 0
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


class _Time(ctypes.Structure):
    _fields_ = (("seconds", c_long), ("microseconds", c_long))


class TiltState(ctypes.Structure):
    """State of the motor: accelerometer counts, twice the angle, and status (4: moving)."""

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
    """The frames received from one stream."""

    stamps: list[int] = field(default_factory=list)
    images: list[NDArray[Any]] = field(default_factory=list)


class FreenectProbe:
    """One context and one device.

    Attributes:
        open_result: What opening the device returned; negative is a failure.
        device_count: Number of devices that libfreenect sees.
        depth: Frames of the depth stream.
        video: Frames of the color stream.
        log: Lines that libfreenect logged.
        on_depth: Called within libfreenect's callback of each depth frame.
    """

    def __init__(self, subdevices: int = CAMERA) -> None:
        self.lib = ctypes.CDLL(SONAME)
        self.lib.freenect_find_depth_mode.restype = _Mode
        self.lib.freenect_find_video_mode.restype = _Mode
        self.lib.freenect_set_depth_mode.argtypes = [c_void_p, _Mode]
        self.lib.freenect_set_video_mode.argtypes = [c_void_p, _Mode]
        self.lib.freenect_set_tilt_degs.argtypes = [c_void_p, ctypes.c_double]
        self.lib.freenect_get_tilt_state.restype = POINTER(TiltState)
        self.log: list[str] = []
        self.depth, self.video = StreamCapture(), StreamCapture()
        self.on_depth: Callable[[], object] = bool
        self._context, self.device = c_void_p(), c_void_p()
        self._callbacks: list[Any] = []  # C calls them: they must not be garbage collected
        self._open(subdevices)

    def _open(self, subdevices: int) -> None:
        lib, context = self.lib, self._context
        log = _LOG(lambda _, level, text: self.log.append(text.decode().strip()))
        self._callbacks.append(log)
        lib.freenect_init(ctypes.byref(context), None)
        lib.freenect_set_log_callback(context, log)
        lib.freenect_set_log_level(context, _LOG_INFO)
        lib.freenect_select_subdevices(context, subdevices)
        self.device_count: int = lib.freenect_num_devices(context)
        device = ctypes.byref(self.device)
        self.open_result: int = lib.freenect_open_device(context, device, 0)

    def start(self, depth: int = DEPTH_RAW, video: int = VIDEO_RGB) -> tuple[int, int]:
        """Set the formats and start both streams; return the results of both starts."""
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

    def _make_callback(self, capture: StreamCapture, mode: _Mode, kind: type[np.generic]) -> Any:
        shape = (mode.height, mode.width, -1)

        def receive(_: int, data: int, stamp: int) -> None:
            capture.stamps.append(stamp)
            capture.images.append(np.frombuffer(ctypes.string_at(data, mode.bytes), kind))
            capture.images[-1] = capture.images[-1].reshape(shape).squeeze()
            if capture is self.depth:
                self.on_depth()

        callback = _FRAME(receive)
        self._callbacks.append(callback)
        return callback

    def process(self, timeout_s: float = 0.01) -> int:
        """Let libfreenect process events once; return its result."""
        wait = _Time(0, int(timeout_s * 1e6))
        result: int = self.lib.freenect_process_events_timeout(self._context, ctypes.byref(wait))
        return result

    def capture(self, frames: int, limit_s: float = 5.0) -> int:
        """Receive until both streams have `frames` frames, a call fails, or `limit_s` is over."""
        deadline_s = time.monotonic() + limit_s
        result = 0
        while result >= 0 and time.monotonic() < deadline_s:
            if min(len(self.depth.stamps), len(self.video.stamps)) >= frames:
                break
            result = self.process()
        return result

    def stop(self) -> None:
        """Stop both streams, if they run."""
        self.lib.freenect_stop_depth(self.device)
        self.lib.freenect_stop_video(self.device)

    def close(self) -> None:
        """Stop the streams, close the device and shut libfreenect down. Safe to call twice."""
        if self.open_result == 0 and self.device:
            self.stop()
            self.lib.freenect_close_device(self.device)
        if self._context:
            self.lib.freenect_shutdown(self._context)
        self.device, self._context = c_void_p(), c_void_p()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()


def capture_kinect(kinect: KinectSimulator, frames: int, depth: int = DEPTH_RAW) -> FreenectProbe:
    """Receive `frames` frames in this process; return the closed probe with what it received."""
    kinect.activate()
    with FreenectProbe() as probe:
        assert probe.open_result == 0, probe.log
        assert probe.start(depth) == (0, 0)
        probe.capture(frames)
    assert min(len(probe.depth.stamps), len(probe.video.stamps)) >= frames, probe.log
    return probe


def main() -> None:
    """Run the probe for the seconds of the first argument."""
    with FreenectProbe() as probe:
        print("opened", probe.open_result, flush=True)
        if probe.open_result == 0:
            probe.start()
            probe.capture(sys.maxsize, float(sys.argv[1]))
        print("frames", len(probe.depth.stamps), len(probe.video.stamps), flush=True)


if __name__ == "__main__":
    main()
