"""The messages between the service and the recorder's process."""

import re
import time
from dataclasses import dataclass
from pathlib import Path

from drivers.core.process.messages import Heartbeat
from drivers.core.process.record_ring import RecordRingMemory

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
