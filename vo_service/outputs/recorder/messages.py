"""What the service and the recorder's process say to each other; frames go through the ring."""

from dataclasses import dataclass
from pathlib import Path

from drivers.core.process.messages import Heartbeat, LogMessage, Shutdown
from drivers.core.shared_frames.record_ring import RecordRingMemory


@dataclass(frozen=True)
class RecorderWorkerConfig:
    """To the recorder, first and once.

    seconds           of frames that an incident holds
    incidents         folder of the incidents, of which at most `total_bytes` are kept
    recordings        folder of the recordings
    about             JSON object about the service, copied into each incident
    log_level         of the service's log
    """

    frame_ring: RecordRingMemory
    status_ring: RecordRingMemory
    incident_duration_s: float
    incidents_folder: Path
    max_incident_bytes: int
    recordings_folder: Path
    service_info: str
    log_level: int

    @property
    def fds(self) -> tuple[int, ...]:
        """Both rings."""
        return self.frame_ring.fd, self.status_ring.fd


@dataclass(frozen=True)
class SaveIncidentRequest:
    """To the recorder: write out what the ring holds, into a folder of this name."""

    name: str
    reason: str


@dataclass(frozen=True)
class StartRecordingRequest:
    """To the recorder: record all frames from the one with this number in the ring on."""

    name: str
    first_frame: int


@dataclass(frozen=True)
class StopRecordingRequest:
    """To the recorder: end the recording before the frame with this number."""

    end_frame: int


@dataclass(frozen=True)
class SetDiskQuota:
    """To the recorder: so much of incidents, from now on."""

    max_bytes: int


RecorderRequest = (
    SaveIncidentRequest | StartRecordingRequest | StopRecordingRequest | SetDiskQuota | Shutdown
)


@dataclass(frozen=True)
class RecorderStatus(Heartbeat):
    """From the recorder, every second.

    recordings  names that are taken
    missed      frames that this recording lacks, as they were overwritten before they were written
    trouble     why nothing can be kept in a folder; "" while all is well
    """

    recording_names: frozenset[str]
    missed_frames: int
    error: str = ""


@dataclass(frozen=True)
class IncidentResult:
    """From the recorder: how a `SaveIncident` ended. `trouble` is "" if it is all there."""

    folder: Path
    frame_count: int
    error: str = ""


@dataclass(frozen=True)
class RecordingResult:
    """From the recorder: the recording has ended, by order or because of `trouble`."""

    folder: Path
    frame_count: int
    missed_frames: int
    error: str = ""


RecorderMessage = RecorderStatus | IncidentResult | RecordingResult | LogMessage
