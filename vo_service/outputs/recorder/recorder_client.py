"""What is being written by the recorder's process, and what went wrong with it."""

import logging
import threading
import time
from dataclasses import replace
from re import fullmatch

from drivers.core.process.fault_reporter import FaultReporter
from drivers.core.process.messages import LogMessage
from drivers.core.process.supervisor import BackgroundWorkerSpec, WorkerSupervisor
from vo_service.outputs.recorder.incident_store import incident_name
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
)
from vo_service.types import NAME_PATTERN, CommandError, ErrorCode

logger = logging.getLogger(__name__)

NAME = "recorder"
WORKER_SPEC = BackgroundWorkerSpec("vo_service.outputs.recorder.worker_main", NAME)


class RecorderClient:
    """Passes on what is asked for, at once; refuses what cannot be. Safe from any thread."""

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
        self._supervisor = WorkerSupervisor(
            WORKER_SPEC, config, self._handle_message, self._handle_worker_death
        )

    @property
    def is_ready(self) -> bool:
        """Whether the process takes orders."""
        return self._supervisor.is_ready

    @property
    def is_saving(self) -> bool:
        """Whether an incident is being written."""
        return bool(self._saving_name)

    @property
    def warning(self) -> str:
        """One clause; "" while all is well."""
        if self._supervisor.is_ready and self._supervisor.is_unresponsive:
            return "recorder: its process does not answer; is the disk hung?"
        if self.recording and self._missed_frames:
            return f"recorder: {self.recording} lacks {self._missed_frames} frames, the disk is too slow"
        failed = "; ".join(filter(None, (self._incident_faults.text, self._recording_faults.text)))
        trouble = failed or self._folder_faults.text or self._process_fault
        return f"recorder: {trouble}" if trouble else ""

    def save(self, reason: str) -> str:
        """Write an incident; its folder. Raises CommandError if that cannot be."""
        with self._lock:
            self._check_responsive()
            if self._saving_name:
                raise _not_possible_error(
                    f"an incident is being written already: {self._saving_name}"
                )
            self._saving_name = incident_name(reason, time.time())
            self._supervisor.send(SaveIncidentRequest(self._saving_name, reason))
            return str(self._config.incidents_folder / self._saving_name)

    def start_recording(self, name: str, first_frame: int) -> str:
        """Record from frame `first` of the ring on; the folder. Raises CommandError if not."""
        if not fullmatch(NAME_PATTERN, name):
            raise CommandError(
                ErrorCode.BAD_REQUEST,
                "a recording's name is up to 64 letters, digits, dots, dashes and underscores",
            )
        with self._lock:
            self._check_responsive()
            if self.recording:
                raise _not_possible_error(f"{self.recording} is being recorded; stop that first")
            if name in self._recording_names:
                raise _not_possible_error(
                    f"there is a recording {name!r} already; give another name"
                )
            self._recording_names, self._missed_frames = self._recording_names | {name}, 0
            self._recording_faults.set("")
            self.recording = str(self._config.recordings_folder / name)
            self._supervisor.send(StartRecordingRequest(name, first_frame))
            return self.recording

    def stop_recording(self, end_frame: int) -> str:
        """End it before frame `end`; the folder. Raises CommandError if nothing is recorded."""
        with self._lock:
            folder, self.recording = self.recording, ""
            if not folder:
                raise _not_possible_error("nothing is being recorded")
            self._supervisor.send(StopRecordingRequest(end_frame))
            return folder

    def set_disk_quota(self, max_bytes: int) -> None:
        """Of incidents, from now on."""
        self._supervisor.config = replace(self._config, max_incident_bytes=max_bytes)
        self._supervisor.send(SetDiskQuota(max_bytes))

    def close(self) -> None:
        """End what is being written, as far as there is time; the process goes on by itself."""
        self._supervisor.close()

    def _check_responsive(self) -> None:
        if not self._supervisor.is_ready or self._supervisor.is_unresponsive:
            raise _not_possible_error(
                "the recorder's process does not answer; try again in a moment"
            )

    def _handle_message(self, message: RecorderMessage) -> None:
        match message:
            case RecorderStatus(recordings, missed, trouble):
                self._recording_names, self._missed_frames = recordings, missed
                self._process_fault = ""
                self._folder_faults.set(trouble)
            case IncidentResult(folder, frames, trouble):
                self._saving_name = ""
                if not trouble:
                    logger.warning("recorder: the last %d frames are in %s", frames, folder)
                self._incident_faults.set(trouble)
            case RecordingResult(folder, frames, missed, trouble):
                with self._lock:  # the next one may have begun
                    if self.recording == str(folder):
                        self.recording = ""
                logger.info("recorder: %s: %d frames, %d missed", folder, frames, missed)
                self._recording_faults.set(trouble)
            case LogMessage(level, name, text):
                logging.getLogger(name).log(level, "recorder: %s", text)

    def _handle_worker_death(self) -> None:
        with self._lock:
            saving, recording = self._saving_name, self.recording
            self._saving_name = self.recording = ""
        self._process_fault = "its process ended and is started again"
        logger.warning("recorder: %s", self._process_fault)
        for cut_off, trouble in (
            (saving, self._incident_faults),
            (recording, self._recording_faults),
        ):
            if cut_off:
                trouble.set(f"its process ended and cut off {cut_off}")


def _not_possible_error(reason: str) -> CommandError:
    return CommandError(ErrorCode.NOT_POSSIBLE, reason)
