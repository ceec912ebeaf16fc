"""The recorder's process: it handles requests, and writes each folder on a thread of its own.

If the service ends without `Shutdown`, it has crashed; the process then writes the ring to disk.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import partial

from drivers.core.errors import UserFacingError
from drivers.core.files import check_writable
from drivers.core.process.service_connection import ServiceConnection
from drivers.core.shared_frames.record_ring import RecordRingReader, RingRecord
from vo_service.outputs.recorder.incidents import (
    IncidentStore,
    IncidentWriter,
    incident_name,
    select_last_frames,
)
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

# After a crash systemd waits 10 s (TimeoutStopSec) before it kills the process.
CRASH_FRAMES_DEADLINE_S = 6.5
# Writes that were under way get this long before the crash incident.
CRASH_RECORDING_TIMEOUT_S = 1.5
CRASH_INCIDENT_DEADLINE_S = 3.0
CRASH_REASON = "the service crashed"


STATUS_PERIOD_S = 1.0


def run_recorder(service: ServiceConnection) -> None:
    """Handle requests until the service asks the process to end, or ends itself."""
    os.umask(0o077)  # other users must not read images of the robot's surroundings
    worker = RecorderWorker(service.config, partial(_send, service))
    with suppress(EOFError):
        while True:
            service.send(worker.status)
            request = service.receive(STATUS_PERIOD_S)
            if request is not None:
                worker.handle(request)
    if service.is_connected:
        worker.finish()
    else:
        worker.dump_after_crash()


def _send(service: ServiceConnection, message: RecorderMessage) -> None:
    """Send a message; if the service is gone, print an incident's result."""
    if not service.send(message) and isinstance(message, IncidentResult):
        print(_crash_message(message), file=sys.stderr, flush=True)


def _crash_message(result: IncidentResult) -> str:
    if result.error:
        return f"kinect-vo: error: recorder: the frames before the crash are lost: {result.error}"
    return (
        "kinect-vo: warning: recorder: the service crashed; its last "
        f"{result.frame_count} frames are in {result.folder}"
    )


class RecorderWorker:
    """Writes incidents and recordings from the rings."""

    def __init__(
        self, config: RecorderWorkerConfig, send: Callable[[RecorderMessage], None]
    ) -> None:
        """`send` must be thread-safe."""
        self._config, self._send = config, send
        self._frame_ring, self._status_ring = (
            RecordRingReader(config.frame_ring),
            RecordRingReader(config.status_ring),
        )
        self._incident_store = IncidentStore(config.incidents_folder, config.max_incident_bytes)
        self._incident_thread = threading.Thread()
        self._last_incident: IncidentWriter | None = None
        self._last_recording: RecordingWriter | None = None
        with suppress(OSError):  # `status` reports what is wrong with the folder
            self._incident_store.clean_up()

    @property
    def status(self) -> RecorderStatus:
        """The status that the process sends every second."""
        recording = self._last_recording
        missed = 0 if recording is None or recording.is_finished else recording.missed_frames
        error = check_writable(self._config.incidents_folder) or check_writable(
            self._config.recordings_folder
        )
        names: frozenset[str] = frozenset()
        with suppress(OSError):  # the folder does not exist yet, or `error` says what is wrong
            names = frozenset(path.name for path in self._config.recordings_folder.iterdir())
        return RecorderStatus(names, missed, error)

    def handle(self, request: RecorderRequest) -> None:
        """Start what a request asks for; the result is sent later."""
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
        """Finish all writes, at a normal end of the service."""
        self._stop_recording(self._frame_ring.record_count)
        self._join_incident_thread()

    def dump_after_crash(self) -> None:
        """Write the frames of the ring into an incident, after the service has crashed."""
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
        # Copy first: the service overwrites the ring faster than images can be encoded.
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
            folder, message = self._incident_store.write(name, incident), ""
        except UserFacingError as error:
            folder, message = self._config.incidents_folder / name, str(error)
        self._send(IncidentResult(folder, incident.frame_count, message))

    def _read_statuses(self) -> list[bytes]:
        """Read the statuses that are not overwritten yet."""
        ring = self._status_ring
        records = map(ring.read_record, range(ring.oldest_number, ring.record_count))
        return [record.payload for record in records if record is not None]
