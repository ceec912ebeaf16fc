"""The flight recorder: the last seconds of frames, saved after a loss, on command or after a crash.

Here: the output, the client of the recorder's process, and the messages between the two.
"""

import json
import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.files import MEGABYTE, state_folder
from drivers.core.flow_control import DropOldestQueue, WorkerThread
from drivers.core.process.client import FaultReporter, WorkerClient
from drivers.core.process.worker_spec import WorkerSpec
from vo_service.config_tables import RecorderConfig
from vo_service.frame_record import FrameHistory, StampedStatus
from vo_service.outputs.recorder.loss_trigger import LossTrigger
from vo_service.outputs.recorder.messages import (
    IncidentResult,
    RecorderMessage,
    RecorderStatus,
    RecorderWorkerConfig,
    RecordingResult,
    SaveIncidentRequest,
    SetDiskQuota,
    StartRecordingRequest,
    StopRecordingRequest,
    incident_name,
)
from vo_service.types import OdometryUpdate
from vo_service.types.commands import CommandError, NotPossibleError
from vo_service.types.messages import Status, versions
from vo_service.types.outputs import NullRecorder, Recorder

logger = logging.getLogger(__name__)

NAME = "recorder"
WORKER_SPEC = WorkerSpec(
    "vo_service.outputs.recorder.worker:run_recorder",
    NAME,
    exit_timeout_s=300.0,  # it finishes its writing
    finishes_alone=True,
    nice=10,
    # The service can run without such a process, so it is killed first when memory runs out.
    oom_score_adj=800,
)


class RecorderClient:
    """Sends requests to the recorder's process without blocking. Thread-safe."""

    def __init__(self, config: RecorderWorkerConfig) -> None:
        self._config = config
        self._lock = threading.Lock()
        self._saving_name = ""  # name of the incident that is being written
        self._recording_names: frozenset[str] = frozenset()
        self._missed_frames = 0
        self._incident_faults, self._recording_faults, self._folder_faults = (
            FaultReporter(NAME) for _ in range(3)
        )
        self._process_fault = ""
        self.recording = ""
        self._supervisor = WorkerClient(
            WORKER_SPEC, lambda: self._config, self._handle_message, self._handle_worker_death
        )

    @property
    def is_ready(self) -> bool:
        """Whether the process accepts requests."""
        return self._supervisor.is_ready

    @property
    def is_saving(self) -> bool:
        """Whether an incident is being written."""
        return bool(self._saving_name)

    @property
    def warning(self) -> str:
        """The fault in one clause; "" if there is none."""
        if self._supervisor.is_unresponsive:
            return "recorder: its process does not respond; the disk may hang"
        if self.recording and self._missed_frames:
            return (
                f"recorder: {self.recording} misses {self._missed_frames} frames; the disk is too "
                "slow"
            )
        write_faults = filter(None, (self._incident_faults.text, self._recording_faults.text))
        fault = "; ".join(write_faults) or self._folder_faults.text or self._process_fault
        return f"recorder: {fault}" if fault else ""

    def save(self, reason: str) -> str:
        """Write an incident; return its folder.

        Raises:
            CommandError: If that is not possible.
        """
        with self._lock:
            self._check_responsive()
            if self._saving_name:
                raise NotPossibleError(
                    f"another incident is being written: {self._saving_name}; try again later"
                )
            self._saving_name = incident_name(reason, time.time())
            self._supervisor.send(SaveIncidentRequest(self._saving_name, reason))
            return str(self._config.incidents_folder / self._saving_name)

    def start_recording(self, name: str, first_frame: int) -> str:
        """Start a recording.

        Args:
            name: Name of its folder.
            first_frame: Record number of its first frame in the ring.

        Returns:
            The folder's path.

        Raises:
            NotPossibleError: The name is taken, or a recording is running.
        """
        with self._lock:
            self._check_responsive()
            if self.recording:
                raise NotPossibleError(f"{self.recording} is being recorded; stop it first")
            if name in self._recording_names:
                raise NotPossibleError(f"a recording {name!r} exists; give another name")
            self._recording_names, self._missed_frames = self._recording_names | {name}, 0
            self._recording_faults.set("")
            self.recording = str(self._config.recordings_folder / name)
            self._supervisor.send(StartRecordingRequest(name, first_frame))
            return self.recording

    def stop_recording(self, end_frame: int) -> str:
        """End the recording before a record number; return its folder.

        Raises:
            CommandError: There is no recording.
        """
        with self._lock:
            folder, self.recording = self.recording, ""
            if not folder:
                raise NotPossibleError("nothing is being recorded")
            self._supervisor.send(StopRecordingRequest(end_frame))
            return folder

    def set_disk_quota(self, max_bytes: int) -> None:
        """Change the quota of all incidents together."""
        self._config = replace(self._config, max_incident_bytes=max_bytes)
        self._supervisor.send(SetDiskQuota(max_bytes))

    def close(self) -> None:
        """Shut the process down; it finishes its writes on its own."""
        self._supervisor.close()

    def _check_responsive(self) -> None:
        if not self._supervisor.is_ready or self._supervisor.is_unresponsive:
            raise NotPossibleError("the recorder's process does not respond; try again later")

    def _handle_message(self, message: RecorderMessage) -> None:
        match message:
            case RecorderStatus(recordings, missed, error):
                self._recording_names, self._missed_frames = recordings, missed
                self._process_fault = ""
                self._folder_faults.set(error)
            case IncidentResult(folder, frames, error):
                if not error:
                    logger.warning("recorder: the last %d frames are in %s", frames, folder)
                self._incident_faults.set(error)
                self._saving_name = ""
            case RecordingResult(folder, frames, missed, error):
                logger.info("recorder: %s: %d frames, %d missed", folder, frames, missed)
                self._recording_faults.set(error)
                # Last, so that no status has an end without its reason.
                with self._lock:  # the next recording may have started
                    if self.recording == str(folder):
                        self.recording = ""

    def _handle_worker_death(self, reason: str) -> bool:
        self._process_fault = "its process ended and is started again"
        logger.warning("recorder: %s", self._process_fault)
        with self._lock:
            for interrupted, faults in (
                (self._saving_name, self._incident_faults),
                (self.recording, self._recording_faults),
            ):
                if interrupted:
                    faults.set(f"its process ended and cut off {interrupted}")
            self._saving_name = self.recording = ""
        return True


_MAX_QUEUED = 8
_CLOSE_TIMEOUT_S = 1.0


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
        self._saves_on_loss = settings.save_on_loss
        self._loss_trigger = LossTrigger()
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
        self._save_loss_if(self._loss_trigger.is_due(now_s))

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._worker.put(StampedStatus.now(status))
        self._save_loss_if(self._loss_trigger.is_due(time.monotonic()))

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
        if settings.save_on_loss != self._saves_on_loss:
            self._saves_on_loss = settings.save_on_loss
            self._loss_trigger = LossTrigger()
        self._client.set_disk_quota(settings.total_mb * MEGABYTE)

    def close(self) -> None:
        """Write a pending loss, end the recording and release the memory."""
        if self._is_closed:
            return
        self._is_closed = True
        has_finished = self._worker.close(_CLOSE_TIMEOUT_S)
        self._save_loss_if(self._loss_trigger.is_pending)
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

    def _save_loss_if(self, is_due: bool) -> None:
        if not (is_due and self._saves_on_loss):
            return
        try:
            self._client.save("lost")
        except CommandError as error:
            logger.warning("recorder: cannot write the incident of a tracking loss: %s", error)


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
