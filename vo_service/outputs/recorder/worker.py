"""The recorder's process: it handles requests, and writes each folder on a thread of its own.

If the service ends without `Shutdown`, it has crashed; the process then writes the ring to disk.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.files import check_writable
from drivers.core.process.record_ring import RecordRingReader, RingRecord
from drivers.core.process.service_connection import ServiceConnection
from drivers.core.write_errors import writing
from drivers.recording.frame_recorder import FrameRecorder
from drivers.recording.image_encoding import ColorFormat
from drivers.tum.writer import TumFolder
from vo_service.config_tables import MIN_FREE_BYTES
from vo_service.frame_record import decode_frame, decode_metadata
from vo_service.outputs.recorder.incidents import IncidentStore, IncidentWriter, select_last_frames
from vo_service.outputs.recorder.messages import (
    IncidentResult,
    RecorderMessage,
    RecorderRequest,
    RecorderStatus,
    RecorderWorkerConfig,
    RecordingResult,
    SaveIncidentRequest,
    SetDiskQuota,
    StartRecordingRequest,
    StopRecordingRequest,
    incident_name,
)

_POLL_PERIOD_S = 0.03
# JPEG takes a third of PNG's time and size; two slow cores cannot encode PNG fast enough.
COLOR_FORMAT = ColorFormat.JPEG


class RecordingWriter:
    """Thread that writes the frames of the ring as they arrive.

    The first frame creates the folder. The recording continues after a camera disconnects and
    returns.
    """

    def __init__(
        self,
        ring: RecordRingReader,
        first_frame: int,
        folder: Path,
        send_result: Callable[[RecordingResult], None],
    ) -> None:
        """Start the thread.

        Args:
            ring: Ring of frames.
            first_frame: Record number of the first frame.
            folder: Folder of the recording.
            send_result: Called once, at the end.
        """
        self.folder = folder
        self.missed_frames = 0
        self._ring, self._send_result = ring, send_result
        self._next_record, self._end_frame = first_frame, sys.maxsize
        self._writer: FrameRecorder[TumFolder] | None = None  # from the first frame on
        self._offset_s = 0.0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def is_finished(self) -> bool:
        """Whether the thread has ended."""
        return not self._thread.is_alive()

    def stop(self, end_frame: int, timeout_s: float | None = None) -> None:
        """End the recording before a record number, and wait for the thread."""
        if not self._stop.is_set():
            self._end_frame = end_frame
            self._stop.set()
        self._thread.join(timeout_s)

    def _run(self) -> None:
        message = ""
        try:
            with writing(self.folder), ExitStack() as stack:
                self.folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                is_last = False
                while not is_last:
                    is_last = self._stop.wait(_POLL_PERIOD_S)
                    self._write_new(stack)
        except UserFacingError as error:
            message = str(error)
        frames = 0 if self._writer is None else self._writer.written
        self._send_result(RecordingResult(self.folder, frames, self.missed_frames, message))

    def _write_new(self, stack: ExitStack) -> None:
        """Write the frames that have arrived since the last call."""
        end = min(self._ring.record_count, self._end_frame)
        begin = min(end, max(self._next_record, self._ring.oldest_number))
        self.missed_frames += begin - self._next_record
        self._next_record = end
        for number in range(begin, end):
            record = self._ring.read_record(number)
            if record is None:
                self.missed_frames += 1
            else:
                self._write(record, stack)

    def _write(self, record: RingRecord, stack: ExitStack) -> None:
        if self._writer is None:
            self._offset_s = decode_metadata(record.metadata).clock_offset_s
            writer = FrameRecorder(
                TumFolder(self.folder, color_format=COLOR_FORMAT, min_free_bytes=MIN_FREE_BYTES)
            )
            self._writer = stack.enter_context(writer)
        odometry = decode_metadata(record.metadata).odometry
        self._writer.write(decode_frame(record, self._offset_s), odometry=odometry)


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
