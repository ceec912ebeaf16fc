"""Memory of what a live service learns of a sensor, timing and focal length, for its next start."""

import logging
import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from drivers.camera import RgbdFrame
from drivers.core.errors import InputError, UserFacingError
from drivers.core.files import describe_write_error, state_folder
from drivers.core.queues import DropOldestQueue, WorkerThread
from vo_service.odometry.registry import FIXED_TIMING_MODE
from vo_service.remembered_sensor import (
    RememberedFocalLength,
    RememberedSensor,
    read_remembered_sensor,
    sensor_file,
    sensor_folder,
    write_remembered_sensor,
)
from vo_service.types import LEARNED_TIMING, OdometryUpdate
from vo_service.types.messages import Status
from vo_service.types.outputs import Output

# Shortest time between two saves during a run.
SAVE_INTERVAL_S = 60.0
# Time limit, at the end, for a disk that hangs.
CLOSE_TIMEOUT_S = 0.5

logger = logging.getLogger(__name__)


class SensorMemory(Output, Protocol):
    """An output that remembers what was learned of each sensor, by its serial number."""

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame with what an earlier run has learned, if nothing better is told."""
        ...


class NullSensorMemory:
    """Null memory: nothing is used or saved.

    Attributes:
        warning: Fault for the status; "" = none.
    """

    def __init__(self, warning: str = "") -> None:
        self.warning = warning

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return the frame unchanged."""
        return frame

    def on_update(self, update: OdometryUpdate) -> None:
        """Ignore the update."""

    def on_status(self, status: Status) -> None:
        """Ignore the status."""

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class SensorFiles:
    """Memory in files, one per sensor.

    A sensor's file is read at its first frame. It is written when the estimate has clearly changed,
    at most once a minute; and when the service ends, or another sensor is plugged in.

    Args:
        folder: Folder of the files; it is made when the first one is written.
        now_s: The clock, s.
    """

    def __init__(self, folder: Path, now_s: Callable[[], float] = time.monotonic) -> None:
        self.warning = ""
        self._folder, self._now_s = folder, now_s
        self._serial = ""
        # Of the present sensor: what was known at its first frame, is in its file, and is newest.
        self._at_start: RememberedSensor | None = None
        self._saved: RememberedSensor | None = None
        self._learned: RememberedSensor | None = None
        self._next_save_s = -float("inf")
        # By serial number: what this run has saved. The file may not be written yet.
        self._saved_here: dict[str, RememberedSensor] = {}
        self._has_failed = False
        self._writer = WorkerThread(
            "sensor memory", DropOldestQueue[RememberedSensor](8), self._write, lambda: None
        )

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame with what an earlier run has learned, see `RememberedSensor.apply`."""
        if frame.serial != self._serial:
            self._save_last()
            self._serial = frame.serial
            self._learned = None
            self._at_start = self._saved = self._read(frame.serial) if frame.serial else None
        return self._at_start.apply(frame) if self._at_start else frame

    def on_update(self, update: OdometryUpdate) -> None:
        """Save the estimate of this frame, if it is certain and has clearly changed."""
        if not self._serial or update.frame.serial != self._serial:
            return
        learned = _learned_of(update, self._learned or self._at_start)
        if learned is None:
            return
        self._learned = learned
        if self._now_s() < self._next_save_s:
            return
        if self._saved is None or self._learned.has_changed(self._saved):
            self._save(self._learned)

    def on_status(self, status: Status) -> None:
        """Do nothing: updates have the timing."""

    def close(self) -> None:
        """Save the last estimate."""
        self._save_last()
        self._learned = None
        self._writer.close(CLOSE_TIMEOUT_S)

    def _save_last(self) -> None:
        if self._learned is not None and self._learned != self._saved:
            self._save(self._learned)

    def _save(self, sensor: RememberedSensor) -> None:
        self._saved = self._saved_here[sensor.serial] = sensor
        self._next_save_s = self._now_s() + SAVE_INTERVAL_S
        self._writer.put(sensor)

    def _read(self, serial: str) -> RememberedSensor | None:
        if serial in self._saved_here:
            return self._saved_here[serial]
        try:
            return read_remembered_sensor(self._folder, serial)
        except InputError as error:
            self.warning = (
                f"{error} (what an earlier run has learned is lost; the usual values hold)"
            )
            logger.warning("%s", self.warning)
            return None

    def _write(self, sensor: RememberedSensor) -> None:
        """Body of the writer's thread for one save."""
        try:
            write_remembered_sensor(self._folder, sensor)
        except OSError as error:
            path = sensor_file(self._folder, sensor.serial)
            self.warning = (
                f"{path}: {describe_write_error(error)}; what is learned is lost at the end"
            )
            if not self._has_failed:
                logger.warning("%s", self.warning)
            self._has_failed = True
        else:
            self.warning = ""


def _learned_of(update: OdometryUpdate, before: RememberedSensor | None) -> RememberedSensor | None:
    """Return what was learned until this update, and before; None if nothing is certain."""
    timing, focal_length = update.estimate.timing, update.estimate.focal_length
    if timing is None:
        return None
    remembered_focal = before.focal_length if before else None
    if focal_length is not None and focal_length.disagreement is not None:
        remembered_focal = RememberedFocalLength(
            update.frame.camera.fx,
            focal_length.scale,
            focal_length.sigma,
            focal_length.disagreement,
        )
    elif timing.source != LEARNED_TIMING:
        return None
    return RememberedSensor(
        update.frame.serial,
        timing.readout_s,
        timing.depth_offset_s,
        timing.readout_sigma_s,
        timing.depth_offset_sigma_s,
        remembered_focal,
    )


def open_sensor_memory(timing_mode: str) -> SensorMemory:
    """Open the memory in the state folder; a `NullSensorMemory` if it is off or fails.

    Args:
        timing_mode: One of `TIMING_MODES`; nothing is remembered with a fixed timing.
    """
    if timing_mode == FIXED_TIMING_MODE:
        return NullSensorMemory()
    try:
        return SensorFiles(sensor_folder(state_folder()))
    except UserFacingError as error:
        warning = f"memory of sensors: switched off: {error}"
        logger.warning("%s", warning)
        return NullSensorMemory(warning)
