"""What the recorder's process does when it is told to, each job on a thread of its own."""

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress

from drivers.errors import UserFacingError
from drivers.full_disk import obstacle
from vo_service.recorder.incident import Incident, last_frames
from vo_service.recorder.incident_folder import IncidentFolder, incident_name
from vo_service.recorder.messages import (
    Facts,
    IncidentWritten,
    Job,
    KeepAtMost,
    Order,
    SaveIncident,
    StartRecording,
    StopRecording,
    Word,
)
from vo_service.recorder.recording import Recording
from vo_service.recorder.shared_ring import Record, RingReader

# After a crash systemd waits 10 s (TimeoutStopSec) before it kills: frames first, then the rest.
FRAMES_AFTER_CRASH_S = 6.5
# Before that, what was being written is brought to an end.
RECORDING_AFTER_CRASH_S = 1.5
BEGUN_AFTER_CRASH_S = 3.0
CRASHED = "the service ended without notice"


class Desk:
    """Writes incidents and recordings out of the rings."""

    def __init__(self, job: Job, tell: Callable[[Word], None]) -> None:
        """`tell` takes words from any thread."""
        self._job, self._tell = job, tell
        self._frames, self._statuses = RingReader(job.frames), RingReader(job.statuses)
        self._incidents = IncidentFolder(job.incidents, job.total_bytes)
        self._saving = threading.Thread()
        self._saved: Incident | None = None  # the last one
        self._recording: Recording | None = None  # the last one
        with suppress(OSError):  # the facts tell what is wrong with the folder
            self._incidents.clean_up()

    @property
    def facts(self) -> Facts:
        """What is told every second."""
        recording = self._recording
        missed = 0 if recording is None or recording.is_over else recording.missed
        trouble = obstacle(self._job.incidents) or obstacle(self._job.recordings)
        names: frozenset[str] = frozenset()
        with suppress(OSError):  # none has been made yet, or it is the trouble
            names = frozenset(path.name for path in self._job.recordings.iterdir())
        return Facts(names, missed, trouble)

    def take(self, order: Order) -> None:
        """Begin what is ordered; how it ends is told."""
        match order:
            case SaveIncident(name, reason):
                self._save(name, reason)
            case StartRecording(name, first):
                folder = self._job.recordings / name
                self._recording = Recording(self._frames, first, folder, self._tell)
            case StopRecording(end):
                self._stop_recording(end)
            case KeepAtMost(total_bytes):
                self._incidents.total_bytes = total_bytes

    def finish(self) -> None:
        """The service ends in order: bring to an end what has been begun."""
        self._stop_recording(self._frames.count)
        self._join_saving()

    def rescue(self) -> None:
        """The service has crashed: write what the ring holds."""
        begin_s = time.monotonic()
        self._stop_recording(self._frames.count, RECORDING_AFTER_CRASH_S)
        if self._saved is not None:
            self._saved.hurry(begin_s + BEGUN_AFTER_CRASH_S)
        self._join_saving()
        numbers = last_frames(self._frames, self._job.seconds)
        if numbers:
            incident = self._incident(CRASHED, numbers, self._frames.record)
            incident.hurry(begin_s + FRAMES_AFTER_CRASH_S)
            self._write(incident_name("crash", time.time()), incident)

    def _stop_recording(self, end: int, timeout_s: float | None = None) -> None:
        if self._recording is not None:
            self._recording.stop(end, timeout_s)

    def _join_saving(self) -> None:
        if self._saving.ident is not None:
            self._saving.join()

    def _save(self, name: str, reason: str) -> None:
        self._join_saving()
        # The service goes on and overwrites the ring, faster than images can be encoded.
        numbers = last_frames(self._frames, self._job.seconds)
        copies = {number: self._frames.record(number) for number in numbers}
        self._saved = self._incident(reason, numbers, copies.pop)
        self._saving = threading.Thread(
            target=self._write, args=(name, self._saved), name="incident", daemon=True
        )
        self._saving.start()

    def _incident(
        self, reason: str, numbers: Iterable[int], fetch: Callable[[int], Record | None]
    ) -> Incident:
        return Incident(reason, numbers, fetch, self._said(), self._job.about)

    def _write(self, name: str, incident: Incident) -> None:
        try:
            folder, trouble = self._incidents.write(name, incident), ""
        except UserFacingError as error:
            folder, trouble = self._job.incidents / name, str(error)
        self._tell(IncidentWritten(folder, incident.frames, trouble))

    def _said(self) -> list[bytes]:
        """The statuses that are still there."""
        ring = self._statuses
        records = map(ring.record, range(ring.oldest, ring.count))
        return [record.payload for record in records if record is not None]
