"""A Kinect, or a dump of one, through libfreenect."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraState,
    Condition,
    RgbdCamera,
    RgbdFrame,
)
from drivers.errors import CameraError, CameraNotFoundError
from drivers.freenect.depth import DepthFilter, MeasuredOnly, up_to_10_m
from drivers.freenect.faults import hangs, losing
from drivers.freenect.images import Images
from drivers.freenect.mailbox import ImagePair
from drivers.freenect.session import NoSession, Session
from drivers.freenect.source import Source
from drivers.kinect_usb.base import Base
from drivers.sensor_settings import Led, SensorSettings

# Longer than a supervisor that can kill the process waits.
LET_GO_LIMIT_S = 10.0


class FreenectCamera(RgbdCamera):
    """Colour with depth registered to it, in millimetres, 640x480, 30 a second.

    It is documented nowhere which instant a Kinect's stamp marks. Here it is assumed to be the
    one at which the image's first packet leaves, and `stamp_s` is that instant on the host's clock:
    with rows sent as they are read out, the middle row's exposure lies around it. What a
    measurement shows to be different goes into `stamp_offset_s` of the configuration.
    `seq` counts the colour images that the Kinect sent.
    """

    def __init__(
        self,
        source: Source,
        images: Images,
        base: Base,
        settings: SensorSettings,
        wait: Callable[[float], object] = time.sleep,
    ) -> None:
        """`wait` waits so many seconds, or less if it notices that a device is plugged in."""
        self.name, self.clock = source.name, source.clock
        self._source, self._images, self._base = source, images, base
        self._settings, self._wait = settings, wait
        self._session: Session | NoSession = NoSession()
        self._measured: DepthFilter = MeasuredOnly(up_to_10_m())
        self._stamps = source.stamp_map()
        self._lost_before = 0
        self._condition = Condition(CameraState.ABSENT, "not opened yet")

    def open(self) -> None:
        """See `RgbdCamera`. Raises UserFacingError if libfreenect is not installed."""
        self.close()
        self._condition = Condition(CameraState.OPENING)
        try:
            self._open()
        except CameraError as error:
            self._give_up(error, CameraState.OPENING)
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`: the newest pair."""
        try:
            pair = self._session.take(timeout_s)
        except CameraError as error:
            self._give_up(error, CameraState.LOST)
            raise
        self._condition = Condition(CameraState.STREAMING)
        return self._frame(pair, self._session.counters.lost_packets)

    def close(self) -> None:
        """See `RgbdCamera`. Waits at most 1.5 s for libfreenect."""
        self._base.close()
        self._session.stop()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; `skipped` counts depth images without a frame, torn or unpaired."""
        return self._session.counters

    @property
    def condition(self) -> Condition:
        """See `RgbdCamera`. While most images lack packets it says so."""
        torn, images = self._session.torn
        is_losing = self._condition.state is CameraState.STREAMING and 2 * torn > images
        return (
            replace(self._condition, reason=losing(torn, images)) if is_losing else self._condition
        )

    @property
    def intrinsics_source(self) -> str:
        """See `RgbdCamera`; a Kinect does not tell its colour camera's."""
        return self._images.source

    @property
    def has_base(self) -> bool:
        """See `RgbdCamera`; a dump has none."""
        return self._base.exists

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """See `RgbdCamera`."""
        if not self.has_base:
            super().set_tilt_deg(tilt_deg)
        self._settings = replace(self._settings, tilt_deg=tilt_deg)
        self._base.set_tilt_deg(tilt_deg)

    def set_led(self, led: Led) -> None:
        """See `RgbdCamera`."""
        if not self.has_base:
            super().set_led(led)
        self._settings = replace(self._settings, led=led)
        self._base.set_led(led)

    def wait_to_retry(self, timeout_s: float) -> None:
        """See `RgbdCamera`."""
        self._wait(timeout_s)

    def _open(self) -> None:
        if not self._session.has_ended(LET_GO_LIMIT_S):
            raise hangs()
        self._session = Session(self._source.load(), self._source, self._images.depth_format)
        started = self._session.start()
        self._measured, self._stamps = started.measured, self._source.stamp_map()
        self._lost_before = 0
        self._base.open(started.serial)
        self._base.apply(self._settings)
        self._condition = Condition(CameraState.STARTING)

    def _give_up(self, error: CameraError, state: CameraState) -> None:
        """Remember why there are no frames, until the next `open`."""
        is_there = not isinstance(error, CameraNotFoundError)
        self._condition = Condition(state if is_there else CameraState.ABSENT, str(error))

    def _frame(self, pair: ImagePair, lost_packets: int) -> RgbdFrame:
        colour, images = pair.colour, self._images
        lost, self._lost_before = lost_packets - self._lost_before, lost_packets
        return RgbdFrame(
            seq=colour.seq,
            stamp_s=self._stamps.host_s(pair.colour_s, colour.arrival_s),
            arrival_s=max(colour.arrival_s, pair.depth.arrival_s),
            colour_bgr=images.colour(colour.pixels),
            depth_raw=images.depth(pair.depth.pixels, self._measured),
            depth_factor=images.depth_factor,
            camera=images.camera,
            device_stamp_s=pair.colour_s,
            skew_s=pair.skew_s + images.depth_offset_s,
            lost_packets=lost,
            gravity_m_s2=self._base.gravity_m_s2,
            readout_s=images.readout_s,
        )
