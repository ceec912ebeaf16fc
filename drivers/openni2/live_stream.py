"""A sensor that is open: its newest frames, and whether it is still there."""

import logging
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import CameraCounters, FrameTimeout, RgbdFrame
from drivers.core.errors import CameraError, CameraLostError
from drivers.openni2.configure import configure_device, start_streams
from drivers.openni2.decode import IncompleteFrameError, decode_color, decode_depth
from drivers.openni2.enumeration import open_device
from drivers.openni2.library import OniFrame, OpenNI2, OpenNI2Error, SensorType
from drivers.openni2.rectify import CalibrationFile, make_rectifier
from drivers.openni2.stream import OpenNI2Stream
from drivers.sensor_config import SensorConfig
from drivers.time_sync import HostClockSync, NearestFramePairing, StampedPair

# Which instant the stamps mark is written nowhere. They are taken for that of the middle row, and
# an image to need as long from there to the host as a Kinect's.
ASSUMED_READOUT_S = 0.020
FIRST_IMAGE_TIMEOUT_S, NEXT_IMAGE_TIMEOUT_S = 2.0, 1.0
# How long the library may wait before the time-outs are looked at.
POLL_S = 0.1
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReceivedColorImage:
    """A color image: its number at the sensor, and CLOCK_MONOTONIC when it was fetched."""

    index: int
    receive_time_s: float
    pixels: NDArray[np.uint8]


ReceivedPairs = list[StampedPair[ReceivedColorImage, NDArray[np.uint16]]]


class LiveStream:
    """Made when a sensor is opened, gone when it is closed."""

    def __init__(
        self,
        openni2: OpenNI2,
        name: str,
        device_id: str,
        calibration_file: CalibrationFile,
        settings: SensorConfig,
    ) -> None:
        """Raises CameraError if the sensor cannot be opened, InputError if it cannot be used."""
        self._name = name
        self._unplugged = threading.Event()
        with ExitStack() as undo:
            self._device = open_device(openni2, device_id)
            undo.callback(self._device.close)
            undo.enter_context(self._device.on_unplug(self._unplugged.set))
            try:
                source = configure_device(name, self._device, calibration_file, settings)
                self.rectifier = make_rectifier(source, calibration_file)
                start_streams(self._device, settings)
            except OpenNI2Error as error:
                raise CameraError(f"{name}: {error}; plug it out and in again") from error
            self._streams = self._device.streams
            self._exit_stack = undo.pop_all()
        self._watchdogs = {stream.sensor: _SilenceTimer() for stream in self._streams}
        self._pairing = NearestFramePairing[ReceivedColorImage, NDArray[np.uint16]]()
        self._clock_sync = HostClockSync(ASSUMED_READOUT_S)
        self._first_index, self._next_seq = -1, 0
        self._delivered = self._dropped = self._incomplete = 0

    def read(self, timeout_s: float) -> RgbdFrame:
        """The newest frame. Raises NoFrameYet, CameraLostError."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            if pairs := self._poll(deadline_s - time.monotonic()):
                return self._make_frame(pairs[-1])
            if time.monotonic() >= deadline_s:
                raise FrameTimeout

    @property
    def counters(self) -> CameraCounters:
        """Totals since it was opened; `skipped` counts images torn or without a partner."""
        return CameraCounters(
            self._delivered, self._dropped, self._incomplete + self._pairing.unpaired
        )

    def close(self) -> None:
        """Stop and release everything. May be called twice."""
        self._exit_stack.close()

    def _poll(self, timeout_s: float) -> ReceivedPairs:
        """Wait for an image of either stream, at most a tick; the pairs that it decides."""
        begin_s = time.monotonic()
        try:
            stream = self._device.wait_for_any_stream(
                self._streams, max(0.0, min(timeout_s, POLL_S))
            )
            waited_s = time.monotonic() - begin_s
            for sensor, silence in self._watchdogs.items():
                silence.add(waited_s, has_received=stream is not None and stream.sensor is sensor)
            self._check_connection()
            return [] if stream is None else self._read_stream(stream)
        except OpenNI2Error as error:
            raise CameraLostError(f"{self._name}: {error}") from error

    def _read_stream(self, stream: OpenNI2Stream) -> ReceivedPairs:
        with stream.read_frame() as frame:
            stamp_s = frame.stamp_us / 1e6
            try:
                if stream.sensor is SensorType.DEPTH:
                    return self._pairing.add_depth(stamp_s, decode_depth(frame))
                return self._pairing.add_color(stamp_s, _receive_color(frame))
            except IncompleteFrameError as error:
                _log.warning("%s: an image is skipped: %s", self._name, error)
                self._incomplete += 1
                return []

    def _check_connection(self) -> None:
        """Raise CameraLostError if the sensor has gone or a stream is silent for too long."""
        if self._unplugged.is_set():
            raise CameraLostError(f"{self._name}: unplugged")
        for sensor, silence in self._watchdogs.items():
            if silence.has_timed_out:
                what = (
                    f"stopped for {NEXT_IMAGE_TIMEOUT_S:g} s"
                    if silence.has_received
                    else "did not begin"
                )
                raise CameraLostError(
                    f"{self._name}: its {sensor.name.lower()} stream {what}; if it stays so, plug "
                    "it into a USB port of its own"
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
        )


@dataclass
class _SilenceTimer:
    """How long a stream has been waited for; time in which nobody waited does not count."""

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


def _receive_color(frame: OniFrame) -> ReceivedColorImage:
    return ReceivedColorImage(frame.index, time.monotonic(), decode_color(frame))
