"""A PrimeSense or Xtion sensor as a camera."""

import logging
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    FrameTimeout,
    RgbdCamera,
    RgbdFrame,
    SensorConfig,
    is_serial,
)
from drivers.core import CameraError, CameraLostError, CameraNotFoundError
from drivers.openni2.bindings import OpenNI2, OpenNI2Error, SensorType
from drivers.openni2.configure import configure_device, start_streams
from drivers.openni2.device import open_device
from drivers.openni2.stream import IncompleteFrameError, OpenNI2Stream
from drivers.rectify import CalibrationFile, make_rectifier
from drivers.time_sync import HostClockSync, NearestFramePairing, StampedPair

_log = logging.getLogger(__name__)

# The meaning of the stamps is undocumented. They are assumed to be the time of the middle row, and
# the time from there to the host is assumed to be a Kinect's.
ASSUMED_READOUT_S = 0.020
FIRST_IMAGE_TIMEOUT_S, NEXT_IMAGE_TIMEOUT_S = 2.0, 1.0
# The longest wait in the library between two checks of the timeouts.
POLL_S = 0.1


@dataclass(frozen=True)
class ReceivedColorImage:
    """A color image, its number at the sensor, and CLOCK_MONOTONIC when it was received."""

    index: int
    receive_time_s: float
    pixels: NDArray[np.uint8]


ReceivedPairs = list[StampedPair[ReceivedColorImage, NDArray[np.uint16]]]


class LiveStream:
    """One use of a sensor, from opening to closing it.

    Raises:
        CameraError: The sensor cannot be opened.
        InputError: The sensor does not fit the camera file, or cannot deliver registered frames.
    """

    def __init__(
        self,
        openni2: OpenNI2,
        name: str,
        device_id: str,
        calibration_file: CalibrationFile,
        settings: SensorConfig,
        earlier_counters: CameraCounters,
    ) -> None:

        self._name = name
        self._unplugged = threading.Event()
        with ExitStack() as undo:
            self._device = open_device(openni2, device_id)
            undo.callback(self._device.close)
            undo.enter_context(self._device.on_unplug(self._unplugged.set))
            try:
                source = configure_device(name, self._device, calibration_file, settings)
                self.rectifier = make_rectifier(source, calibration_file)
                serial = self._device.serial
                self._serial = serial if is_serial(serial) else ""
                start_streams(self._device, settings)
            except OpenNI2Error as error:
                raise CameraError(f"{name}: {error}; unplug it and plug it in again") from error
            self._streams = self._device.streams
            self._exit_stack = undo.pop_all()
        self._watchdogs = {stream.sensor: _SilenceTimer() for stream in self._streams}
        self._pairing = NearestFramePairing[ReceivedColorImage, NDArray[np.uint16]]()
        self._clock_sync = HostClockSync(ASSUMED_READOUT_S)
        self._first_index, self._next_seq = -1, 0
        self._delivered = self._dropped = self._incomplete = 0
        self._earlier_counters = earlier_counters

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the newest frame. Raises FrameTimeout, CameraLostError."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            if pairs := self._poll(deadline_s - time.monotonic()):
                return self._make_frame(pairs[-1])
            if time.monotonic() >= deadline_s:
                raise FrameTimeout

    @property
    def counters(self) -> CameraCounters:
        """Totals with those of the streams before; `skipped`: incomplete and unpaired images."""
        return self._earlier_counters + CameraCounters(
            self._delivered, self._dropped, self._incomplete + self._pairing.unpaired
        )

    def close(self) -> None:
        """Stop and release everything. May be called twice."""
        self._exit_stack.close()

    def _poll(self, timeout_s: float) -> ReceivedPairs:
        """Wait at most `POLL_S` for an image of either stream; return the pairs it completes."""
        begin_s = time.monotonic()
        try:
            stream = self._device.wait_for_any_stream(
                self._streams, max(0.0, min(timeout_s, POLL_S))
            )
            waited_s = time.monotonic() - begin_s
            for sensor, watchdog in self._watchdogs.items():
                watchdog.add(waited_s, has_received=stream is not None and stream.sensor is sensor)
            self._check_connection()
            return [] if stream is None else self._read_stream(stream)
        except OpenNI2Error as error:
            raise CameraLostError(f"{self._name}: {error}") from error

    def _read_stream(self, stream: OpenNI2Stream) -> ReceivedPairs:
        with stream.read_frame() as frame:
            receive_time_s, stamp_s = time.monotonic(), frame.stamp_us / 1e6
            try:
                image = stream.decode(frame)
                if stream.sensor is SensorType.DEPTH:
                    return self._pairing.add_depth(stamp_s, image)
                color = ReceivedColorImage(frame.index, receive_time_s, image)
                return self._pairing.add_color(stamp_s, color)
            except IncompleteFrameError as error:
                _log.warning("%s: an image is skipped: %s", self._name, error)
                self._incomplete += 1
                return []

    def _check_connection(self) -> None:
        """Raise CameraLostError if the sensor was unplugged or a stream is silent for too long."""
        if self._unplugged.is_set():
            raise CameraLostError(f"{self._name}: unplugged")
        for sensor, watchdog in self._watchdogs.items():
            if watchdog.has_timed_out:
                fault = (
                    f"stopped for {NEXT_IMAGE_TIMEOUT_S:g} s"
                    if watchdog.has_received
                    else "did not start"
                )
                raise CameraLostError(
                    f"{self._name}: its {sensor.name.lower()} stream {fault}; if this persists, "
                    "plug the sensor into a USB port on a controller of its own"
                )

    def _make_frame(self, pair: StampedPair[ReceivedColorImage, NDArray[np.uint16]]) -> RgbdFrame:
        color = pair.color
        if self._first_index < 0:
            self._first_index = color.index
        seq = max(self._next_seq, color.index - self._first_index)
        self._dropped += seq - self._next_seq
        self._delivered, self._next_seq = self._delivered + 1, seq + 1
        return RgbdFrame(
            seq=seq,
            stamp_s=self._clock_sync.to_host_s(pair.color_s, color.receive_time_s),
            receive_time_s=time.monotonic(),
            color_bgr=self.rectifier.rectify_color(color.pixels),
            depth_raw=self.rectifier.rectify_depth(pair.depth),
            depth_factor=self.rectifier.depth_factor,
            camera=self.rectifier.camera,
            device_stamp_s=pair.color_s,
            skew_s=pair.skew_s + self.rectifier.depth_offset_s,
            readout_s=self.rectifier.readout_s,
            timing_prior=self.rectifier.timing_prior,
            serial=self._serial,
        )


