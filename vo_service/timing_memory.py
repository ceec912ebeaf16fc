"""Memory of what a live service learns of a sensor's timing, for its next start."""

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
from vo_service.remembered_timing import (
    RememberedTiming,
    read_remembered_timing,
    timing_file,
    timing_folder,
    write_remembered_timing,
)
from vo_service.types import LEARNED_TIMING, OdometryUpdate, Output, Status

# Shortest time between two saves during a run.
SAVE_INTERVAL_S = 60.0
# Time limit, at the end, for a disk that hangs.
CLOSE_TIMEOUT_S = 0.5

logger = logging.getLogger(__name__)


class TimingMemory(Output, Protocol):
    """An output that remembers the learned timing of each sensor, by its serial number."""

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame with the timing of an earlier run, if nothing better is told."""
        ...


class NullTimingMemory:
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


class TimingFiles:
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
        # Of the present sensor: the timing at its first frame, that in its file, and the newest.
        self._at_start: RememberedTiming | None = None
        self._saved: RememberedTiming | None = None
        self._learned: RememberedTiming | None = None
        self._next_save_s = -float("inf")
        # By serial number: what this run has saved. The file may not be written yet.
        self._saved_here: dict[str, RememberedTiming] = {}
        self._has_failed = False
        self._writer = WorkerThread(
            "timing memory", DropOldestQueue[RememberedTiming](8), self._write, lambda: None
        )

    def apply(self, frame: RgbdFrame) -> RgbdFrame:
        """Return a frame with the timing of an earlier run, if its camera file tells none."""
        if frame.serial != self._serial:
            self._save_last()
            self._serial = frame.serial
            self._learned = None
            self._at_start = self._saved = self._read(frame.serial) if frame.serial else None
        return self._at_start.apply(frame) if self._at_start else frame

    def on_update(self, update: OdometryUpdate) -> None:
        """Save the estimate of this frame, if it is certain and has clearly changed."""
        timing, serial = update.estimate.timing, update.frame.serial
        if not serial or serial != self._serial:
            return
        if timing is None or timing.source != LEARNED_TIMING:
            return
        self._learned = RememberedTiming(
            serial,
            timing.readout_s,
            timing.depth_offset_s,
            timing.readout_sigma_s,
            timing.depth_offset_sigma_s,
        )
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

    def _save(self, timing: RememberedTiming) -> None:
        self._saved = self._saved_here[timing.serial] = timing
        self._next_save_s = self._now_s() + SAVE_INTERVAL_S
        self._writer.put(timing)

    def _read(self, serial: str) -> RememberedTiming | None:
        if serial in self._saved_here:
            return self._saved_here[serial]
        try:
            return read_remembered_timing(self._folder, serial)
        except InputError as error:
            self.warning = (
                f"{error} (the learned timing of an earlier run is lost; the usual values hold)"
            )
            logger.warning("%s", self.warning)
            return None

    def _write(self, timing: RememberedTiming) -> None:
        """Body of the writer's thread for one save."""
        try:
            write_remembered_timing(self._folder, timing)
        except OSError as error:
            path = timing_file(self._folder, timing.serial)
            self.warning = (
                f"{path}: {describe_write_error(error)}; the learned timing is lost at the end"
            )
            if not self._has_failed:
                logger.warning("%s", self.warning)
            self._has_failed = True
        else:
            self.warning = ""


def open_timing_memory(timing_mode: str) -> TimingMemory:
    """Open the memory in the state folder; a `NullTimingMemory` if it is off or fails.

    Args:
        timing_mode: One of `TIMING_MODES`; nothing is remembered with a fixed timing.
    """
    if timing_mode == FIXED_TIMING_MODE:
        return NullTimingMemory()
    try:
        return TimingFiles(timing_folder(state_folder()))
    except UserFacingError as error:
        warning = f"timing memory: switched off: {error}"
        logger.warning("%s", warning)
        return NullTimingMemory(warning)
