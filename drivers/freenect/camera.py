"""A Kinect, or a recorded dump of one, through libfreenect."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Led,
    PlaybackMode,
    RgbdCamera,
    RgbdFrame,
    SensorConfig,
    is_serial,
)
from drivers.core import CameraError, CameraNotFoundError
from drivers.freenect.context import ImagePair
from drivers.freenect.conversion import DUMP_CONVERSION, load_kernels
from drivers.freenect.errors import device_hung_error, packet_loss_message
from drivers.freenect.factory_calibration import FactoryCalibration, kinect_properties
from drivers.freenect.session import CaptureSession, NullSession
from drivers.freenect.sources import DeviceSource, FakenectSource, KinectSource
from drivers.kinect_usb.motor_unit import MotorUnit
from drivers.rectify import CalibrationFile, Rectifier, make_rectifier

# Longer than a supervisor waits before it kills the process.
RELEASE_TIMEOUT_S = 10.0
_log = logging.getLogger(__name__)


class FreenectCamera(RgbdCamera):
    """A Kinect: color and registered depth in millimeters, 640x480, 30 frames per second.

    The meaning of a Kinect's stamp is undocumented. It is assumed to be the time when the image's
    first packet leaves; `stamp_s` is that time on the host's clock. Rows are sent as they are read
    out, so the middle row is exposed at about that time. A measured difference belongs in
    `stamp_offset_s` of the configuration.
    `seq` counts the color images that the Kinect sent.

    Args:
        camera_file: Camera file; None for the values of the factory, or the usual ones.
        settings: Applied whenever the camera is opened.
        wait_for_device: Waits a number of seconds, or less if a device is plugged in.

    Raises:
        InputError: The camera file does not fit the Kinect.
    """

    def __init__(
        self,
        source: DeviceSource,
        camera_file: Path | None,
        motor_unit: MotorUnit,
        settings: SensorConfig,
        wait_for_device: Callable[[float], object] = time.sleep,
    ) -> None:
        self.name, self.clock = source.name, source.clock
        self._source, self._motor_unit = source, motor_unit
        self._calibration_file = CalibrationFile.read(camera_file)
        self._rectifier = self._make_rectifier(factory_focal_px=None)
        self._settings, self._wait_for_device = settings, wait_for_device
        self._session: CaptureSession | NullSession = NullSession()
        self._conversion = DUMP_CONVERSION  # until the device is open
        self._to_host_s = source.make_stamp_converter()
        self._last_lost_packets = 0
        self._factory_problem = ""
        self._serial = ""
        self._status = CameraStatus(CameraState.ABSENT, "not opened yet")

    def open(self) -> None:
        """Start delivering frames. Raises UserFacingError without libfreenect."""
        self.close()
        self._status = CameraStatus(CameraState.OPENING)
        try:
            self._open()
        except CameraError as error:
            self._set_unavailable(error, CameraState.OPENING)
            raise

    def read(self, timeout_s: float) -> RgbdFrame:
        """Wait for the newest frame, see `RgbdCamera.read`."""
        try:
            pair = self._session.get(timeout_s)
        except CameraError as error:
            self._set_unavailable(error, CameraState.LOST)
            raise
        self._status = CameraStatus(CameraState.STREAMING)
        return self._make_frame(pair, self._session.counters.lost_packets)

    def close(self) -> None:
        """Release the camera. Waits at most 1.5 s for libfreenect."""
        self._motor_unit.close()
        self._session.stop()

    @property
    def counters(self) -> CameraCounters:
        """See `RgbdCamera`; `skipped` counts incomplete and unpaired depth images."""
        return self._session.counters

    @property
    def status(self) -> CameraStatus:
        """The status now; its reason reports when most images lack packets."""
        incomplete, images = self._session.incomplete_images
        if self._status.state is CameraState.STREAMING and 2 * incomplete > images:
            return replace(self._status, reason=packet_loss_message(incomplete, images))
        return self._status

    @property
    def intrinsics_source(self) -> str:
        """The origin of the intrinsics; that of the factory is known once the camera is open."""
        return self._rectifier.intrinsics_source

    @property
    def has_motor(self) -> bool:
        """Whether there are a motor and an LED; a dump has none."""
        return self._motor_unit.is_present

    def set_tilt_deg(self, tilt_deg: float) -> None:
        if not self.has_motor:
            super().set_tilt_deg(tilt_deg)
        self._settings = replace(self._settings, tilt_deg=tilt_deg)
        self._motor_unit.set_tilt_deg(tilt_deg)

    def set_led(self, led: Led) -> None:
        if not self.has_motor:
            super().set_led(led)
        self._settings = replace(self._settings, led=led)
        self._motor_unit.set_led(led)

    def wait_for_reconnect(self, timeout_s: float) -> None:
        self._wait_for_device(timeout_s)

    def _open(self) -> None:
        if not self._session.wait_until_ended(RELEASE_TIMEOUT_S):
            raise device_hung_error()
        self._session = CaptureSession(
            self._source.load(),
            self._source,
            self.counters,
            registers_depth=not self._calibration_file.has_depth_camera,
        )
        started = self._session.start()
        self._conversion = started.calibration.conversion
        self._use_factory_calibration(started.calibration.factory)
        self._to_host_s = self._source.make_stamp_converter()
        self._serial = started.serial if is_serial(started.serial) else ""
        self._motor_unit.open(started.serial)
        self._motor_unit.apply(self._settings)
        self._status = CameraStatus(CameraState.STARTING)

    def _use_factory_calibration(self, factory: FactoryCalibration | None) -> None:
        """Use the focal length in the Kinect's memory, if no camera file tells one."""
        if factory is None or self._calibration_file.path is not None:
            return
        focal_px = None
        try:
            focal_px = factory.color_focal_px()
        except ValueError as error:
            if str(error) != self._factory_problem:
                _log.warning(
                    "%s: the calibration in the Kinect's memory is not plausible, the usual values "
                    "are used: %s; calibrate it with kinect-vo calibrate",
                    self.name,
                    error,
                )
            self._factory_problem = str(error)
        self._rectifier = self._make_rectifier(focal_px)

    def _make_rectifier(self, factory_focal_px: float | None) -> Rectifier:
        file = self._calibration_file
        return make_rectifier(
            kinect_properties(self.name, file.has_depth_camera, factory_focal_px), file
        )

    def _set_unavailable(self, error: CameraError, state: CameraState) -> None:
        """Keep the reason for missing frames in the status until the next `open`."""
        is_absent = isinstance(error, CameraNotFoundError)
        self._status = CameraStatus(CameraState.ABSENT if is_absent else state, str(error))

    def _make_frame(self, pair: ImagePair, lost_packets: int) -> RgbdFrame:
        color, rectifier, camera = pair.color, self._rectifier, self._rectifier.camera
        bgr, depth = self.make_images(camera.width, camera.height)
        self._conversion.to_bgr(color.pixels, bgr)
        self._conversion.to_mm(pair.depth.pixels, depth)
        bgr, depth = rectifier.rectify_color(bgr), rectifier.rectify_depth(depth)
        if self._settings.mirror:
            import cv2  # here, because without it nothing of the driver needs OpenCV

            # Finished images, because libfreenect's registration needs unmirrored depth.
            bgr, depth = cv2.flip(bgr, 1), cv2.flip(depth, 1)  # type: ignore[assignment]
            camera = replace(camera, cx=camera.width - 1 - camera.cx)
        newly_lost, self._last_lost_packets = lost_packets - self._last_lost_packets, lost_packets
        return RgbdFrame(
            seq=color.seq,
            stamp_s=self._to_host_s(pair.color_s, color.receive_time_s),
            receive_time_s=max(color.receive_time_s, pair.depth.receive_time_s),
            color_bgr=bgr,
            depth_raw=depth,
            depth_factor=rectifier.depth_factor,
            camera=camera,
            device_stamp_s=pair.color_s,
            skew_s=pair.skew_s + rectifier.depth_offset_s,
            lost_packets=newly_lost,
            gravity_m_s2=self._motor_unit.gravity_m_s2,
            accelerometer=self._motor_unit.accelerometer,
            readout_s=rectifier.readout_s,
            timing_prior=rectifier.timing_prior,
            serial=self._serial,
        )


def make_kinect_camera(serial: str, settings: SensorConfig, camera_file: Path | None) -> RgbdCamera:
    """Make the Kinect with this serial number ("" for the first one found), with its motor unit.

    Raises:
        InputError: The camera file does not fit the Kinect.
    """
    from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit
    from drivers.kinect_usb.usb_devices import wait_for_device

    load_kernels()  # now, because `open` must not take as long as their compilation
    source = KinectSource(serial, settings)
    return FreenectCamera(source, camera_file, KinectMotorUnit(), settings, wait_for_device)


def make_fakenect_camera(
    folder: Path, camera_file: Path | None, playback_mode: PlaybackMode = PlaybackMode.REALTIME
) -> RgbdCamera:
    """Make the camera of a dump in libfreenect's format with depth in millimeters.

    Only one can exist in a process.

    Raises:
        InputError: The camera file does not fit the Kinect.
    """
    source = FakenectSource(folder, playback_mode)
    return FreenectCamera(source, camera_file, MotorUnit(), SensorConfig())
