"""The flight recorder: keeps the last seconds in memory and saves them after a loss."""

import json
import logging
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers.core import UserFacingError
from drivers.core.files import state_folder
from drivers.core.flow_control import DropOldestQueue, WorkerThread
from drivers.core.process import RecordRingWriter
from vo_service.config_tables import MEGABYTE, RecorderConfig
from vo_service.frame_record import compile_kernels, pack_depth, write_frame
from vo_service.outputs.recorder import RecorderClient, RecorderWorkerConfig
from vo_service.types import OdometryUpdate, TrackingState
from vo_service.types.commands import CommandError, NotPossibleError
from vo_service.types.messages import Status, versions
from vo_service.types.outputs import NullRecorder, Recorder

logger = logging.getLogger(__name__)

STATUS_RING_S = 60.0
STATUS_RING_BYTES = 1_000_000


@dataclass(frozen=True)
class StampedStatus:
    """A status with its time on CLOCK_REALTIME and CLOCK_MONOTONIC."""

    status: Status
    unix_s: float
    monotonic_s: float

    @classmethod
    def now(cls, status: Status) -> "StampedStatus":
        """Stamp a status with the current time."""
        return cls(status, time.time(), time.monotonic())


class FrameHistory:
    """Writer of both rings, for one thread."""

    def __init__(self, seconds: float, max_mb: int) -> None:
        """Allocate the rings.

        Raises:
            OSError: If there is no memory.
        """
        self.frames = RecordRingWriter("recorder-frames", seconds, max_mb * MEGABYTE)
        try:
            self.statuses = RecordRingWriter("recorder-statuses", STATUS_RING_S, STATUS_RING_BYTES)
        except OSError:
            self.frames.close()
            raise
        compile_kernels()

    def append(self, item: OdometryUpdate | StampedStatus, missed: int) -> None:
        """Append an item. `missed` counts dropped items.

        Raises:
            OSError: If there is no memory.
        """
        if isinstance(item, OdometryUpdate):
            write_frame(self.frames, item, pack_depth)
        else:
            self._put_status(item, missed)

    def close(self) -> None:
        """Release the memory."""
        with suppress(BufferError):  # a reader still holds a buffer; the process ends soon
            self.frames.close()
            self.statuses.close()

    def _put_status(self, stamped: StampedStatus, missed: int) -> None:
        content = {
            "unix_s": stamped.unix_s,
            "monotonic_s": stamped.monotonic_s,
            **asdict(stamped.status),
            "recorder": self._ring_stats(missed),
        }
        line = json.dumps(content).encode()
        buffer = self.statuses.reserve(len(line), stamped.monotonic_s)
        buffer[: len(line)] = np.frombuffer(line, np.uint8)
        self.statuses.commit(len(line), b"", len(line), stamped.monotonic_s)

    def _ring_stats(self, missed: int) -> dict[str, Any]:
        return {
            "frames": self.frames.record_count,
            "missed": missed,
            "ring_mb": round(self.frames.used_bytes / MEGABYTE, 1),
            "limited_by": "max_mb" if self.frames.is_limited_by_bytes else "seconds",
        }


# The incident must contain the loss itself.
DELAY_S = 1.0
# In the dark, tracking is lost again and again; one incident is enough.
MIN_INTERVAL_S = 30.0
_TRACKED_STATES = (TrackingState.TRACKING, TrackingState.DEGRADED)
_MAX_QUEUED = 8
_CLOSE_TIMEOUT_S = 1.0


class LossTrigger:
    """Trigger that fires one second after a loss, then not again for a while.

    Times are seconds on CLOCK_MONOTONIC.
    """

    def __init__(self) -> None:
        self._last_state = TrackingState.NO_CAMERA
        self._due_s = math.inf
        self._suppressed_until_s = -math.inf

    @property
    def is_pending(self) -> bool:
        """Whether the trigger is still to fire for a loss."""
        return self._due_s < math.inf

    def update(self, state: TrackingState, now_s: float) -> None:
        """Add the state of the next pose."""
        is_new_loss = state is TrackingState.LOST and self._last_state in _TRACKED_STATES
        if is_new_loss and now_s >= self._suppressed_until_s:
            self._due_s = now_s + DELAY_S
            self._suppressed_until_s = now_s + MIN_INTERVAL_S
        self._last_state = state

    def is_due(self, now_s: float) -> bool:
        """Return True once, when the incident should be written."""
        if now_s < self._due_s:
            return False
        self._due_s = math.inf
        return True


class NullLossTrigger:
    """Trigger that never fires."""

    is_pending = False

    def update(self, state: TrackingState, now_s: float) -> None:
        """Ignore the state."""

    def is_due(self, now_s: float) -> bool:
        """Return False."""
        return False


