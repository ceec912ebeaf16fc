"""A Kinect, or a dump of one, through libfreenect."""

import time
from collections.abc import Callable
from dataclasses import replace

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core.errors import CameraError, CameraNotFoundError
from drivers.freenect.device_source import DeviceSource
from drivers.freenect.error_messages import device_hung_error, packet_loss_message
from drivers.freenect.frame_queue import ImagePair
from drivers.freenect.rectify import KinectRectifier
from drivers.freenect.session import CaptureSession, NullSession
from drivers.freenect.valid_depth import DepthFilter, ValidDepthMask, all_depths_to_10_m
from drivers.kinect_usb.motor_unit import MotorUnit
from drivers.sensor_config import Led, SensorConfig

# Longer than a supervisor that can kill the process waits.
RELEASE_TIMEOUT_S = 10.0


class FreenectCamera(RgbdCamera):
    """Color with depth registered to it, in millimetres, 640x480, 30 a second.

    It is documented nowhere which instant a Kinect's stamp marks. Here it is assumed to be the
    one at which the image's first packet leaves, and `stamp_s` is that instant on the host's clock:
    with rows sent as they are read out, the middle row's exposure lies around it. What a
    measurement shows to be different goes into `stamp_offset_s` of the configuration.
    `seq` counts the color images that the Kinect sent.
    """

    def __init__(
        self,
        source: DeviceSource,
        rectifier: KinectRectifier,
        motor_unit: MotorUnit,
        settings: SensorConfig,
        wait_for_device: Callable[[float], object] = time.sleep,
    ) -> None:
        """`wait` waits so many seconds, or less if it notices that a device is plugged in."""
        self.name, self.clock = source.name, source.clock
        self._source, self._rectifier, self._motor_unit = source, rectifier, motor_unit
        self._settings, self._wait_for_device = settings, wait_for_device
        self._session: CaptureSession | NullSession = NullSession()
        self._depth_filter: DepthFilter = ValidDepthMask(all_depths_to_10_m())
        self._stamp_converter = source.make_stamp_converter()
        self._last_lost_packets = 0
        self._status = CameraStatus(CameraState.ABSENT, "not opened yet")

    def open(self) -> None:
        """See `RgbdCamera`. Raises UserFacingError if libfreenect is not installed."""
        self.close()
        self._status = CameraStatus(CameraState.OPENING)
        try:
            self._open()
        except CameraError as error:
            self._set_unavailable(error, CameraState.OPENING)
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """See `RgbdCamera`: the newest pair."""
        try:
            pair = self._session.get(timeout_s)
        except CameraError as error:
            self._set_unavailable(error, CameraState.LOST)
            raise
        self._status = CameraStatus(CameraState.STREAMING)
        return self._make_frame(pair, self._session.counters.lost_packets)

    def close(self) -> None:
        """See `RgbdCamera`. Waits at most 1.5 s for libfreenect."""
        self._motor_unit.close()
        self._session.stop()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; `skipped` counts depth images without a frame, torn or unpaired."""
        return self._session.counters

    @property
    def status(self) -> CameraStatus:
        """See `RgbdCamera`. While most images lack packets it says so."""
        torn, images = self._session.incomplete_images
        is_losing = self._status.state is CameraState.STREAMING and 2 * torn > images
        return (
            replace(self._status, reason=packet_loss_message(torn, images))
            if is_losing
            else self._status
        )

    @property
    def intrinsics_source(self) -> str:
        """See `RgbdCamera`; a Kinect does not tell its color camera's."""
        return self._rectifier.intrinsics_source

    @property
    def has_motor(self) -> bool:
        """See `RgbdCamera`; a dump has none."""
        return self._motor_unit.is_present

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """See `RgbdCamera`."""
        if not self.has_motor:
            super().set_tilt_deg(tilt_deg)
        self._settings = replace(self._settings, tilt_deg=tilt_deg)
        self._motor_unit.set_tilt_deg(tilt_deg)

    def set_led(self, led: Led) -> None:
        """See `RgbdCamera`."""
        if not self.has_motor:
            super().set_led(led)
        self._settings = replace(self._settings, led=led)
        self._motor_unit.set_led(led)

    def wait_for_reconnect(self, timeout_s: float) -> None:
        """See `RgbdCamera`."""
        self._wait_for_device(timeout_s)

    def _open(self) -> None:
        if not self._session.wait_until_ended(RELEASE_TIMEOUT_S):
            raise device_hung_error()
        self._session = CaptureSession(
            self._source.load(), self._source, self._rectifier.depth_format
        )
        started = self._session.start()
        self._depth_filter, self._stamp_converter = (
            started.depth_filter,
            self._source.make_stamp_converter(),
        )
        self._last_lost_packets = 0
        self._motor_unit.open(started.serial)
        self._motor_unit.apply(self._settings)
        self._status = CameraStatus(CameraState.STARTING)

    def _set_unavailable(self, error: CameraError, state: CameraState) -> None:
        """Remember why there are no frames, until the next `open`."""
        is_there = not isinstance(error, CameraNotFoundError)
        self._status = CameraStatus(state if is_there else CameraState.ABSENT, str(error))

    def _make_frame(self, pair: ImagePair, lost_packets: int) -> RgbdFrame:
        color, images = pair.color, self._rectifier
        lost, self._last_lost_packets = lost_packets - self._last_lost_packets, lost_packets
        return RgbdFrame(
            seq=color.seq,
            stamp_s=self._stamp_converter.to_host_s(pair.color_s, color.receive_time_s),
            receive_time_s=max(color.receive_time_s, pair.depth.receive_time_s),
            color_bgr=images.rectify_color(color.pixels),
            depth_raw=images.rectify_depth(pair.depth.pixels, self._depth_filter),
            depth_factor=images.depth_factor,
            camera=images.camera,
            device_stamp_s=pair.color_s,
            skew_s=pair.skew_s + images.depth_offset_s,
            lost_packets=lost,
            gravity_m_s2=self._motor_unit.gravity_m_s2,
            readout_s=images.readout_s,
        )
