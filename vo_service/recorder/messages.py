"""What the service and the recorder's process say to each other; frames go through the ring."""

from dataclasses import dataclass
from pathlib import Path

from drivers.isolation.messages import LogLine
from vo_service.background.messages import End, SignOfLife
from vo_service.recorder.shared_ring import RingMemory


@dataclass(frozen=True)
class Job:
    """To the recorder, first and once.

    seconds           of frames that an incident holds
    incidents         folder of the incidents, of which at most `total_bytes` are kept
    recordings        folder of the recordings
    about             JSON object about the service, copied into each incident
    log_level         of the service's log
    """

    frames: RingMemory
    statuses: RingMemory
    seconds: float
    incidents: Path
    total_bytes: int
    recordings: Path
    about: str
    log_level: int

    @property
    def fds(self) -> tuple[int, ...]:
        """Both rings."""
        return self.frames.fd, self.statuses.fd


@dataclass(frozen=True)
class SaveIncident:
    """To the recorder: write out what the ring holds, into a folder of this name."""

    name: str
    reason: str


@dataclass(frozen=True)
class StartRecording:
    """To the recorder: record all frames from the one with this number in the ring on."""

    name: str
    first: int


@dataclass(frozen=True)
class StopRecording:
    """To the recorder: end the recording before the frame with this number."""

    end: int


@dataclass(frozen=True)
class KeepAtMost:
    """To the recorder: so much of incidents, from now on."""

    total_bytes: int


Order = SaveIncident | StartRecording | StopRecording | KeepAtMost | End


@dataclass(frozen=True)
class Facts(SignOfLife):
    """From the recorder, every second.

    recordings  names that are taken
    missed      frames that this recording lacks, as they were overwritten before they were written
    trouble     why nothing can be kept in a folder; "" while all is well
    """

    recordings: frozenset[str]
    missed: int
    trouble: str = ""


@dataclass(frozen=True)
class IncidentWritten:
    """From the recorder: how a `SaveIncident` ended. `trouble` is "" if it is all there."""

    folder: Path
    frames: int
    trouble: str = ""


@dataclass(frozen=True)
class RecordingEnded:
    """From the recorder: the recording has ended, by order or because of `trouble`."""

    folder: Path
    frames: int
    missed: int
    trouble: str = ""


Word = Facts | IncidentWritten | RecordingEnded | LogLine