class FlightRecorder:
    """A `Recorder` that keeps the last seconds in shared memory, which survives a crash.

    A thread packs the frames. A second process writes them to disk: when tracking is lost, on
    command, or when this process ends without `close`.
    """

    def __init__(
        self, settings: RecorderConfig, state_folder: Path, service_info: Mapping[str, object]
    ) -> None:
        """Start the recorder.

        Args:
            settings: The recorder's settings.
            state_folder: Parent of the folders of incidents and recordings.
            service_info: Copied into each incident as JSON.

        Raises:
            OSError: The memory cannot be allocated.
        """
        self._history = FrameHistory(settings.seconds, settings.max_mb)
        self._memory_fault = ""
        self._should_save_on_loss = settings.save_on_loss
        self._loss_trigger = _create_loss_trigger(self._should_save_on_loss)
        self._is_closed = False
        self._client = RecorderClient(
            RecorderWorkerConfig(
                frame_ring=self._history.frames.memory,
                status_ring=self._history.statuses.memory,
                incident_duration_s=settings.seconds,
                incidents_folder=settings.folder or state_folder / "incidents",
                max_incident_bytes=settings.total_mb * MEGABYTE,
                recordings_folder=state_folder / "recordings",
                service_info=json.dumps(service_info, default=str),
            )
        )
        self._worker: WorkerThread[OdometryUpdate | StampedStatus] = WorkerThread(
            "recorder", DropOldestQueue(_MAX_QUEUED), self._append, lambda: None
        )

    @property
    def warning(self) -> str:
        return self._memory_fault or self._client.warning

    @property
    def recording(self) -> str:
        return self._client.recording

    @property
    def is_ready(self) -> bool:
        """Whether the worker process accepts requests."""
        return self._client.is_ready

    @property
    def is_saving(self) -> bool:
        """Whether an incident is being written."""
        return self._client.is_saving

    @property
    def frame_count(self) -> int:
        """Number of frames copied into memory since the start."""
        return self._history.frames.record_count

    @property
    def dropped(self) -> int:
        """Number of frames and statuses dropped from the queue."""
        return self._worker.dropped

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue a frame and its result."""
        self._worker.put(update)
        now_s = time.monotonic()
        self._loss_trigger.update(update.state, now_s)
        self._save_incident_if(self._loss_trigger.is_due(now_s))

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._worker.put(StampedStatus.now(status))
        self._save_incident_if(self._loss_trigger.is_due(time.monotonic()))

    def save(self, reason: str) -> str:
        if not self._history.frames.record_count:
            raise NotPossibleError("no frame has arrived yet")
        return self._client.save(reason)

    def start_recording(self, name: str) -> str:
        return self._client.start_recording(name, self._history.frames.record_count)

    def stop_recording(self) -> str:
        return self._client.stop_recording(self._history.frames.record_count)

    def configure(self, settings: RecorderConfig) -> None:
        # An unchanged setting keeps the trigger, so a pending loss is still written.
        if settings.save_on_loss != self._should_save_on_loss:
            self._should_save_on_loss = settings.save_on_loss
            self._loss_trigger = _create_loss_trigger(self._should_save_on_loss)
        self._client.set_disk_quota(settings.total_mb * MEGABYTE)

    def close(self) -> None:
        """Write a pending loss, end the recording and release the memory."""
        if self._is_closed:
            return
        self._is_closed = True
        has_finished = self._worker.close(_CLOSE_TIMEOUT_S)
        self._save_incident_if(self._loss_trigger.is_pending)
        self._client.close()
        if has_finished:
            self._history.close()

    def _append(self, item: OdometryUpdate | StampedStatus) -> None:
        """Copy one item into memory; runs on the worker thread."""
        try:
            self._history.append(item, self._worker.dropped)
            self._memory_fault = ""
        except OSError as error:
            self._memory_fault = f"recorder: no memory for the last frames: {error.strerror}"

    def _save_incident_if(self, is_due: bool) -> None:
        if not is_due:
            return
        try:
            self._client.save("lost")
        except CommandError as error:
            logger.warning("recorder: cannot write the incident of a tracking loss: %s", error)


def _create_loss_trigger(is_enabled: bool) -> LossTrigger | NullLossTrigger:
    return LossTrigger() if is_enabled else NullLossTrigger()


def open_recorder(settings: RecorderConfig, config: Mapping[str, object]) -> Recorder:
    """Create the configured recorder; if that fails, a null recorder, so the service still runs.

    Args:
        settings: The recorder's settings.
        config: The service's configuration, copied into each incident with the versions.
    """
    service_info = {"versions": versions(), "config": config}
    try:
        return FlightRecorder(settings, state_folder(), service_info)
    except UserFacingError as error:
        reason = f"recorder: switched off: {error}"
    except OSError as error:
        reason = f"recorder: switched off: cannot allocate its memory: {error.strerror}"
    logger.warning("%s", reason)
    return NullRecorder(reason, reason)
