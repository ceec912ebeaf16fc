"""Recording on command: a thread copies frames from the ring into a TUM folder."""

import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from drivers.core.errors import UserFacingError
from drivers.core.files import free_disk_bytes
from drivers.core.shared_frames.record_ring import RecordRingReader, RingRecord
from drivers.recording.encode import ColorFormat
from drivers.tum.writer import TumWriter
from vo_service.frame_record import decode_frame, decode_metadata
from vo_service.outputs.recorder.messages import RecordingResult

# A recording leaves this much of the disk free.
MIN_FREE_BYTES = 1_000_000_000
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
        self._writer: TumWriter | None = None  # from the first frame on
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
            self.folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with ExitStack() as stack:
                is_last = False
                while not is_last:
                    is_last = self._stop.wait(_POLL_PERIOD_S)
                    self._write_new(stack)
        except UserFacingError as error:
            message = str(error)
        except OSError as error:
            message = f"{self.folder}: cannot be written: {error.strerror}"
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
        if free_disk_bytes(self.folder.parent) < MIN_FREE_BYTES:
            raise UserFacingError(
                f"{self.folder}: less than {MIN_FREE_BYTES / 1e9:g} GB are left on the disk; "
                "free some space and record into a new folder"
            )
        if self._writer is None:
            self._offset_s = decode_metadata(record.metadata).clock_offset_s
            self._writer = stack.enter_context(TumWriter(self.folder, color_format=COLOR_FORMAT))
        self._writer.write(decode_frame(record, self._offset_s))
