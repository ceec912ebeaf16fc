"""The flight recorder in the service: an output that keeps the last seconds in shared memory."""

import json
import logging
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.files import MEGABYTE
from drivers.core.folders import state_folder
from drivers.core.process.worker_spec import WorkerSpec
from drivers.core.queues import DropOldestQueue
from vo_service.config_tables import RecorderConfig
from vo_service.outputs.recorder.frame_history import FrameHistory, StampedStatus
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
from vo_service.process_output import FaultReporter, ProcessOutput, warn_disabled
from vo_service.types.commands import CommandError, NotPossibleError
from vo_service.types.messages import Status, versions
from vo_service.types.odometry_update import (
    OdometryUpdate,
    UpdateWithWheels,
    WheelMessageSource,
)
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
_MAX_QUEUED = 8


class FlightRecorder(ProcessOutput[UpdateWithWheels | StampedStatus, RecorderWorkerConfig]):
    """A `Recorder` that keeps the last seconds in shared memory, which survives a crash.

    A thread packs the frames. A second process writes them to disk: when tracking is lost, on
    command, or when this process ends without `close`.

    Args:
        settings: The recorder's settings.
        state_folder: Parent of the folders of incidents and recordings.
        service_info: Copied into each incident as JSON.
        wheel_messages: Returns the messages of the wheels since its last call.

    Raises:
        OSError: The memory cannot be allocated.
    """

    def __init__(
        self,
        settings: RecorderConfig,
        state_folder: Path,
        service_info: Mapping[str, object],
        wheel_messages: WheelMessageSource = tuple,
    ) -> None:
        super().__init__(NAME)
        self._wheel_messages = wheel_messages
        self.recording = self._saving_name = self._process_fault = ""
        self._recording_names: frozenset[str] = frozenset()
        self._missed_frames = self._recording_begin = 0
        self._incident_faults, self._recording_faults, self._folder_faults = (
            FaultReporter(NAME) for _ in range(3)
        )
        self._saves_on_loss = settings.save_on_loss
        self._loss_trigger = LossTrigger()
        self._history = FrameHistory(settings.seconds, settings.max_mb)
        config = RecorderWorkerConfig(
            frame_ring=self._history.frames.memory,
            status_ring=self._history.statuses.memory,
            incident_duration_s=settings.seconds,
            incidents_folder=settings.folder or state_folder / "incidents",
            max_incident_bytes=settings.total_mb * MEGABYTE,
            recordings_folder=state_folder / "recordings",
            service_info=json.dumps(service_info, default=str),
        )
        self._start(WORKER_SPEC, config, DropOldestQueue(_MAX_QUEUED))

    @property
    def is_saving(self) -> bool:
        """Whether an incident is being written."""
        return bool(self._saving_name)

    @property
    def frame_count(self) -> int:
        """Number of frames copied into memory since the start."""
        return self._history.frames.record_count

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue a frame, its result, and the messages of the wheels until then."""
        self._thread.put(UpdateWithWheels(update, self._wheel_messages()))
        now_s = time.monotonic()
        self._loss_trigger.update(update.state, now_s)
        self._save_loss_if(self._loss_trigger.is_due(now_s))

    def on_status(self, status: Status) -> None:
        """Queue a status."""
        self._thread.put(StampedStatus.now(status))
        self._save_loss_if(self._loss_trigger.is_due(time.monotonic()))

    def save(self, reason: str) -> str:
        if not self.frame_count:
            raise NotPossibleError("no frame has arrived yet")
        return self._save(reason)

    def start_recording(self, name: str) -> str:
        with self._requesting():
            if self.recording:
                raise NotPossibleError(f"{self.recording} is being recorded; stop it first")
            if name in self._recording_names:
                raise NotPossibleError(f"a recording {name!r} exists; give another name")
            self._recording_names, self._missed_frames = self._recording_names | {name}, 0
            self._recording_faults.set("")
            self.recording = str(self._config.recordings_folder / name)
            self._recording_begin = self.frame_count
            self._client.send(StartRecordingRequest(name, self._recording_begin))
            return self.recording

    def stop_recording(self) -> str:
        with self._lock:
            folder, self.recording = self.recording, ""
            if not folder:
                raise NotPossibleError("nothing is being recorded")
            self._client.send(StopRecordingRequest(self.frame_count))
            if self.frame_count == self._recording_begin:
                self._recording_names -= {Path(folder).name}
                raise NotPossibleError("no frame has arrived since its start: nothing was recorded")
            return folder

    def configure(self, settings: RecorderConfig) -> None:
        # An unchanged setting keeps the trigger, so a pending loss is still written.
        if settings.save_on_loss != self._saves_on_loss:
            self._saves_on_loss = settings.save_on_loss
            self._loss_trigger = LossTrigger()
        max_bytes = settings.total_mb * MEGABYTE
        self._config = replace(self._config, max_incident_bytes=max_bytes)
        self._client.send(SetDiskQuota(max_bytes))

    @property
    def _fault(self) -> str:
        if self.recording and self._missed_frames:
            return f"{self.recording} misses {self._missed_frames} frames; the disk is too slow"
        cut_off = filter(None, (self._incident_faults.text, self._recording_faults.text))
        return "; ".join(cut_off) or self._folder_faults.text or self._process_fault

    def _save(self, reason: str) -> str:
        """Write an incident; return its folder. Raises CommandError if that is not possible."""
        with self._requesting():
            if self._saving_name:
                raise NotPossibleError(
                    f"another incident is being written: {self._saving_name}; try again later"
                )
            self._saving_name = incident_name(reason, time.time())
            self._client.send(SaveIncidentRequest(self._saving_name, reason))
            return str(self._config.incidents_folder / self._saving_name)

    def _save_loss_if(self, is_due: bool) -> None:
        if not (is_due and self._saves_on_loss):
            return
        try:
            self._save("lost")
        except CommandError as error:
            logger.warning("recorder: cannot write the incident of a tracking loss: %s", error)

    def _pass_on(self, item: UpdateWithWheels | StampedStatus) -> None:
        with self._writing_memory("the last frames"):
            self._history.append(item, self.dropped)

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

    def _handle_exit(self, reason: str) -> bool:
        """Report what was not written to its end."""
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

    def _end(self, has_finished: bool, left_s: float) -> None:
        """Write a pending loss, end the recording and release the memory."""
        self._save_loss_if(self._loss_trigger.is_pending)
        self._client.close()
        if has_finished:
            self._history.close()


def open_recorder(
    settings: RecorderConfig,
    config: Mapping[str, object],
    wheel_messages: WheelMessageSource = tuple,
) -> Recorder:
    """Open the configured recorder; a `NullRecorder` if it fails.

    Args:
        settings: The recorder's settings.
        config: The service's configuration, copied into each incident with the versions.
        wheel_messages: See `FlightRecorder`.
    """
    service_info = {"versions": versions(), "config": config}
    try:
        return FlightRecorder(settings, state_folder(), service_info, wheel_messages)
    except (UserFacingError, OSError) as error:
        reason = warn_disabled("recorder: switched off", "cannot allocate its memory", error)
        return NullRecorder(reason, reason)
