"""MCAP files for the recording of any camera, which survive a crash."""

import logging
from collections.abc import Sequence
from contextlib import suppress
from decimal import Decimal
from io import FileIO
from pathlib import Path
from typing import IO, Any, cast

from mcap.writer import CompressionType

from drivers.bag.bag_writer import EncodedMessage, McapWriter
from drivers.bag.frame_writer import FrameWriter
from drivers.calibration import CameraCalibration
from drivers.core.geometry import T_BODY_CAMERA, Array
from drivers.core.write_errors import (
    WriteError,
    check_disk_space,
    check_in_place,
    creating,
    writing,
)
from drivers.recording.image_encoding import ColorFormat
from drivers.recording.recording_sink import RecordingFile, RecordingSink

_log = logging.getLogger(__name__)

# Left free on the disk, for the end of the file.
RESERVED_BYTES = 16_000_000


class McapRecordingFile(RecordingFile):
    """An MCAP file that ends with its last whole part if the disk fails.

    Args:
        path: New file.
        T_base_camera: 4x4 pose of the camera in the robot's base; may be set until `begin`.
        is_base_estimated: Whether others write the transform to the base, see `FrameWriter`.
        is_raw: Write color as it is. Otherwise it is JPEG, which loses a little.

    Raises:
        InputError: The file exists, or no file can have this name.
        WriteError: It cannot be written.
    """

    def __init__(
        self,
        path: Path,
        *,
        T_base_camera: Array = T_BODY_CAMERA,
        is_base_estimated: bool = False,
        is_raw: bool = False,
        min_free_bytes: int = RESERVED_BYTES,
    ) -> None:
        self.path, self.min_free_bytes = path, min_free_bytes
        self.color_format = None if is_raw else ColorFormat.JPEG
        self.T_base_camera, self._is_base_estimated = T_base_camera, is_base_estimated
        self._flushed_bytes = self._flushed_frames = 0
        with creating(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            check_disk_space(path.parent, min_free_bytes)
            self._file = path.open("xb", buffering=0)
        try:
            with writing(path):
                # Zstandard is better, but takes half of a core for raw color.
                compression = CompressionType.LZ4 if is_raw else CompressionType.ZSTD
                stream = cast(IO[bytes], _UnbufferedStream(self._file))
                self._writer = McapWriter(stream, compression)
        except WriteError:
            self.close()
            raise

    def begin(self, calibration: CameraCalibration, start: Decimal) -> RecordingSink:
        return FrameWriter(
            self._writer,
            calibration,
            start,
            T_base_camera=self.T_base_camera,
            is_base_estimated=self._is_base_estimated,
        )

    def write_messages(self, messages: Sequence[EncodedMessage]) -> None:
        """Write messages of ROS 2, in CDR. Raises OSError."""
        for message in messages:
            self._writer.write(message)

    def flush(self) -> None:
        self._writer.flush()
        check_in_place(self._file.fileno(), self.path)
        self._flushed_bytes, self._flushed_frames = self._file.tell(), self.written

    def cut(self) -> None:
        """Remove the incomplete chunk: the file is then read up to its last whole one."""
        self.written = self._flushed_frames
        try:
            self._file.truncate(self._flushed_bytes)
        except OSError as error:
            _log.warning("%s: cannot be cut: %s", self.path, error.strerror)

    def complete(self) -> None:
        self._writer.close()
        check_in_place(self._file.fileno(), self.path)

    def close(self) -> None:
        """Close the file; remove it without a frame, unless another one has its name by now."""
        if not self.written and not self._file.closed:
            with suppress(OSError):
                check_in_place(self._file.fileno(), self.path)
                self.path.unlink()
        self._file.close()

    @property
    def remark(self) -> str:
        has_frames = self.written and self.path.exists()
        return "the frames recorded so far can be replayed" if has_frames else ""


class _UnbufferedStream:
    """Writes all or raises OSError; nothing stays in a buffer that a full disk could not take."""

    def __init__(self, file: FileIO) -> None:
        self._file = file
        self.tell, self.flush = file.tell, file.flush

    def write(self, data: Any) -> int:
        view = memoryview(data).cast("B")
        written = 0
        while written < len(view):
            written += self._file.write(view[written:])
        return written
