"""A sensor that is open: its newest frames, and whether it is still there."""

import logging
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.camera import CameraCounters, NoFrameYet, RgbdFrame
from drivers.device_clock import HostTime
from drivers.errors import CameraError, CameraLostError
from drivers.nearest import NearestPairing, Pair
from drivers.openni2.finding import open_device
from drivers.openni2.images import TornFrameError, colour_of, depth_of
from drivers.openni2.library import Frame, OpenNI2, OpenNI2Error, Sensor
from drivers.openni2.optics import CameraChoice, make_optics
from drivers.openni2.set_up import set_up, start
from drivers.openni2.stream import Stream
from drivers.sensor_settings import SensorSettings

# Which instant the stamps mark is written nowhere. They are taken for that of the middle row, and
# an image to need as long from there to the host as a Kinect's.
READOUT_S = 0.020
FIRST_IMAGE_S, NEXT_IMAGE_S = 2.0, 1.0
# How long the library may wait before the time-outs are looked at.
TICK_S = 0.1
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Colour:
    """A colour image: its number at the sensor, and CLOCK_MONOTONIC when it was fetched."""

    index: int
    arrival_s: float
    pixels: NDArray[np.uint8]


Pairs = list[Pair[Colour, NDArray[np.uint16]]]


class Live:
    """Made when a sensor is opened, gone when it is closed."""

    def __init__(
        self,
        openni2: OpenNI2,
        name: str,
        wanted: str,
        choice: CameraChoice,
        settings: SensorSettings,
    ) -> None:
        """Raises CameraError if the sensor cannot be opened, InputError if it cannot be used."""
        self._name = name
        self._unplugged = threading.Event()
        with ExitStack() as undo:
            self._device = open_device(openni2, wanted)
            undo.callback(self._device.close)
            undo.enter_context(self._device.on_unplug(self._unplugged.set))
            try:
                source = set_up(name, self._device, choice, settings)
                self.optics = make_optics(source, choice)
                start(self._device, settings)
            except OpenNI2Error as error:
                raise CameraError(f"{name}: {error}; plug it out and in again") from error
            self._streams = self._device.streams
            self._undo = undo.pop_all()
        self._silence = {stream.sensor: _Silence() for stream in self._streams}
        self._pairing = NearestPairing[Colour, NDArray[np.uint16]]()
        self._host_time = HostTime(READOUT_S)
        self._first_index, self._next_seq = -1, 0
        self._delivered = self._dropped = self._torn = 0

    def read(self, timeout_s: float) -> RgbdFrame:
        """The newest frame. Raises NoFrameYet, CameraLostError."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            if pairs := self._fetch(deadline_s - time.monotonic()):
                return self._frame(pairs[-1])
            if time.monotonic() >= deadline_s:
                raise NoFrameYet

    @property
    def counters(self) -> CameraCounters:
        """Totals since it was opened; `skipped` counts images torn or without a partner."""
        return CameraCounters(self._delivered, self._dropped, self._torn + self._pairing.unpaired)

    def close(self) -> None:
        """Stop and release everything. May be called twice."""
        self._undo.close()

    def _fetch(self, timeout_s: float) -> Pairs:
        """Wait for an image of either stream, at most a tick; the pairs that it decides."""
        begin_s = time.monotonic()
        try:
            stream = self._device.wait(self._streams, max(0.0, min(timeout_s, TICK_S)))
            waited_s = time.monotonic() - begin_s
            for sensor, silence in self._silence.items():
                silence.add(waited_s, heard=stream is not None and stream.sensor is sensor)
            self._check()
            return [] if stream is None else self._take(stream)
        except OpenNI2Error as error:
            raise CameraLostError(f"{self._name}: {error}") from error

    def _take(self, stream: Stream) -> Pairs:
        with stream.frame() as frame:
            stamp_s = frame.stamp_us / 1e6
            try:
                if stream.sensor is Sensor.DEPTH:
                    return self._pairing.add_depth(stamp_s, depth_of(frame))
                return self._pairing.add_colour(stamp_s, _colour(frame))
            except TornFrameError as error:
                _log.warning("%s: an image is skipped: %s", self._name, error)
                self._torn += 1
                return []

    def _check(self) -> None:
        """Raise CameraLostError if the sensor has gone or a stream is silent for too long."""
        if self._unplugged.is_set():
            raise CameraLostError(f"{self._name}: unplugged")
        for sensor, silence in self._silence.items():
            if silence.is_too_long:
                what = f"stopped for {NEXT_IMAGE_S:g} s" if silence.heard else "did not begin"
                raise CameraLostError(
                    f"{self._name}: its {sensor.name.lower()} stream {what}; if it stays so, plug "
                    "it into a USB port of its own"
                )

    def _frame(self, pair: Pair[Colour, NDArray[np.uint16]]) -> RgbdFrame:
        colour = pair.colour
        if self._first_index < 0:
            self._first_index = colour.index
        seq = max(self._next_seq, colour.index - self._first_index)
        self._dropped += seq - self._next_seq
        self._delivered, self._next_seq = self._delivered + 1, seq + 1
        return RgbdFrame(
            seq=seq,
            stamp_s=self._host_time.host_s(pair.colour_s, colour.arrival_s),
            arrival_s=time.monotonic(),
            colour_bgr=self.optics.colour(colour.pixels),
            depth_raw=self.optics.depth(pair.depth),
            depth_factor=self.optics.depth_factor,
            camera=self.optics.camera,
            device_stamp_s=pair.colour_s,
            skew_s=pair.skew_s + self.optics.depth_offset_s,
            readout_s=self.optics.readout_s,
        )


@dataclass
class _Silence:
    """How long a stream has been waited for; time in which nobody waited does not count."""

    waited_s: float = 0.0
    heard: bool = False

    def add(self, waited_s: float, heard: bool) -> None:
        self.waited_s = 0.0 if heard else self.waited_s + waited_s
        self.heard = self.heard or heard

    @property
    def is_too_long(self) -> bool:
        return self.waited_s > (NEXT_IMAGE_S if self.heard else FIRST_IMAGE_S)


def _colour(frame: Frame) -> Colour:
    return Colour(frame.index, time.monotonic(), colour_of(frame))
