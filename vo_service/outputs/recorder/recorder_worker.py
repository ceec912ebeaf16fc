"""What the recorder's process does when it is told to, each job on a thread of its own."""

import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress

from drivers.core.errors import UserFacingError
from drivers.core.files import check_writable
from drivers.core.shared_frames.record_ring import RecordRingReader, RingRecord
from vo_service.outputs.recorder.incident_store import IncidentStore, incident_name
from vo_service.outputs.recorder.incident_writer import IncidentWriter, select_last_frames
from vo_service.outputs.recorder.messages import (
    IncidentResult,
    RecorderMessage,
    RecorderRequest,
    RecorderStatus,
    RecorderWorkerConfig,
    SaveIncidentRequest,
    SetDiskQuota,
    StartRecordingRequest,
    StopRecordingRequest,
)
from vo_service.outputs.recorder.recording_writer import RecordingWriter

# After a crash systemd waits 10 s (TimeoutStopSec) before it kills: frames first, then the rest.
CRASH_FRAMES_DEADLINE_S = 6.5
# Before that, what was being written is brought to an end.
CRASH_RECORDING_TIMEOUT_S = 1.5
CRASH_INCIDENT_DEADLINE_S = 3.0
CRASH_REASON = "the service ended without notice"


class RecorderWorker:
    """Writes incidents and recordings out of the rings."""

    def __init__(
        self, config: RecorderWorkerConfig, send: Callable[[RecorderMessage], None]
    ) -> None:
        """`tell` takes words from any thread."""
        self._config, self._send = config, send
        self._frame_ring, self._status_ring = (
            RecordRingReader(config.frame_ring),
            RecordRingReader(config.status_ring),
        )
        self._incident_store = IncidentStore(config.incidents_folder, config.max_incident_bytes)
        self._incident_thread = threading.Thread()
        self._last_incident: IncidentWriter | None = None  # the last one
        self._last_recording: RecordingWriter | None = None  # the last one
        with suppress(OSError):  # the facts tell what is wrong with the folder
            self._incident_store.clean_up()

    @property
    def status(self) -> RecorderStatus:
        """What is told every second."""
        recording = self._last_recording
        missed = 0 if recording is None or recording.is_finished else recording.missed_frames
        trouble = check_writable(self._config.incidents_folder) or check_writable(
            self._config.recordings_folder
        )
        names: frozenset[str] = frozenset()
        with suppress(OSError):  # none has been made yet, or it is the trouble
            names = frozenset(path.name for path in self._config.recordings_folder.iterdir())
        return RecorderStatus(names, missed, trouble)

    def handle(self, request: RecorderRequest) -> None:
        """Begin what is ordered; how it ends is told."""
        match request:
            case SaveIncidentRequest(name, reason):
                self._save_incident(name, reason)
            case StartRecordingRequest(name, first):
                folder = self._config.recordings_folder / name
                self._last_recording = RecordingWriter(self._frame_ring, first, folder, self._send)
            case StopRecordingRequest(end):
                self._stop_recording(end)
            case SetDiskQuota(total_bytes):
                self._incident_store.max_total_bytes = total_bytes

    def finish(self) -> None:
        """The service ends in order: bring to an end what has been begun."""
        self._stop_recording(self._frame_ring.record_count)
        self._join_incident_thread()

    def dump_after_crash(self) -> None:
        """The service has crashed: write what the ring holds."""
        begin_s = time.monotonic()
        self._stop_recording(self._frame_ring.record_count, CRASH_RECORDING_TIMEOUT_S)
        if self._last_incident is not None:
            self._last_incident.set_deadline(begin_s + CRASH_INCIDENT_DEADLINE_S)
        self._join_incident_thread()
        numbers = select_last_frames(self._frame_ring, self._config.incident_duration_s)
        if numbers:
            incident = self._create_incident(CRASH_REASON, numbers, self._frame_ring.read_record)
            incident.set_deadline(begin_s + CRASH_FRAMES_DEADLINE_S)
            self._write_incident(incident_name("crash", time.time()), incident)

    def _stop_recording(self, end: int, timeout_s: float | None = None) -> None:
        if self._last_recording is not None:
            self._last_recording.stop(end, timeout_s)

    def _join_incident_thread(self) -> None:
        if self._incident_thread.ident is not None:
            self._incident_thread.join()

    def _save_incident(self, name: str, reason: str) -> None:
        self._join_incident_thread()
        # The service goes on and overwrites the ring, faster than images can be encoded.
        numbers = select_last_frames(self._frame_ring, self._config.incident_duration_s)
        copies = {number: self._frame_ring.read_record(number) for number in numbers}
        self._last_incident = self._create_incident(reason, numbers, copies.pop)
        self._incident_thread = threading.Thread(
            target=self._write_incident,
            args=(name, self._last_incident),
            name="incident",
            daemon=True,
        )
        self._incident_thread.start()

    def _create_incident(
        self, reason: str, numbers: Iterable[int], read_record: Callable[[int], RingRecord | None]
    ) -> IncidentWriter:
        return IncidentWriter(
            reason, numbers, read_record, self._read_statuses(), self._config.service_info
        )

    def _write_incident(self, name: str, incident: IncidentWriter) -> None:
        try:
            folder, trouble = self._incident_store.write(name, incident), ""
        except UserFacingError as error:
            folder, trouble = self._config.incidents_folder / name, str(error)
        self._send(IncidentResult(folder, incident.frame_count, trouble))

    def _read_statuses(self) -> list[bytes]:
        """The statuses that are still there."""
        ring = self._status_ring
        records = map(ring.read_record, range(ring.oldest_number, ring.record_count))
        return [record.payload for record in records if record is not None]
