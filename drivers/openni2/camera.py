"""A PrimeSense or Xtion sensor as a camera."""

from pathlib import Path

from drivers.camera import (
    CameraCounters,
    CameraState,
    Clock,
    Condition,
    RgbdCamera,
    RgbdFrame,
)
from drivers.errors import CameraError, CameraLostError, CameraNotFoundError
from drivers.openni2.library import OpenNI2
from drivers.openni2.live import Live
from drivers.openni2.optics import CameraChoice
from drivers.sensor_settings import SensorSettings


class OpenNI2Camera(RgbdCamera):
    """The newest frames of a sensor, on the reader's thread (see `drivers.openni2.library`).

    `wanted` is the sensor's URI or serial number, "" for the first one. The sensor is asked to
    register depth to colour and to take both at once, and the answer is checked:
    `drivers.openni2.optics` has the rule. Depth and colour are paired by nearest stamp.
    """

    clock = Clock.MONOTONIC

    def __init__(
        self,
        wanted: str = "",
        camera_file: Path | None = None,
        settings: SensorSettings | None = None,
    ) -> None:
        self.name = f"openni2:{wanted}" if wanted else "openni2"
        self._wanted, self._camera_file = wanted, camera_file
        self._settings = settings or SensorSettings()
        self._choice = CameraChoice(None, None)
        self._openni2: OpenNI2 | None = None
        self._live: Live | None = None
        self._is_open = False
        self._condition = Condition(CameraState.ABSENT, "not opened yet")

    def open(self) -> None:
        """Start delivering. Raises as `RgbdCamera.open`; UserFacingError without libOpenNI2."""
        self.close()
        self._choice = CameraChoice.read(self._camera_file)
        self._condition = Condition(CameraState.OPENING)
        try:
            self._openni2 = self._openni2 or OpenNI2()
            self._live = Live(self._openni2, self.name, self._wanted, self._choice, self._settings)
        except CameraNotFoundError as error:
            self._condition = Condition(CameraState.ABSENT, str(error))
            raise
        except CameraError as error:
            self._condition = Condition(CameraState.OPENING, str(error))
            raise
        self._is_open = True
        self._condition = Condition(CameraState.STARTING)

    def read(self, timeout_s: float) -> RgbdFrame:
        """The newest frame, as the contract says."""
        if self._live is None or not self._is_open:
            raise CameraLostError(f"{self.name}: is not open")
        try:
            frame = self._live.read(timeout_s)
        except CameraLostError as error:
            self._condition = Condition(CameraState.LOST, str(error))
            raise
        self._condition = Condition(CameraState.STREAMING)
        return frame

    def close(self) -> None:
        """Stop and release everything; what has been counted can still be asked for."""
        self._is_open = False
        if self._live is not None:
            self._live.close()

    @property
    def counters(self) -> CameraCounters:
        """Totals since `open`; `skipped` counts images torn or without a partner."""
        return self._live.counters if self._live else CameraCounters()

    @property
    def condition(self) -> Condition:
        """See `RgbdCamera`."""
        return self._condition

    @property
    def intrinsics_source(self) -> str:
        """See `RgbdCamera`; "" before `open`."""
        return self._live.optics.intrinsics_source if self._live else ""
