"""The flight recorder: the last seconds of frames, which survive a crash of the service.

Here: the messages between the service and the recorder's process, and the client of the process.
"""

import logging
import re
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.core.process import Heartbeat, RecordRingMemory, WorkerSpec
from drivers.core.process.supervisor import FaultReporter, WorkerSupervisor
from vo_service.types.commands import NAME_PATTERN, CommandError, ErrorCode, NotPossibleError

_MAX_REASON_LENGTH = 40


@dataclass(frozen=True)
class RecorderWorkerConfig:
    """Configuration of the recorder's process.

    Attributes:
        frame_ring: Shared memory of the frames.
        status_ring: Shared memory of the statuses.
        incident_duration_s: Time span of an incident, seconds.
        incidents_folder: Folder of the incidents.
        max_incident_bytes: Quota of all incidents together.
        recordings_folder: Folder of the recordings.
        service_info: JSON object about the service, copied into each incident.
    """

    frame_ring: RecordRingMemory
    status_ring: RecordRingMemory
    incident_duration_s: float
    incidents_folder: Path
    max_incident_bytes: int
    recordings_folder: Path
    service_info: str

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors of both rings."""
        return self.frame_ring.fd, self.status_ring.fd


def incident_name(reason: str, unix_s: float) -> str:
    """Return the name of an incident's folder, such as 2026-11-21T16-30-05Z-lost."""
    suffix = re.sub("[^a-z0-9]+", "-", reason.lower()).strip("-")[:_MAX_REASON_LENGTH] or "saved"
    return f"{time.strftime('%Y-%m-%dT%H-%M-%SZ', time.gmtime(unix_s))}-{suffix}"


@dataclass(frozen=True)
class SaveIncidentRequest:
    """Request to write the frames of the ring into an incident of this name."""

    name: str
    reason: str


@dataclass(frozen=True)
class StartRecordingRequest:
    """Request to record all frames, from this record number of the ring on."""

    name: str
    first_frame: int


@dataclass(frozen=True)
class StopRecordingRequest:
    """Request to end the recording before this record number."""

    end_frame: int


@dataclass(frozen=True)
class SetDiskQuota:
    """Request to change the quota of all incidents together."""

    max_bytes: int


RecorderRequest = SaveIncidentRequest | StartRecordingRequest | StopRecordingRequest | SetDiskQuota


@dataclass(frozen=True)
class RecorderStatus(Heartbeat):
    """Status of the recorder's process, every second.

    Attributes:
        recording_names: Names of the existing recordings.
        missed_frames: Frames of the current recording that were overwritten too early.
        error: Why a folder is not writable; "" if all are.
    """

    recording_names: frozenset[str]
    missed_frames: int
    error: str = ""


@dataclass(frozen=True)
class IncidentResult:
    """Result of a `SaveIncidentRequest`. `error` is "" on success."""

    folder: Path
    frame_count: int
    error: str = ""


@dataclass(frozen=True)
class RecordingResult:
    """Result of a recording, which ended on request or because of `error`."""

    folder: Path
    frame_count: int
    missed_frames: int
    error: str = ""


RecorderMessage = RecorderStatus | IncidentResult | RecordingResult


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
        self._supervisor = WorkerSupervisor(
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
            CommandError: The name is invalid or taken, or a recording is running.
        """
        if not re.fullmatch(NAME_PATTERN, name):
            raise CommandError(
                ErrorCode.BAD_REQUEST,
                "a recording's name is up to 64 letters, digits, dots, dashes and underscores",
            )
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
