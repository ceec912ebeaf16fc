"""A PrimeSense or Xtion sensor as a camera."""

from pathlib import Path

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    RgbdCamera,
    RgbdFrame,
    SensorConfig,
)
from drivers.core.errors import CameraError, CameraLostError, CameraNotFoundError
from drivers.openni2.library import OpenNI2
from drivers.openni2.live_stream import LiveStream
from drivers.openni2.rectify import CalibrationFile


class OpenNI2Camera(RgbdCamera):
    """A live sensor, read on the reader's thread (see `drivers.openni2.library`).

    Registration of depth and synchronous capture are enabled if the sensor supports them; for the
    rule of registration see `drivers.openni2.rectify`. Depth and color are paired by nearest stamp.

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
        self._calibration_file = CalibrationFile(None, None)
        self._openni2: OpenNI2 | None = None
        self._stream: LiveStream | None = None
        self._is_open = False
        self._status = CameraStatus(CameraState.ABSENT, "not opened yet")

    def open(self) -> None:
        """Start delivering frames.

        Raises:
            UserFacingError: If libOpenNI2 is not installed.
        """
        self.close()
        self._calibration_file = CalibrationFile.read(self._camera_file)
        self._status = CameraStatus(CameraState.OPENING)
        try:
            self._openni2 = self._openni2 or OpenNI2()
            self._stream = LiveStream(
                self._openni2,
                self.name,
                self._device_id,
                self._calibration_file,
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