@dataclass
class _SilenceTimer:
    """The time spent waiting for a stream; time without a waiting reader does not count."""

    waited_s: float = 0.0
    has_received: bool = False

    def add(self, waited_s: float, has_received: bool) -> None:
        self.waited_s = 0.0 if has_received else self.waited_s + waited_s
        self.has_received = self.has_received or has_received

    @property
    def has_timed_out(self) -> bool:
        return self.waited_s > (
            NEXT_IMAGE_TIMEOUT_S if self.has_received else FIRST_IMAGE_TIMEOUT_S
        )


class OpenNI2Camera(RgbdCamera):
    """A live sensor, read on the reader's thread (see `drivers.openni2`).

    Registration of depth and synchronous capture are enabled if the sensor supports them; for the
    rule of registration see `drivers.rectify`. Depth and color are paired by nearest stamp.

    Args:
        device_id: The sensor's URI or serial number; "" for the first one.
        camera_file: Camera file; None for the sensor's own intrinsics.
        settings: Applied whenever the sensor is opened.
    """

    clock = Clock.MONOTONIC

    def __init__(
        self,
        device_id: str = "",
        camera_file: Path | None = None,
        settings: SensorConfig | None = None,
    ) -> None:
        self.name = f"openni2:{device_id}" if device_id else "openni2"
        self._device_id, self._camera_file = device_id, camera_file
        self._settings = settings or SensorConfig()
        self._openni2: OpenNI2 | None = None
        self._stream: LiveStream | None = None
        self._is_open = False
        self._status = CameraStatus(CameraState.ABSENT, "not opened yet")

    def open(self) -> None:
        """Start delivering frames. Raises UserFacingError without libOpenNI2."""
        self.close()
        calibration_file = CalibrationFile.read(self._camera_file)
        self._status = CameraStatus(CameraState.OPENING)
        try:
            self._openni2 = self._openni2 or OpenNI2()
            self._stream = LiveStream(
                self._openni2,
                self.name,
                self._device_id,
                calibration_file,
                self._settings,
                self.counters,
            )
        except CameraNotFoundError as error:
            self._status = CameraStatus(CameraState.ABSENT, str(error))
            raise
        except CameraError as error:
            self._status = CameraStatus(CameraState.OPENING, str(error))
            raise
        self._is_open = True
        self._status = CameraStatus(CameraState.STARTING)

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the newest frame, see `RgbdCamera.read`."""
        if self._stream is None or not self._is_open:
            raise CameraLostError(f"{self.name}: is not open; open it first")
        try:
            frame = self._stream.read(timeout_s)
        except CameraLostError as error:
            self._status = CameraStatus(CameraState.LOST, str(error))
            raise
        self._status = CameraStatus(CameraState.STREAMING)
        return frame

    def close(self) -> None:
        """Stop and release everything. The counters remain valid."""
        self._is_open = False
        if self._stream is not None:
            self._stream.close()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; `skipped` counts incomplete and unpaired images."""
        return self._stream.counters if self._stream else CameraCounters()

    @property
    def status(self) -> CameraStatus:
        return self._status

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; "" before `open`."""
        return self._stream.rectifier.intrinsics_source if self._stream else ""
